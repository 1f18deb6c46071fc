//! Errors of this crate, worded so that the reader can correct the cause.

use std::fmt::Display;

use crazyflie_logs::LogError;

/// Reason why options and logs give no result.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Options that no log satisfies.
    #[error("{0}")]
    Options(String),
    /// Logs, or a case file, that do not suffice.
    #[error("{0}")]
    Logs(String),
    /// A log that cannot be read.
    #[error(transparent)]
    Log(Box<LogError>),
    /// A model that cannot fly, or a name that it does not know.
    #[error(transparent)]
    Model(#[from] crazyflie_env::Error),
}

/// Results of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    pub(crate) fn logs<T>(problem: impl Into<String>) -> Result<T> {
        Err(Error::Logs(problem.into()))
    }
    pub(crate) fn options<T>(problem: impl Into<String>) -> Result<T> {
        Err(Error::Options(problem.into()))
    }
    pub(crate) fn no_logs() -> Self {
        Error::Options("there is no log to identify from".to_owned())
    }
    pub(crate) fn mixed(first: &str, second: &str) -> Self {
        let differ = "have different vertical commands, or one lacks a velocity: fit them separately";
        Error::Logs(format!("{first} and {second} {differ}"))
    }
    pub(crate) fn no_excitation(input: &str, about: &str) -> Self {
        Error::Logs(format!("the {input} does not move in any of the logs, so it says nothing about {about}"))
    }
    pub(crate) fn no_start(fit: &str) -> Self {
        let reason = "no candidate of the linear method could be simulated";
        Error::Logs(format!("the fit of the {fit} found no start: {reason}"))
    }
    /// An error about numbers that logs do not determine.
    pub(crate) fn singular(parameter: &str, reason: &str) -> Self {
        Error::Logs(format!("{parameter} cannot be told from these logs: {reason}"))
    }
    /// An error about a log, by its name.
    pub(crate) fn about(log: &str, problem: impl Display) -> Self {
        Error::Logs(format!("{log}: {problem}"))
    }
}
