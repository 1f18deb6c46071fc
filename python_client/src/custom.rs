//! Controllers that are written in Python, flown by the program like any other.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crazyflie_control::{
    Controller, ControllerContext, ControllerFactory, ControllerSpec, Mode, ObservationSpec, PythonSource,
    choose, with_observation,
};
use crazyflie_env::action::ACTION;
use crazyflie_env::vector::observation_width;
use crazyflie_env::{Error, Result};
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde_json::Value;

use crate::errors::guarded;
use crate::interface::Interface;

const MODULE: &str = "crazyflie_gym.custom";

thread_local! {
    /// The last exception of a controller, so that a caller in Python gets it unchanged.
    static RAISED: RefCell<Option<PyErr>> = const { RefCell::new(None) };
}

/// The exception of the controller that failed last on this thread.
pub fn take_raised() -> Option<PyErr> {
    RAISED.take()
}

/// Converts an exception of Python, with its traceback.
fn failure(py: Python<'_>, name: &str, raised: PyErr) -> Error {
    let text = || -> PyResult<String> {
        let value = raised.clone_ref(py).into_value(py);
        let lines = py.import("traceback")?.call_method1("format_exception", (value,))?;
        Ok(lines.extract::<Vec<String>>()?.concat())
    };
    let problem = text().unwrap_or_else(|_| raised.to_string());
    RAISED.set(Some(raised));
    Error::Controller { name: name.into(), problem: problem.trim_end().into() }
}

/// A class, function or object of Python.
struct PythonFactory {
    source: Py<PyAny>,
    label: String,
    options: Value,
    /// The observation that it reads unless it chooses its own.
    spec: ObservationSpec,
    /// An object flies one drone's rows at a time; what makes objects makes as many as there are drones.
    flies: Option<Arc<AtomicBool>>,
}

impl PythonFactory {
    fn new(source: &Bound<'_, PyAny>, label: String, options: Value, spec: ObservationSpec) -> PythonFactory {
        let makes_objects = source.is_callable() && !is_object(source);
        let flies = (!makes_objects).then(Arc::default);
        PythonFactory { source: source.clone().unbind(), label, options, spec, flies }
    }
}

/// Returns whether this is a controller rather than a factory of one.
fn is_object(source: &Bound<'_, PyAny>) -> bool {
    !source.is_instance_of::<pyo3::types::PyType>() && source.hasattr("act").unwrap_or(false)
}

impl ControllerFactory for PythonFactory {
    fn build(&self, site: &ControllerContext<'_>) -> Result<Box<dyn Controller>> {
        let lock = match &self.flies {
            Some(flies) if flies.swap(true, Ordering::AcqRel) => {
                return Err(Error::Config(format!(
                    "controller {}: this object flies a drone already; expected one object for each drone, or the class that makes them",
                    self.label
                )));
            }
            flies => flies.clone().map(FlightLock),
        };
        Python::attach(|py| {
            let made = || -> PyResult<(Py<PyAny>, Option<String>)> {
                let interface = Bound::new(
                    py,
                    Interface { inner: site.interface, tick_s: site.tick_s, shard_envs: usize::MAX },
                )?;
                let options = match &self.options {
                    Value::Null => "{}".to_owned(),
                    options => options.to_string(),
                };
                let options = py.import("json")?.call_method1("loads", (options,))?;
                let module = py.import(MODULE)?;
                let arguments = (&self.source, site.envs, interface, options, &self.label);
                let made = module.call_method1("make", arguments)?;
                let spec = made.call_method0("observation_json")?.extract()?;
                Ok((made.unbind(), spec))
            };
            let (inner, spec) = made().map_err(|raised| failure(py, &self.label, raised))?;
            let label = self.label.clone();
            let spec = match spec {
                Some(text) => serde_json::from_str(&text)
                    .map_err(|e| Error::Config(format!("controller {label}: observation: {e}")))?,
                None => self.spec.clone(),
            };
            let width = observation_width(&spec.observation, spec.history, spec.others)?;
            let size = [site.envs, width];
            let mut built = PythonController { inner, label, size, failed: None, _lock: lock };
            // an object may have flown before
            built.reset(&|_| true);
            built.set_mode(site.mode);
            match built.failed.take() {
                Some(error) => Err(error),
                None => with_observation(Box::new(built), site, spec, &self.label),
            }
        })
    }
}

