//! Policies for microcontrollers.

use crazyflie_control::export_c;
use crazyflie_env::model::{Model, VerticalInput};
use pyo3::prelude::*;

use crate::errors::guarded;

/// A policy (the content of its file) as C: source and header, where `stem` is the name of both files without
/// their endings. `model` is the text of the vehicle's model file, the thesis's unless given; `vertical` the
/// form that is commanded, by default the policy's.
#[pyfunction]
#[pyo3(signature = (policy, stem, *, model = None, vertical = None))]
pub fn policy_c(
    policy: &[u8],
    stem: &str,
    model: Option<&str>,
    vertical: Option<&str>,
) -> PyResult<(String, String)> {
    guarded(|| {
        let model = model.map_or_else(|| Ok(Model::thesis()), Model::parse)?;
        let input = vertical.map(VerticalInput::named).transpose()?;
        export_c(policy, &model, input, stem).map(|code| (code.source, code.header))
    })
}
