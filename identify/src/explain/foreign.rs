//! Flights of another vehicle than the model's.

use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_logs::{AttitudeSource, PositionSource};
use crazyflie_statistics::{mean, quantile};
use serde::Serialize;

use super::calibration::foreign::FOREIGN;
use crate::FlightLog;
use crate::lift::read_pwm;
use crate::vehicle::NuisanceParameters;

/// The PWM that carries the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct HoverPwm {
    /// Median over the flights.
    pub flown: f64,
    /// At which the model hovers.
    pub model: f64,
}

/// The hover PWM of the flights and of the model, where these differ by more than flights of one vehicle do. The
/// flights obey this vertical form; their hover is among the `trims`, or else the mean thrust command of `logs`.
pub fn foreign_hover_pwm<'a>(
    model: &Model,
    input: VerticalInput,
    trims: &[NuisanceParameters],
    logs: impl Iterator<Item = &'a FlightLog>,
) -> Option<HoverPwm> {
    let by_trim = trims.iter().filter_map(|trim| trim.values.iter().find(|(name, ..)| name == "hover_pwm"));
    let mut hovers: Vec<f64> = by_trim.map(|(.., pwm)| *pwm).collect();
    // a model with effects of its own may need another command than the mean to hover
    if hovers.is_empty() && model.effects.is_empty() {
        hovers = logs.filter_map(|log| mean_thrust_pwm(log, model)).collect();
    }
    let flown = quantile(&hovers, 0.5)?;
    let forms = [input, VerticalInput::Thrust, VerticalInput::Pwm].into_iter();
    let model =
        forms.filter_map(|form| model.vertical(form).ok()?.hover_pwm()).find(|pwm| pwm.is_finite())?;
    ((flown / model - 1.0).abs() > FOREIGN).then_some(HoverPwm { flown, model })
}

/// The mean thrust command in flight: over a flight it carries the weight. Only of recordings: in a simulated
/// flight another thrust is what one looks for.
fn mean_thrust_pwm(log: &FlightLog, model: &Model) -> Option<f64> {
    let origin = log.provenance;
    if origin.attitude != AttitudeSource::MotionCapture && origin.position != PositionSource::Estimate {
        return None;
    }
    let pwm = read_pwm(log, model).ok()?;
    mean(pwm.get(log.airborne.clone())?)
}
