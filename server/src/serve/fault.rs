//! What a request can be answered with instead of a result. The session lives on.

use crazyflie_env::Error;

/// A refusal: a code for programs, words for people.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{message}")]
pub(crate) struct Fault {
    pub code: Code,
    pub message: String,
}

/// The codes of `docs/protocol.md`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Code {
    BadJson,
    BadMessage,
    UnknownType,
    BadFrame,
    WrongLength,
    BadAction,
    BadOptions,
    BadModel,
    NotReset,
    Ended,
    NoSession,
    UnknownSession,
    StaleId,
    TooLarge,
    TooMany,
    Unavailable,
}

impl Fault {
    pub(crate) fn new(code: Code, message: impl Into<String>) -> Self {
        Fault { code, message: message.into() }
    }
}

impl From<Error> for Fault {
    fn from(error: Error) -> Self {
        let code = match error {
            Error::Shape { .. } => Code::WrongLength,
            Error::Action { .. } => Code::BadAction,
            Error::Unknown { .. } | Error::Range { .. } | Error::Config(_) => Code::BadOptions,
            Error::Model { .. } => Code::BadModel,
            Error::Ended { .. } => Code::Ended,
            Error::NotReset => Code::NotReset,
        };
        // how to mend it is said in the words of the protocol, not of Python
        let message = match error {
            Error::Ended { env } => format!("environment {env} has ended: reset it (with a mask) before the next step"),
            Error::NotReset => "the first request of a session is a reset of all environments".into(),
            other => other.to_string(),
        };
        Fault { code, message }
    }
}
