//! The controllers of the registry, for a batch.

use crazyflie_control::{self as control, ControllerContext, ControllerSpec, Mode};
use crazyflie_env::Error;
use crazyflie_env::model::Model;
use crazyflie_env::observation::OBSERVATION;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict};

use crate::arrays::{narrowed, shape_of};
use crate::custom::spec;
use crate::errors::{guarded, parse_json};
use crate::interface::Interface;
use crate::parts::{ControlledBatch, PartControllers};
use crate::sim::{Sim, checked_envs};

/// The controller `name` (see `crazyflie_gym.controllers()`), `name:file` or `python:file:name`, for
/// `num_envs` environments with the command interface of `of` (a `Sim` or its `interface`); or one of one's
/// own, an object with `act(rows) -> actions`, or a class or function that makes one (see
/// `crazyflie_gym.custom`). It reads what an agent reads. `options` is JSON; `file` the content of the file,
/// which is read from the disk unless given; `model` the text of the model file that it believes in, the thesis's unless given; `mode`:
/// "automatic", "takeoff" or "landing".
#[pyclass(subclass, module = "crazyflie_gym._native")]
pub struct Controller {
    pub parts: PartControllers,
    label: String,
}

impl Controller {
    fn build(
        num_envs: i64,
        of: &Bound<'_, PyAny>,
        model: Option<&str>,
        mode: &str,
        chosen: &ControllerSpec,
    ) -> PyResult<Self> {
        let envs = checked_envs(num_envs)?;
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
        let divisible = chosen.is_divisible();
        let share = if divisible { shard_envs.min(envs) } else { envs };
        let (model, mode) = guarded(|| {
            let model = model.map_or_else(|| Ok(Model::thesis()), Model::parse)?;
            Ok::<_, Error>((model, Mode::named(mode)?))
        })?;
        let of =
            ControlledBatch { envs, drones: 1, width: OBSERVATION, share, divisible, reads_rows, interface };
        let parts = PartControllers::build(of, |first, envs| {
            chosen.build_part(&ControllerContext { model: &model, interface, tick_s, envs, mode }, first)
        })?;
        Ok(Controller { parts, label: chosen.label.clone() })
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
        let options = guarded(|| parse_json("options", options))?;
        Self::build(num_envs, of, model, mode, &spec(name, options, file)?)
    }

    /// Environments that this controls.
    #[getter]
    fn num_envs(&self) -> usize {
        self.parts.of.envs
    }

    /// Go on in another state: "automatic", "takeoff" or "landing".
    fn set_mode(&mut self, mode: &str) -> PyResult<()> {
        let mode = guarded(|| Mode::named(mode))?;
        self.parts.all()?.iter_mut().for_each(|part| part.set_mode(mode));
        Ok(())
    }

    /// New actions, float32 (num_envs, 4), for observations, float32 (num_envs, 24); for one environment also
    /// (4,) for (24,).
    fn act<'py>(&mut self, py: Python<'py>, observations: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let lead = [self.parts.of.envs];
        let flat = lead == [1] && shape_of(observations).len() == 1;
        self.parts.act(py, &narrowed(observations)?, &lead[usize::from(flat)..])
    }

    /// Raise `ValueError` for a controller that reads more than measurements of one drone; `reason` says why no true state
    /// is known.
    fn check_measured(&mut self, reason: &str) -> PyResult<()> {
        let name = format!("controller {}", self.label);
        let needs = self.parts.needs()?;
        guarded(|| needs.refuse_truth(&name, reason).and_then(|()| needs.check_others(&name, 0)))
    }

    fn __repr__(&self) -> String {
        format!("Controller({:?}, num_envs={})", self.label, self.parts.of.envs)
    }

    /// Forget the flights: all, or those of `mask` (bool, num_envs). Call it for every environment that
    /// begins an episode.
    #[pyo3(signature = (mask = None))]
    fn reset(&mut self, mask: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        self.parts.reset(mask)
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
        let dict =
            [("name", entry.name), ("about", entry.about), ("source", entry.source)].into_py_dict(py)?;
        dict.set_item("also", entry.also)?;
        dict.set_item("file", entry.file)?;
        dict.set_item("member", entry.member)?;
        dict.set_item("options", entry.options.into_py_dict(py)?)?;
        dict.set_item("defaults", (entry.defaults)().to_string())?;
        Ok(dict)
    };
    control::registry().iter().map(controller_dict).collect()
}
