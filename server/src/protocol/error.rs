//! Errors of requests. The session lives on.

use std::borrow::Cow;

use crazyflie_env::Error;

use super::fields::plain_words;

/// An error reply: a code for programs, words for people.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{message}")]
pub struct ProtocolError {
    /// Kind of the error, for programs.
    pub code: Code,
    /// Description of the error, for people.
    pub message: String,
    /// Seconds to wait before another try, where that helps.
    pub retry_after_s: Option<u64>,
}

/// The codes of `docs/protocol.md`.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "docs/protocol.md says what every code means")]
pub enum Code {
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
    BadName,
    UnknownWorld,
    WorldTaken,
    WorldOver,
    NotInvited,
    UnknownDrone,
    NoFreeDrone,
    DroneTaken,
    DroneEnded,
    SeatLost,
    NoSeat,
    TooLarge,
    TooMany,
    Unavailable,
    /// The code of an extension, or of a server that knows more codes.
    #[serde(untagged)]
    Other(Cow<'static, str>),
}

impl ProtocolError {
    /// Without a time to wait.
    pub fn new(code: Code, message: impl Into<String>) -> Self {
        ProtocolError { code, message: message.into(), retry_after_s: None }
    }

    /// Refuses with these words, unless the condition is true.
    ///
    /// # Errors
    /// The refusal.
    pub fn unless(holds: bool, code: Code, words: impl FnOnce() -> String) -> Result<(), ProtocolError> {
        if holds { Ok(()) } else { Err(ProtocolError::new(code, words())) }
    }
}

impl From<Error> for ProtocolError {
    fn from(error: Error) -> Self {
        let code = match error {
            Error::Shape { .. } => Code::WrongLength,
            Error::Action { .. } | Error::DroneAction { .. } => Code::BadAction,
            Error::Model { .. } | Error::Unknown { what: "vehicle", .. } => Code::BadModel,
            Error::Unknown { .. }
            | Error::Range { .. }
            | Error::Config(_)
            | Error::Expression { .. }
            | Error::NotFinite { .. } => Code::BadOptions,
            Error::Ended { .. } => Code::Ended,
            Error::NotReset => Code::NotReset,
            // a server flies no controller of a client's
            Error::Controller { .. } => Code::Unavailable,
        };
        // advice uses the names of the protocol, not of Python
        let message = match error {
            Error::Ended { env } => {
                format!("environment {env} has ended: reset it (with a mask) before the next step")
            }
            Error::NotReset => "the first request of a session is a reset of all environments".into(),
            other => plain_words(&other.to_string()),
        };
        ProtocolError::new(code, message)
    }
}
