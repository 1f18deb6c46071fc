//! Why a flight could not be replayed.

use thiserror::Error;

use crate::metrics::MetricError;

/// Reason why a log cannot be replayed on a model, nor prepared for a fit.
#[derive(Debug, Clone, PartialEq, Error)]
#[allow(missing_docs, reason = "each variant's message says what went wrong")]
pub enum ReplayError {
    #[error("the log holds no {what}, so there is nothing to drive the model with")]
    NoCommands { what: &'static str },
    #[error("the log holds no position measurement to compare with")]
    NoPosition,
    #[error("the vehicle never flies in this log")]
    NeverAirborne,
    #[error("the flight lasts only {seconds:.2} s, expected at least {least_s} s")]
    TooShort { seconds: f64, least_s: f64 },
    #[error("a horizon of {value_s} s cannot be replayed, expected at least {least_s} s")]
    Horizon { value_s: f64, least_s: f64 },
    #[error("the hover PWM can only be set for the model's vertical form \"thrust\"")]
    HoverWithoutThrustForm,
    #[error("a hover PWM of {value} cannot carry a vehicle, expected a positive number")]
    HoverPwm { value: f64 },
    #[error("the model's effect {name:?} is drawn at random; a replay needs fixed numbers")]
    DrawnEffect { name: String },
    #[error("{signal}: {source}")]
    Compare { signal: &'static str, source: MetricError },
    #[error(transparent)]
    Model(#[from] crazyflie_env::Error),
}
