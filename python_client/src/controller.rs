//! The controllers of the registry, for a batch.

use crazyflie_control::{self as control, ControllerContext, ControllerSpec, ExtraInputs, InputNeeds, Mode};
use crazyflie_env::action::{self, ACTION};
use crazyflie_env::model::Model;
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::vector::STATE;
use crazyflie_env::{Error, Result};
use numpy::{PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;

use crate::arrays::{empty, input, mask as read_mask, narrowed, output};
use crate::custom::spec;
use crate::errors::guarded;
use crate::guarded_cell::GuardedCell;
use crate::interface::Interface;
use crate::rollout::BatchParts;
use crate::sim::{MAX_ENVS, Sim, detached};

/// The controller `name` (see `crazyflie_gym.controllers()`), `name:file` or `python:file:name`, for
/// `num_envs` environments with the command interface of `of` (a `Sim` or its `interface`); or one of one's
/// own, an object with `act(rows) -> actions`, or a class or function that makes one (see
/// `crazyflie_gym.custom`). It reads what an agent reads. `options` is JSON; `file` the content of the file,
/// which is read from the disk unless given; `model` the text of the model file that it believes in, the thesis's unless given; `mode`:
/// "automatic", "takeoff" or "landing".
#[pyclass(subclass, module = "crazyflie_gym._native")]
pub struct Controller {
    /// One for each part of the batch that a thread flies by itself in a rollout.
    inner: GuardedCell<Vec<Box<dyn control::Controller>>>,
    batch: BatchParts,
    label: String,
    /// Actions that it commands.
    pub interface: action::Interface,
    /// The observations of its environment are the measured rows that it reads.
    reads_rows: bool,
}

/// # Errors
/// `ValueError` for a controller whose environment observes something else than it reads.
pub fn check_rows(reads_rows: bool) -> PyResult<()> {
    if reads_rows {
        return Ok(());
    }
    Err(PyValueError::new_err(
        "observations: a controller reads what is measured, and this environment observes something else: call \
         `act(controller)` of the environment, or make it with observation=\"measured\"",
    ))
}

/// # Errors
/// `ValueError` for rows of another batch.
pub fn check_batch(got: usize, expected: usize) -> PyResult<()> {
    if got == expected {
        return Ok(());
    }
    Err(PyValueError::new_err(
        "controller: it was made for another batch: the `controller` method of the environment makes one",
    ))
}

impl Controller {
    fn build(
        num_envs: i64,
        of: &Bound<'_, PyAny>,
        model: Option<&str>,
        mode: &str,
        chosen: &ControllerSpec,
    ) -> PyResult<Self> {
        if !(1..=MAX_ENVS).contains(&num_envs) {
            return Err(PyValueError::new_err(format!("num_envs is {num_envs}, expected 1 to {MAX_ENVS}")));
        }
        let of_sim = of.cast::<Sim>();
        let reads_rows = of_sim.as_ref().map_or(Ok(true), |sim| sim.try_borrow()?.gives_measured())?;
        let of = if of_sim.is_ok() { of.getattr("interface")? } else { of.clone() };
        let Ok(interface) = of.cast::<Interface>() else {
            return Err(PyTypeError::new_err(format!(
                "of: expected a Sim or an Interface, got {}",
                of.get_type().name()?
            )));
        };
        let Interface { inner: interface, tick_s, shard_envs } = *interface.get();
        let envs = num_envs as usize;
        let divisible = chosen.is_divisible();
        let share = if divisible { shard_envs.min(envs) } else { envs };
        let inner = guarded(|| {
            let model = model.map_or_else(|| Ok(Model::thesis()), Model::parse)?;
            let mode = Mode::named(mode)?;
            let part = |first: usize| {
                let envs = share.min(envs - first);
                chosen.build_part(&ControllerContext { model: &model, interface, tick_s, envs, mode }, first)
            };
            (0..envs).step_by(share).map(part).collect::<Result<Vec<_>>>()
        })?;
        let label = chosen.label.clone();
        let batch = BatchParts { envs, share, divisible };
        Ok(Controller { inner: GuardedCell::new(inner), batch, label, interface, reads_rows })
    }

    /// Returns what it needs beside measured rows: each part the same.
    pub fn needs(&mut self) -> PyResult<InputNeeds> {
        Ok(self.inner.get()?.first().map_or_else(InputNeeds::default, |part| part.needs()))
    }

    /// Writes actions for measured rows, and true states where they are needed.
    pub fn answer(&mut self, py: Python<'_>, rows: &[f32], states: &[f32], out: &mut [f32]) -> PyResult<()> {
        let BatchParts { envs, share, .. } = self.batch;
        check_batch(rows.len(), envs * OBSERVATION)?;
        let parts = self.inner.get()?;
        detached(py, envs, || {
            let mut states = states.chunks(share * STATE);
            let rows = rows.chunks(share * OBSERVATION).zip(out.chunks_mut(share * ACTION));
            parts.iter_mut().zip(rows).try_for_each(|(part, (rows, out))| {
                if let Some(states) = states.next() {
                    part.set_inputs(ExtraInputs { states, others: &[] });
                }
                part.act(rows, out)
            })
        })
    }

    /// One for each part of a batch of `envs` environments, `share` in each.
    pub fn parts(&mut self, envs: usize, share: usize) -> PyResult<&mut [Box<dyn control::Controller>]> {
        self.batch.check(envs, share)?;
        self.inner.get().map(Vec::as_mut_slice)
    }
}

#[pymethods]
impl Controller {
    #[new]
    #[pyo3(signature = (name, num_envs, of, *, options = "null", model = None, mode = "automatic", file = None))]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        name: &Bound<'_, PyAny>,
        num_envs: i64,
        of: &Bound<'_, PyAny>,
        options: &str,
        model: Option<&str>,
        mode: &str,
        file: Option<&[u8]>,
    ) -> PyResult<Self> {
        let options: Value =
            guarded(|| serde_json::from_str(options).map_err(|e| Error::Config(format!("options: {e}"))))?;
        Self::build(num_envs, of, model, mode, &spec(name, options, file)?)
    }

    /// Environments that this controls.
    #[getter]
    fn num_envs(&self) -> usize {
        self.batch.envs
    }

    /// Go on in another state: "automatic", "takeoff" or "landing".
    fn set_mode(&mut self, mode: &str) -> PyResult<()> {
        let mode = guarded(|| Mode::named(mode))?;
        self.inner.get()?.iter_mut().for_each(|part| part.set_mode(mode));
        Ok(())
    }

    /// New actions, float32 (num_envs, 4), for observations, float32 (num_envs, 24); for one environment also
    /// (4,) for (24,).
    fn act<'py>(&mut self, py: Python<'py>, observations: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        check_rows(self.reads_rows)?;
        let envs = self.batch.envs;
        let flat = envs == 1 && observations.cast::<PyUntypedArray>().is_ok_and(|array| array.ndim() == 1);
        let (rows, observations) = ([envs, OBSERVATION], narrowed(observations)?);
        let rows = input::<f32>("observations", &rows[usize::from(flat)..], &observations)?;
        let actions = if flat { empty::<f32>(py, (ACTION,))? } else { empty::<f32>(py, (envs, ACTION))? };
        let shape = [envs, ACTION];
        let mut out = output::<f32>("actions", &shape[usize::from(flat)..], &actions)?;
        self.answer(py, rows.as_slice()?, &[], out.as_slice_mut()?)?;
        Ok(actions)
    }

    /// Raise `ValueError` for a controller that reads more than measurements of one drone; `reason` says why no true state
    /// is known.
    fn check_measured(&mut self, reason: &str) -> PyResult<()> {
        let name = format!("controller {}", self.label);
        let needs = self.needs()?;
        guarded(|| needs.refuse_truth(&name, reason).and_then(|()| needs.check_others(&name, 0)))
    }

    fn __repr__(&self) -> String {
        format!("Controller({:?}, num_envs={})", self.label, self.batch.envs)
    }

    /// Forget the flights: all, or those of `mask` (bool, num_envs). Call it for every environment that
    /// begins an episode.
    #[pyo3(signature = (mask = None))]
    fn reset(&mut self, mask: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let mask = mask.map(|mask| read_mask("mask", &[self.batch.envs], mask)).transpose()?;
        let is_chosen = |env: usize| mask.as_ref().is_none_or(|mask| mask.get(env).copied().unwrap_or(false));
        let share = self.batch.share;
        for (i, part) in self.inner.get()?.iter_mut().enumerate() {
            part.reset(&|env| is_chosen(i * share + env));
        }
        Ok(())
    }
}