/// Lets go of an object of Python when its controller is gone.
struct FlightLock(Arc<AtomicBool>);

impl Drop for FlightLock {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Release);
    }
}

struct PythonController {
    inner: Py<PyAny>,
    label: String,
    /// Environments, and numbers of an observation.
    size: [usize; 2],
    /// An error that occurred where nothing could be returned.
    failed: Option<Error>,
    _lock: Option<FlightLock>,
}

impl PythonController {
    fn note(&mut self, py: Python<'_>, done: PyResult<Bound<'_, PyAny>>) {
        if let Err(raised) = done {
            self.failed = Some(failure(py, &self.label, raised));
        }
    }
}

impl Controller for PythonController {
    fn set_mode(&mut self, mode: Mode) {
        Python::attach(|py| {
            let done = self.inner.bind(py).call_method1("set_mode", (mode.name(),));
            self.note(py, done);
        });
    }

    fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        let mask: Vec<bool> = (0..self.size[0]).map(of).collect();
        if !mask.contains(&true) {
            return;
        }
        Python::attach(|py| {
            let done = self.inner.bind(py).call_method1("reset", (PyArray1::from_slice(py, &mask),));
            self.note(py, done);
        });
    }

    fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        let [envs, width] = self.size;
        crazyflie_env::error::check_length("observations", envs * width, observations.len())?;
        crazyflie_env::error::check_length("actions", envs * ACTION, actions.len())?;
        if let Some(error) = self.failed.take() {
            return Err(error);
        }
        Python::attach(|py| {
            let mut answer = || -> PyResult<()> {
                // a copy: what the controller keeps or changes is its own
                let rows = PyArray1::from_slice(py, observations).reshape([envs, width])?;
                let answer = self.inner.bind(py).call_method1("act", (rows,))?;
                let answer = crate::arrays::input::<f32>("actions", &[envs, ACTION], &answer)?;
                actions.copy_from_slice(answer.as_slice()?);
                Ok(())
            };
            answer().map_err(|raised| failure(py, &self.label, raised))
        })
    }
}

/// Loads a controller file named as `python:FILE:NAME`.
pub fn load(source: &PythonSource<'_>) -> Result<Box<dyn ControllerFactory>> {
    Python::attach(|py| {
        let label = format!("python:{}:{}", source.path, source.name);
        let loaded = py.import(MODULE).and_then(|module| {
            module.call_method1("load", (PyBytes::new(py, source.code), source.path, source.name))
        });
        let class = loaded.map_err(|raised| failure(py, &label, raised))?;
        Ok(Box::new(PythonFactory::new(&class, label, source.options.clone(), source.observation.clone()))
            as Box<dyn ControllerFactory>)
    })
}

/// Returns the controller that a caller in Python chose: by its name, or an object, class or function of Python.
/// `file` is the content of the file that is named with it, read from the disk unless given.
pub fn spec(asked: &Bound<'_, PyAny>, options: Value, file: Option<&[u8]>) -> PyResult<ControllerSpec> {
    if let Ok(name) = asked.extract::<String>() {
        let read = |path: &str| file.map_or_else(|| std::fs::read(path), |file| Ok(file.to_vec()));
        return guarded(|| choose(&name, options, &read));
    }
    if !is_object(asked) && !asked.is_callable() {
        return Err(pyo3::exceptions::PyTypeError::new_err(format!(
            "controller: expected a name, an object with act(rows) -> actions, or a class or function that makes one, got {}",
            asked.get_type().name()?
        )));
    }
    let label: String = asked.py().import(MODULE)?.call_method1("label", (asked,))?.extract()?;
    let factory = PythonFactory::new(asked, label.clone(), options, ObservationSpec::default());
    Ok(ControllerSpec::from_factory(label, Arc::new(factory)))
}
