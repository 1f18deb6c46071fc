//! The controller of `crazyflie_ros`, for a batch.

use crazyflie_env::Result;
use crazyflie_env::control::pid::{Gains, Mode, PidBatch};
use crazyflie_env::observation::{ACTION, OBSERVATION};
use numpy::{PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

use crate::arrays::{empty, input, mask as read_mask, output};
use crate::errors::guarded;
use crate::sim::{Interface, MOST_ENVS, Sim, detached};

/// The PID of the thesis for `num_envs` environments with the command interface of `of` (a `Sim` or its `interface`). It reads what an
/// agent reads. `gains`: "thesis" (table 7.1) or "crazyflie_ros"; `mode`: "automatic", "takeoff" or "landing".
#[pyclass(module = "crazyflie_gym._native")]
pub struct Pid {
    batch: PidBatch,
    envs: usize,
}

#[pymethods]
impl Pid {
    #[new]
    #[pyo3(signature = (num_envs, of, gains = "thesis", mode = "automatic"))]
    fn new(num_envs: i64, of: &Bound<'_, PyAny>, gains: &str, mode: &str) -> PyResult<Self> {
        if !(1..=MOST_ENVS).contains(&num_envs) {
            return Err(PyValueError::new_err(format!("num_envs is {num_envs}, expected 1 to {MOST_ENVS}")));
        }
        let of = if of.is_instance_of::<Sim>() { of.getattr("interface")? } else { of.clone() };
        let Ok(interface) = of.cast::<Interface>() else {
            return Err(PyTypeError::new_err(format!("of: expected a Sim or an Interface, got {}", of.get_type().name()?)));
        };
        let (interface, tick_s) = (interface.get().inner, interface.get().tick_s);
        let envs = num_envs as usize;
        let batch = guarded(|| -> Result<_> { Ok(PidBatch::new(envs, Gains::named(gains)?, interface, tick_s, Mode::named(mode)?)) })?;
        Ok(Pid { batch, envs })
    }

    /// Environments that this controls.
    #[getter]
    fn num_envs(&self) -> usize {
        self.envs
    }

    /// New actions, float32 (num_envs, 4), for observations, float32 (num_envs, 24); for one environment also (4,) for (24,).
    fn act<'py>(&mut self, py: Python<'py>, observations: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let flat = self.envs == 1 && observations.cast::<PyUntypedArray>().is_ok_and(|array| array.ndim() == 1);
        let rows = [self.envs, OBSERVATION];
        let rows = input::<f32>("observations", &rows[usize::from(flat)..], observations)?;
        let actions = if flat { empty::<f32>(py, (ACTION,))? } else { empty::<f32>(py, (self.envs, ACTION))? };
        let shape = [self.envs, ACTION];
        let mut out = output::<f32>("actions", &shape[usize::from(flat)..], &actions)?;
        let (rows, out, batch) = (rows.as_slice()?, out.as_slice_mut()?, &mut self.batch);
        detached(py, self.envs, || batch.act(rows, out))?;
        Ok(actions)
    }

    /// Forget the flights: all, or those of `mask` (bool, num_envs). Call it for every environment that begins an episode.
    #[pyo3(signature = (mask = None))]
    fn reset(&mut self, mask: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let mask = mask.map(|mask| read_mask("mask", &[self.envs], mask)).transpose()?;
        self.batch.reset(|env| mask.as_ref().is_none_or(|mask| mask.get(env).copied().unwrap_or(false)));
        Ok(())
    }
}