/// The PID of the thesis. `gains`: "thesis" (table 7.1) or "crazyflie_ros".
#[pyclass(extends = Controller, module = "crazyflie_gym._native")]
pub struct Pid;

#[pymethods]
impl Pid {
    #[new]
    #[pyo3(signature = (num_envs, of, gains = "thesis", mode = "automatic"))]
    fn new(
        num_envs: i64,
        of: &Bound<'_, PyAny>,
        gains: &str,
        mode: &str,
    ) -> PyResult<PyClassInitializer<Self>> {
        let chosen = guarded(|| ControllerSpec::named(gains))?;
        let controller = Controller::build(num_envs, of, None, mode, &chosen)?;
        Ok(PyClassInitializer::from(controller).add_subclass(Pid))
    }
}

/// Every controller, as a dict: name, also (another name, or None), about, source, file (what is in the file
/// that is named with it, or None), member (what of the file is named, or None), options (name and meaning), defaults (JSON).
#[pyfunction]
pub fn controllers(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    let controller_dict = |entry: &&control::Entry| {
        let dict = PyDict::new(py);
        for (key, text) in [("name", entry.name), ("about", entry.about), ("source", entry.source)] {
            dict.set_item(key, text)?;
        }
        dict.set_item("also", entry.also)?;
        dict.set_item("file", entry.file)?;
        dict.set_item("member", entry.member)?;
        let options = PyDict::new(py);
        entry.options.iter().try_for_each(|(name, about)| options.set_item(name, about))?;
        dict.set_item("options", options)?;
        dict.set_item("defaults", (entry.defaults)().to_string())?;
        Ok(dict)
    };
    control::registry().iter().map(controller_dict).collect()
}
