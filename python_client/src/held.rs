//! What a Python object holds.

use std::sync::Mutex;

use pyo3::PyResult;
use pyo3::exceptions::PyRuntimeError;

/// Reached through `&mut self` or for a glance, where a mutex costs nothing; it makes a class `Sync`, as pyo3 demands.
pub struct Held<T>(Mutex<T>);

impl<T> Held<T> {
    pub fn new(inner: T) -> Self {
        Held(Mutex::new(inner))
    }

    /// # Errors
    /// `RuntimeError` if a call panicked while it had it.
    pub fn get(&mut self) -> PyResult<&mut T> {
        self.0.get_mut().map_err(|_| broken())
    }

    /// What `look` sees in it.
    ///
    /// # Errors
    /// As [`Held::get`].
    pub fn glance<U>(&self, look: impl FnOnce(&T) -> U) -> PyResult<U> {
        self.0.lock().map(|inner| look(&inner)).map_err(|_| broken())
    }
}

fn broken() -> pyo3::PyErr {
    PyRuntimeError::new_err("this object is broken by an earlier bug")
}
