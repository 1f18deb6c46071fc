//! Cell for the data of a Python object.

use std::sync::Mutex;

use pyo3::PyResult;
use pyo3::exceptions::PyRuntimeError;

/// A mutex that makes a class `Sync`, as pyo3 demands. Access is through `&mut self`, or short, so it costs
/// nothing.
pub struct GuardedCell<T>(Mutex<T>);

impl<T> GuardedCell<T> {
    pub fn new(inner: T) -> Self {
        GuardedCell(Mutex::new(inner))
    }

    /// # Errors
    /// `RuntimeError` if a call panicked while it had it.
    pub fn get(&mut self) -> PyResult<&mut T> {
        self.0.get_mut().map_err(|_| broken())
    }

    /// Calls `look` on the data.
    ///
    /// # Errors
    /// The errors of [`GuardedCell::get`].
    pub fn glance<U>(&self, look: impl FnOnce(&T) -> U) -> PyResult<U> {
        self.0.lock().map(|inner| look(&inner)).map_err(|_| broken())
    }
}

fn broken() -> pyo3::PyErr {
    PyRuntimeError::new_err("this object is broken by an earlier bug")
}
