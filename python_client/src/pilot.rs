//! Controllers of one drone or of several, as a caller hands them over.

use std::ffi::CString;

use crazyflie_env::action::Interface;
use pyo3::PyRefMut;
use pyo3::exceptions::{PyTypeError, PyUserWarning};
use pyo3::prelude::*;

use crate::controller::Controller;
use crate::multi_controller::Crowd;
use crate::parts::PartControllers;

/// A controller that was made for a batch.
pub enum BorrowedPilot<'py> {
    One(PyRefMut<'py, Controller>),
    Several(PyRefMut<'py, Crowd>),
}

impl<'py> BorrowedPilot<'py> {
    /// Warns of a controller that commands something else than the actions of the environment.
    ///
    /// # Errors
    /// `TypeError` for anything but a controller of this package; `RuntimeError` while it answers elsewhere; the
    /// warning, where Python raises it.
    pub fn new(controller: &Bound<'py, PyAny>, expected: &Interface) -> PyResult<Self> {
        let mut pilot = if let Ok(one) = controller.cast::<Controller>() {
            BorrowedPilot::One(one.try_borrow_mut()?)
        } else if let Ok(several) = controller.cast::<Crowd>() {
            BorrowedPilot::Several(several.try_borrow_mut()?)
        } else {
            let got = controller.get_type().name();
            let got = got.map_or_else(|_| "something else".into(), |name| name.to_string());
            let problem = format!("controller: expected a Controller or a Crowd, got {got}");
            return Err(PyTypeError::new_err(problem));
        };
        warn_of_other_actions(controller.py(), &pilot.get().of.interface, expected)?;
        Ok(pilot)
    }

    /// Returns its controllers.
    pub fn get(&mut self) -> &mut PartControllers {
        match self {
            BorrowedPilot::One(one) => &mut one.parts,
            BorrowedPilot::Several(several) => &mut several.parts,
        }
    }
}

fn warn_of_other_actions(py: Python<'_>, made: &Interface, expected: &Interface) -> PyResult<()> {
    if (made.level(), made.input) == (expected.level(), expected.input) {
        return Ok(());
    }
    let words = |of: &Interface| format!("{} with the vertical form {}", of.level().name(), of.input.name());
    let text = format!(
        "the controller commands {}, and the environment takes {}: its `controller` method makes one for it",
        words(made),
        words(expected)
    );
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &CString::new(text)?, 1)
}
