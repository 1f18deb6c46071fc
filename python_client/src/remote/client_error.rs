//! Errors between a client and a server, as Python exceptions.

use pyo3::PyErr;
use pyo3::exceptions::{PyConnectionError, PyRuntimeError, PyValueError};

/// Error of a request or of the connection.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The server's error reply to a request.
    #[error("{message}")]
    Refused { code: String, message: String },
    /// The connection is gone; the session may be waiting.
    #[error("the connection to {url} was lost: {why}")]
    Lost { url: String, why: String },
    /// The connection is gone, and the session with it.
    #[error("the connection to {url} has ended: {why}")]
    Ended { url: String, why: String },
    #[error("{url} answers in a way that the protocol does not know: {why}")]
    Unexpected { url: String, why: String },
    /// An exception of Python's own, such as `KeyboardInterrupt`.
    #[error(transparent)]
    Python(#[from] PyErr),
}

impl From<ClientError> for PyErr {
    fn from(error: ClientError) -> PyErr {
        match error {
            ClientError::Refused { code, message } if is_argument(&code) => PyValueError::new_err(message),
            ClientError::Refused { message, .. } => PyRuntimeError::new_err(message),
            ClientError::Python(error) => error,
            other => PyConnectionError::new_err(other.to_string()),
        }
    }
}

/// Whether a code of the protocol blames the arguments, as opposed to the moment.
/// `crazyflie_gym.remote_client` has the same list.
fn is_argument(code: &str) -> bool {
    let codes =
        ["bad_message", "bad_frame", "wrong_length", "bad_action", "bad_options", "bad_model", "too_large"];
    codes.contains(&code)
        || ["unknown_scenario", "bad_token", "bad_name", "bad_shape", "unknown_world", "unknown_drone"]
            .contains(&code)
}
