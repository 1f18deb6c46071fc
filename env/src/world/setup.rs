//! Parts of a world: the effects that are on, the length of a physics step, the constants of the vehicle.

use super::World;
use crate::action::ActionLevel;
use crate::effect_table::EffectTable;
use crate::effects::{self, BoundedNumber, Scope, numbers};
use crate::error::{Error, Result, out_of_range};
use crate::model::{Model, Schedule, VerticalInput};
use crate::number::Number;
use crate::plant::VehicleConstants;
use crate::scalar::Scalar;
use crate::sim_scalar::SimScalar;

pub(super) fn with_ranges(entry: &effects::Entry, values: Vec<Number>) -> Vec<BoundedNumber> {
    values.into_iter().zip(entry.params).map(|(number, param)| BoundedNumber { number, param }).collect()
}

pub(super) type Active = (usize, &'static effects::Entry, Vec<Number>);

/// The effects of the model and of the configuration that are not off, the configuration's winning, in registry
/// order. The model's own represent what an identified form lacks: if that form is not commanded, they are off.
pub(super) fn active(model: &Model, of_config: &EffectTable, input: VerticalInput) -> Result<Vec<Active>> {
    let mut table = EffectTable::new();
    for (name, given) in &model.effects {
        if input != VerticalInput::Motors || effects::find(name)?.1.scope != Scope::IdentifiedLoops {
            table.insert(name.clone(), given.clone());
        }
    }
    table.extend(of_config.iter().map(|(name, given)| (name.clone(), given.clone())));
    let mut active = Vec::new();
    for (name, given) in &table {
        let (place, entry) = effects::find(name)?;
        let values = numbers(entry, given);
        let off = values.iter().zip(entry.params).all(|(v, p)| v.fixed() == Some(p.off));
        if !off {
            active.push((place, entry, values));
        }
    }
    active.sort_by_key(|(place, ..)| *place);
    Ok(active)
}

/// Returns whether an effect that is on determines the battery's voltage.
///
/// # Errors
/// [`Error::Unknown`] for an unknown effect.
pub fn has_battery(model: &Model, effects: &EffectTable, input: VerticalInput) -> Result<bool> {
    Ok(active(model, effects, input)?.iter().any(|(_, entry, _)| entry.is_battery))
}

/// Checks that the effects that are on fit the form and the action level, and that the numbers of the battery have an
/// effect.
///
/// # Errors
/// [`Error::Config`] naming the effect that does not fit; [`Error::Unknown`] for an unknown one; as
/// [`Model::check_battery`].
pub(crate) fn check_scope(
    model: &Model,
    effects: &EffectTable,
    input: VerticalInput,
    level: ActionLevel,
) -> Result<()> {
    let active = active(model, effects, input)?;
    model.check_battery(active.iter().any(|(_, entry, _)| entry.is_battery))?;
    for (_, entry, _) in active {
        let lacks = match entry.scope {
            Scope::Any => continue,
            Scope::Angles if level.is_below_attitude() => {
                format!("acts on commanded angles, and actions of the level {:?} are none", level.name())
            }
            Scope::IdentifiedLoops if input == VerticalInput::Motors => {
                "stands for what the vertical form \"motors\" has or has not by itself".to_owned()
            }
            Scope::Angles | Scope::IdentifiedLoops => continue,
        };
        return Err(Error::Config(format!("effect {}: it {lacks}", entry.name)));
    }
    Ok(())
}

/// Physics steps per second of the motor-level form, which divides them for its loops.
const MOTOR_HZ: u32 = 100;

impl<R: SimScalar> World<R> {
    /// The same world, whose commands are those of another action level.
    pub(crate) fn at_level(self, level: ActionLevel) -> Self {
        World { motors: self.motors.map(|motors| motors.at_level(level)), ..self }
    }
}

/// Returns the physics steps per second that the form and the active effects need; 0 for any.
pub(super) fn needed_hz(active: &[Active], input: VerticalInput) -> u32 {
    let own_hz = if input == VerticalInput::Motors { MOTOR_HZ } else { 0 };
    active.iter().map(|(_, entry, _)| entry.physics_hz).max().unwrap_or(0).max(own_hz)
}

/// Returns the clock counts of an integration step, fine enough for every active effect unless the user sets it; the
/// linear model itself is exact at any rate.
pub(super) fn counts_per_step(schedule: &Schedule, physics_hz: Option<u32>, needed_hz: u32) -> Result<u32> {
    let good = |counts: &u32| schedule.control.is_multiple_of(*counts);
    let Some(hz) = physics_hz else {
        let longest = (schedule.base_hz / needed_hz.max(1)).clamp(1, schedule.control);
        return Ok((1..=longest).rev().find(good).unwrap_or(1));
    };
    let counts = schedule.base_hz.checked_div(hz).unwrap_or(0);
    if counts == 0 || !schedule.base_hz.is_multiple_of(hz) || !good(&counts) {
        let rates: Vec<String> =
            (1..=schedule.control).filter(good).map(|c| (schedule.base_hz / c).to_string()).collect();
        return Err(out_of_range("physics_hz", f64::from(hz), format!("one of {}", rates.join(", "))));
    }
    Ok(counts)
}

pub(super) fn body<R: Scalar>(model: &Model, input: VerticalInput) -> Result<VehicleConstants<R>> {
    let hover = model.vertical(input)?.hover_pwm().filter(|_| input.is_pwm());
    let tilts = model.tilt_forms(input);
    let yaw = model.yaw_form(input);
    let (yaw_gain_ps2, yaw_stiffness_ps2) =
        if yaw.lags_push() { (-yaw.a[1][1] * yaw.u[0], 0.0) } else { (yaw.u[1], -yaw.a[1][0]) };
    Ok(VehicleConstants {
        gravity_mps2: R::from_f64(model.lateral.gravity.value),
        mass_kg: R::from_f64(model.vehicle.mass.value),
        rotor_radius_m: R::from_f64(model.vehicle.rotor_radius.value),
        per_battery_capacity_pc: R::from_f64(1.0 / model.vehicle.battery_capacity.value),
        hover_current_a: R::from_f64(model.vehicle.hover_current.value),
        battery_reference_v: R::from_f64(model.battery_reference_v()),
        per_hover_pwm: R::from_f64(hover.map_or(0.0, |h| 1.0 / h)),
        height_command: R::from_f64(if hover.is_some() { 0.0 } else { 1.0 }),
        arm_m: R::from_f64(model.vehicle.arm.value),
        heave_ps: R::from_f64(model.vertical(input)?.heave_ps()),
        yaw_sign: R::from_f64(model.yaw.sign()),
        yaw_gain_ps2: R::from_f64(yaw_gain_ps2),
        yaw_damping_ps: R::from_f64(-yaw.a[1][1]),
        yaw_stiffness_ps2: R::from_f64(yaw_stiffness_ps2),
        tilt_gain_ps2: tilts.map(|t| R::from_f64(t.u[1])),
        tilt_damping_ps: tilts.map(|t| R::from_f64(-t.a[1][1])),
        tilt_stiffness_ps2: tilts.map(|t| R::from_f64(-t.a[1][0])),
    })
}
