//! Errors of the simulator as Python exceptions.

use std::panic::{AssertUnwindSafe, catch_unwind};

use crazyflie_env::Error;
use pyo3::PyResult;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use serde::de::DeserializeOwned;

use crate::custom::take_raised;

/// Run a call of the simulator: its error becomes `ValueError` (wrong argument) or `RuntimeError` (wrong
/// moment), and a panic, which would be a bug, becomes a `RuntimeError` as well instead of pyo3's
/// `PanicException`, which no `except Exception` catches.
pub fn guarded<T, E: Into<Failure>>(call: impl FnOnce() -> Result<T, E>) -> PyResult<T> {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(result) => result.map_err(|error| match error.into() {
            Failure::Argument(text) => PyValueError::new_err(text),
            Failure::Moment(text) => PyRuntimeError::new_err(text),
            Failure::Raised(text) => take_raised().unwrap_or_else(|| PyRuntimeError::new_err(text)),
        }),
        Err(panic) => {
            let text =
                panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
            Err(PyRuntimeError::new_err(format!(
                "a bug in crazyflie_gym, please report it: {}",
                text.unwrap_or("no message")
            )))
        }
    }
}

/// Reads JSON that the caller gave.
///
/// # Errors
/// [`Error::Config`], which names what it is.
pub fn parse_json<T: DeserializeOwned>(what: &str, text: &str) -> Result<T, Error> {
    serde_json::from_str(text).map_err(|e| Error::Config(format!("{what}: {e}")))
}

/// Kind of an error: a wrong argument or a wrong moment.
pub enum Failure {
    Argument(String),
    Moment(String),
    /// A controller of the caller's own raised an exception.
    Raised(String),
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        match error {
            Error::NotReset | Error::Ended { .. } => Failure::Moment(error.to_string()),
            Error::Controller { .. } => Failure::Raised(error.to_string()),
            _ => Failure::Argument(error.to_string()),
        }
    }
}

impl From<crazyflie_picture::PictureError> for Failure {
    fn from(error: crazyflie_picture::PictureError) -> Self {
        Failure::Argument(error.to_string())
    }
}
