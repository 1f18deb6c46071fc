//! What goes wrong between a client and a server, as Python says it.

use pyo3::PyErr;
use pyo3::exceptions::{PyConnectionError, PyRuntimeError, PyValueError};

#[derive(Debug, thiserror::Error)]
pub enum Trouble {
    /// The server's answer to a request that it does not carry out.
    #[error("{message}")]
    Refused { code: String, message: String },
    /// The connection is gone; the session may be waiting.
    #[error("the connection to {url} was lost: {why}")]
    Lost { url: String, why: String },
    /// The connection is gone, and the session with it.
    #[error("the connection to {url} has ended: {why}")]
    Ended { url: String, why: String },
    #[error("{url} answers in a way that the protocol does not know: {why}")]
    Strange { url: String, why: String },
    /// An exception of Python's own, such as `KeyboardInterrupt`.
    #[error(transparent)]
    Python(#[from] PyErr),
}

impl From<Trouble> for PyErr {
    fn from(trouble: Trouble) -> PyErr {
        match trouble {
            Trouble::Refused { code, message } if is_argument(&code) => PyValueError::new_err(message),
            Trouble::Refused { message, .. } => PyRuntimeError::new_err(message),
            Trouble::Python(error) => error,
            other => PyConnectionError::new_err(other.to_string()),
        }
    }
}

/// Whether a code of the protocol is about what was asked for, as opposed to when; `crazyflie_gym.remote` has the same list.
fn is_argument(code: &str) -> bool {
    let codes = ["bad_message", "bad_frame", "wrong_length", "bad_action", "bad_options", "bad_model", "too_large"];
    codes.contains(&code) || ["unknown_scenario", "bad_token", "bad_name", "bad_shape", "unknown_world", "unknown_drone"].contains(&code)
}
