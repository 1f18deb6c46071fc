//! Why something could not be identified.

use thiserror::Error;

use crate::replay::ReplayError;

/// Reason why logs do not give a transfer function or a model.
#[derive(Debug, Clone, PartialEq, Error)]
#[allow(missing_docs, reason = "each variant's message says what went wrong")]
pub enum IdentifyError {
    #[error("there is no log to identify from")]
    NoLogs,
    #[error("{log}: no {what} in this log")]
    MissingChannel { log: String, what: &'static str },
    #[error(
        "{log}: only {seconds:.2} s of flight with {samples} samples, expected at least {least_s:.1} s and {least} samples"
    )]
    TooShort { log: String, seconds: f64, samples: usize, least_s: f64, least: usize },
    #[error("the {input} does not move in any of the logs, so it says nothing about {about}")]
    NoExcitation { input: &'static str, about: String },
    #[error("a transfer function of order {numerator},{denominator} is not supported: {reason}")]
    Order { numerator: usize, denominator: usize, reason: &'static str },
    #[error("{parameter} cannot be told from these logs: {reason}")]
    Singular { parameter: String, reason: String },
    #[error("the fit of the {what} found no start: no candidate of the linear method could be simulated")]
    NoStart { what: String },
    #[error(
        "{first} and {second} have different vertical commands, or one lacks a velocity: fit them separately"
    )]
    Mixed { first: String, second: String },
    #[error("{first} and {second} hold the same flight: name it once, to fit or to judge by")]
    Duplicate { first: String, second: String },
    #[error("a window of {value_s} s is not possible, expected at least {least_s} s")]
    Window { value_s: f64, least_s: f64 },
    #[error(
        "the vehicle obeyed its commands about {:.0} ms before the time at which the logs have them, by the model {model}; correct the times of the commands and try again, or name a model whose attitude follows faster",
        1e3 * late_s
    )]
    LateCommands { model: String, late_s: f64 },
    #[error("{log}: {source}")]
    Flight { log: String, source: ReplayError },
    #[error(
        "the model {model} has no motor-level form to start from, as cf21 and the other vehicles by name have"
    )]
    NoMotorForm { model: String },
    #[error("the logs hold {found} blocks of 2 s of flight without a hit, expected at least {expected}")]
    FewBlocks { found: usize, expected: usize },
    #[error(
        "the motors in these logs do not tell the motor-level form: of roll, pitch, yaw and lift it explains {}; record motors, gyro and accelerometer at 250 Hz or more",
        percents(explained)
    )]
    MotorsNotTold { explained: [f64; 4] },
    #[error(transparent)]
    Motors(#[from] crate::motor::flight::MotorFlightError),
    #[error(transparent)]
    Model(#[from] crazyflie_env::Error),
}

fn percents(shares: &[f64; 4]) -> String {
    shares.map(|share| format!("{:.0} %", 100.0 * share)).join(", ")
}
