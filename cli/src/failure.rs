//! Failures of the command line, and their exit codes.

use std::fmt::Display;
use std::io;

use crazyflie_env::Error as EnvError;
use crazyflie_picture::PictureError;
use crazyflie_server::client::Error as ClientError;
use crazyflie_server::protocol::Code;
use thiserror::Error;

/// Result of a command.
pub(crate) type Outcome<T = ()> = Result<T, Failure>;

/// Reason that a command failed.
#[derive(Debug, Error)]
pub enum Failure {
    /// The user requested something that does not exist or cannot be.
    #[error("{0}")]
    Usage(String),
    /// The task of the command failed.
    #[error("{0}")]
    Failed(String),
    /// The reader of our output has gone: nothing to report, and not an error.
    #[error("the output was closed")]
    Closed,
}

impl Failure {
    pub(crate) fn exit_code(&self) -> i32 {
        match self {
            Failure::Usage(_) => 2,
            Failure::Failed(_) => 1,
            Failure::Closed => 0,
        }
    }

    /// Refuses the user's request with these words, unless the condition is true.
    pub(crate) fn unless(holds: bool, words: impl FnOnce() -> String) -> Outcome {
        if holds { Ok(()) } else { Err(Failure::Usage(words())) }
    }

    /// A failure about a file or another named thing.
    pub(crate) fn about(what: impl Display, problem: impl Display) -> Self {
        Failure::Failed(format!("{what}: {problem}"))
    }
}

/// Names, ranges and options are from the command line; a model is from a file.
impl From<EnvError> for Failure {
    fn from(error: EnvError) -> Self {
        match error {
            EnvError::Unknown { .. }
            | EnvError::Range { .. }
            | EnvError::Config(_)
            | EnvError::Expression { .. } => Failure::Usage(error.to_string()),
            other => Failure::Failed(other.to_string()),
        }
    }
}

impl From<ClientError> for Failure {
    fn from(error: ClientError) -> Self {
        let is_usage = match &error {
            ClientError::Url | ClientError::Refused { code: Code::BadName, .. } => true,
            ClientError::Refused { code: Code::Other(code), .. } => code == "unknown_scenario",
            _ => false,
        };
        if is_usage { Failure::Usage(error.to_string()) } else { Failure::Failed(error.to_string()) }
    }
}

impl From<PictureError> for Failure {
    fn from(error: PictureError) -> Self {
        Failure::about("the picture cannot be drawn", error)
    }
}

impl From<serde_json::Error> for Failure {
    fn from(error: serde_json::Error) -> Self {
        error
            .io_error_kind()
            .map_or_else(|| Failure::about("JSON", &error), |kind| io::Error::from(kind).into())
    }
}

/// Writing to standard output.
impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::BrokenPipe => Failure::Closed,
            _ => Failure::about("standard output", error),
        }
    }
}
