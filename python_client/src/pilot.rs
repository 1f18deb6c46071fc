//! Controllers of one drone or of several, as a batch flies them.

use std::ffi::CString;

use crazyflie_control::InputNeeds;
use crazyflie_env::action::Interface;
use crazyflie_env::vector::{RolloutBuffers, VectorEnv};
use pyo3::PyRefMut;
use pyo3::exceptions::{PyTypeError, PyUserWarning};
use pyo3::prelude::*;

use crate::controller::Controller;
use crate::errors::guarded;
use crate::multi_controller::Crowd;

/// A controller that was made for a batch.
pub enum Pilot<'py> {
    One(PyRefMut<'py, Controller>),
    Several(PyRefMut<'py, Crowd>),
}

impl<'py> Pilot<'py> {
    /// # Errors
    /// `TypeError` for anything but a controller of this package; `RuntimeError` while it answers elsewhere.
    pub fn borrow(controller: &Bound<'py, PyAny>) -> PyResult<Self> {
        if let Ok(one) = controller.cast::<Controller>() {
            return Ok(Pilot::One(one.try_borrow_mut()?));
        }
        if let Ok(several) = controller.cast::<Crowd>() {
            return Ok(Pilot::Several(several.try_borrow_mut()?));
        }
        let got =
            controller.get_type().name().map_or_else(|_| "something else".into(), |name| name.to_string());
        Err(PyTypeError::new_err(format!("controller: expected a Controller or a Crowd, got {got}")))
    }

    /// Warns of a controller that commands something else than the actions of the environment.
    ///
    /// # Errors
    /// The warning, where Python raises it.
    pub fn warn_of_other_actions(&self, py: Python<'_>, expected: &Interface) -> PyResult<()> {
        let made = match self {
            Pilot::One(one) => &one.interface,
            Pilot::Several(several) => &several.interface,
        };
        let actions = |of: &Interface| (of.level(), of.input);
        if actions(made) == actions(expected) {
            return Ok(());
        }
        let words =
            |of: &Interface| format!("{} with the vertical form {}", of.level().name(), of.input.name());
        let text = format!(
            "the controller commands {}, and the environment takes {}: its `controller` method makes one for it",
            words(made),
            words(expected)
        );
        let text = CString::new(text)?;
        PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)
    }

    /// Returns what it needs beside measured rows.
    pub fn needs(&mut self) -> PyResult<InputNeeds> {
        match self {
            Pilot::One(one) => one.needs(),
            Pilot::Several(several) => several.needs(),
        }
    }

    /// Writes actions for measured rows, and true states where they are needed.
    pub fn answer(&mut self, py: Python<'_>, rows: &[f32], states: &[f32], out: &mut [f32]) -> PyResult<()> {
        match self {
            Pilot::One(one) => one.answer(py, rows, states, out),
            Pilot::Several(several) => several.answer(py, rows, states, out),
        }
    }

    /// Flies `steps` steps of `env`, whose parts have `share` of its `envs` environments; writes the last actions.
    pub fn fly(
        &mut self,
        py: Python<'_>,
        env: &mut VectorEnv,
        [envs, share]: [usize; 2],
        steps: usize,
        actions: &mut [f32],
        out: RolloutBuffers<'_>,
    ) -> PyResult<()> {
        match self {
            Pilot::One(one) => {
                let parts = one.parts(envs, share)?;
                py.detach(|| guarded(|| env.rollout_with(parts, steps, actions, out)))
            }
            Pilot::Several(several) => {
                let parts = several.parts(envs, share)?;
                py.detach(|| guarded(|| env.rollout_with(parts, steps, actions, out)))
            }
        }
    }
}
