//! `crazyflie deploy`, whose flights are in the Python package.

use crazyflie_cli::Failure;
use pyo3::exceptions::{PyOSError, PyTypeError, PyValueError};
use pyo3::prelude::*;

const MODULE: &str = "crazyflie_gym.deploy";

/// Flies by an object of settings.
pub fn deploy(settings: &str) -> Result<(), Failure> {
    Python::attach(|py| {
        let flown = py.import(MODULE).and_then(|module| module.call_method1("main", (settings,)));
        flown.map(drop).map_err(|raised| failure(py, &raised))
    })
}

/// Converts an exception: a user's mistake to a sentence, an unforeseen error with its traceback.
fn failure(py: Python<'_>, raised: &PyErr) -> Failure {
    let text = raised.value(py).to_string();
    let is_usage = raised.is_instance_of::<PyValueError>(py)
        || raised.is_instance_of::<PyTypeError>(py)
        || raised.is_instance_of::<PyOSError>(py);
    let name = raised.get_type(py).name().map(|name| name.to_string()).unwrap_or_default();
    match name.as_str() {
        "DeployError" => Failure::Failed(text),
        _ if is_usage => Failure::Usage(text),
        "ModuleNotFoundError" => {
            Failure::Failed(format!("deploy needs pip install \"crazyflie-gym[cflib]\" ({text})"))
        }
        _ => {
            raised.print(py);
            Failure::Failed(format!("{name}: {text}"))
        }
    }
}
