//! Start of a model's fit: near the vehicle that flew, for any given model.

use crazyflie_env::model::Model;
use crazyflie_statistics::quantile;

use super::{FitOptions, HOVER};
use crate::lift::read_pwm;
use crate::transfer::{self, Channel, Offset, Record, Structure, WindowLength};
use crate::{FlightLog, NamedLog, Result};

/// Poles of a stiff attitude loop lie so far from those of the thesis that a fit from there ends elsewhere. A
/// transfer function of roll and of pitch needs no start.
const ATTITUDE: [Channel; 2] = [Channel::Roll, Channel::Pitch];

/// The model with a mass and a hover PWM near those of the vehicle that flew: it hovers on the whole, and
/// its tilt follows its command as the logs show.
pub(super) fn model_near_vehicle(
    model: &Model,
    logs: &[NamedLog],
    plan: &FitOptions,
    free: &[String],
) -> Result<Model> {
    let mut near = plan
        .mass_kg
        .map_or_else(|| Ok(model.clone()), |mass_kg| model.with_parameter("vehicle.mass", mass_kg))?;
    let flown = |log: &FlightLog| quantile(read_pwm(log, model).ok()?.get(log.airborne.clone())?, 0.5);
    let hovers: Vec<f64> = logs.iter().filter_map(|(_, log)| flown(log)).filter(|pwm| *pwm > 0.0).collect();
    if plan.nuisance
        && !hovers.is_empty()
        && plan.free.as_ref().is_none_or(|free| free.iter().any(|path| path == HOVER))
    {
        near = near.with_parameter(HOVER, quantile(&hovers, 0.5).unwrap_or(0.0)).unwrap_or(near);
    }
    let attitude = |near: Model, channel| with_attitude(&near, logs, plan, free, channel).unwrap_or(near);
    Ok(ATTITUDE.into_iter().fold(near, attitude))
}

/// Returns the model with the transfer function of an attitude angle from the logs, if all of its numbers are fitted
/// and the logs determine it.
fn with_attitude(
    model: &Model,
    logs: &[NamedLog],
    plan: &FitOptions,
    free: &[String],
    channel: Channel,
) -> Option<Model> {
    let numbers = ["gain", "damping", "stiffness"].map(|number| format!("{}.{number}", channel.spec().name));
    if !numbers.iter().all(|path| free.contains(path)) {
        return None;
    }
    let records: Vec<Record> =
        logs.iter().filter_map(|(name, log)| Record::from_log(name, log, channel).ok()).collect();
    let offset = if plan.nuisance { Offset::PerFlight } else { Offset::None };
    let structure = Structure { offset, stable: true, ..channel.structure() };
    let found = transfer::identify(&records, channel, structure, WindowLength::OfChannel).ok()?;
    let near = found.in_model(model, &format!("the start of the fit, {}", channel.spec().name)).ok()?;
    numbers.iter().all(|path| near.parameter(path).is_ok_and(|value| value > 0.0)).then_some(near)
}
