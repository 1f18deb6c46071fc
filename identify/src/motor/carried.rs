//! The mass that a vehicle's motors carry at the PWM at which a flight hovers: far from the vehicle's mass, other
//! motors, propellers or another load flew.

use std::fmt;

use crazyflie_env::model::{Model, VEHICLES, Vertical};
use crazyflie_logs::Note;
use crazyflie_statistics::quantile;

use crate::FlightLog;
use crate::diagnose::trim::hover_stretches;

/// Batteries, set-ups and curves differ by less than this factor where the voltage is known or the firmware commands
/// a force. The stock motors of 20 flights of crazyswarm2 give 1.07 to 1.12 on `cf21`, upgraded ones 1.3 to 1.5.
const KNOWN_VOLTAGE: f64 = 1.28;
/// A battery that sags from full to empty changes a raw command by a third more.
const UNKNOWN_VOLTAGE: f64 = 1.7;

/// Motors that cannot be the model's.
#[derive(Debug, Clone, PartialEq)]
pub struct OtherMotors {
    /// Median PWM of the flights.
    pub hover_pwm: f64,
    /// Name of the model.
    pub model: String,
    /// Mass that the model's motors carry there.
    pub carried_kg: f64,
    /// Declared mass of the vehicle that flew.
    pub mass_kg: f64,
    /// The vehicles by name whose motors carry that, the nearest first.
    pub agreeing: Vec<&'static str>,
}

impl fmt::Display for OtherMotors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { hover_pwm, model, carried_kg, mass_kg, agreeing } = self;
        let [carried_g, mass_g] = [carried_kg, mass_kg].map(|kg| 1e3 * kg);
        write!(
            f,
            "the flights hover at a PWM of {hover_pwm:.0}, where the motors of {model} carry {carried_g:.1} g instead of {mass_g:.1} g: other motors, propellers or another mass flew"
        )?;
        if agreeing.is_empty() { Ok(()) } else { write!(f, "; these numbers fit {}", agreeing.join(", ")) }
    }
}

/// Compares the PWM at which flights hover with the motors of a model, for the mass that flew (the model's unless
/// given); `None` where they agree, or where the logs hold no PWM.
#[must_use]
pub fn other_motors(model: &Model, mass_kg: Option<f64>, logs: &[&FlightLog]) -> Option<OtherMotors> {
    let hovers: Vec<(f64, f64)> = logs.iter().filter_map(|log| hover_pwm(log, model)).collect();
    let all: Vec<f64> = hovers.iter().map(|(pwm, _)| *pwm).collect();
    let (pwm, most) = (quantile(&all, 0.5)?, hovers.iter().map(|(_, most)| *most).fold(0.0, f64::max));
    let mass_kg = mass_kg.unwrap_or(model.vehicle.mass.value);
    let carried_kg = carried_kg(model, pwm)?;
    let off = |kg: f64| (kg / mass_kg).ln().abs();
    if off(carried_kg) < most.ln() {
        return None;
    }
    let carried = |name, other: &Model| Some((name, off(self::carried_kg(other, pwm)?)));
    let vehicles = VEHICLES.iter().filter_map(|vehicle| carried(vehicle.name, &vehicle.model()));
    let mut agreeing: Vec<(&str, f64)> = vehicles.filter(|(_, off)| *off < most.ln()).collect();
    agreeing.sort_by(|a, b| a.1.total_cmp(&b.1));
    let agreeing = agreeing.into_iter().map(|(name, _)| name).collect();
    Some(OtherMotors { hover_pwm: pwm, model: model.name.clone(), carried_kg, mass_kg, agreeing })
}

/// The median PWM in flight, at the voltage for which the model's thrust holds, and the factor by which it may be off.
fn hover_pwm(log: &FlightLog, model: &Model) -> Option<(f64, f64)> {
    let reference_v = model.battery_reference_v();
    let is_force = |note: &Note| matches!(note, Note::ScaledToPwm { unit, .. } if unit == "N");
    let (pwm, factor) = match (log.motor_pwm_at(reference_v), &log.cmd_thrust_pwm) {
        (Some(pwm), _) => (pwm, KNOWN_VOLTAGE),
        (None, Some(pwm)) if log.is_simulated() || log.notes.iter().any(is_force) => {
            (pwm.clone(), KNOWN_VOLTAGE)
        }
        (None, Some(pwm)) => (pwm.clone(), UNKNOWN_VOLTAGE),
        (None, None) => return None,
    };
    // without a measured height, the voltages of the motors show the flight
    let flown = if log.airborne.is_empty() { hover_stretches(log) } else { vec![log.airborne.clone()] };
    let flown: Vec<f64> = flown.into_iter().flat_map(|rows| pwm[rows].to_vec()).collect();
    quantile(&flown, 0.5).map(|pwm| (pwm, factor))
}

/// Mass that motors carry at a PWM, by the thrust form or else the motor-level form of their model.
fn carried_kg(model: &Model, pwm: f64) -> Option<f64> {
    let share = match (&model.vertical.thrust, &model.vertical.motors) {
        (Some(Vertical::Thrust { hover, .. }), _) => pwm / hover.value,
        (_, Some(Vertical::Motors(form))) => form.curve(pwm) / form.curve(form.hover.value),
        _ => return None,
    };
    Some(share * model.vehicle.mass.value)
}
