//! Controllers for several drones that share the air.

use crazyflie_control::avoidance::CollisionAvoidance;
use crazyflie_control::{self as control, ControllerContext, Mode, build_each};
use crazyflie_env::Error;
use crazyflie_env::observation::ACTION;
use crazyflie_env::vector::METRICS;
use pyo3::prelude::*;
use serde_json::Value;

use crate::arrays::{empty, input, mask as read_mask, output};
use crate::custom::spec;
use crate::errors::guarded;
use crate::guarded_cell::GuardedCell;
use crate::sim::{Sim, detached};

fn bad(what: &'static str) -> impl Fn(serde_json::Error) -> Error {
    move |e| Error::Config(format!("{what}: {e}"))
}

/// Controllers for the drones of a `Sim` whose task has several: one for all of them, or one for each, by
/// their names or of one's own (see `Controller`). With a layer that avoids collisions (`avoid`: JSON of its parameters) or without it (`None`). `options` is JSON.
#[pyclass(module = "crazyflie_gym._native")]
pub struct Crowd {
    inner: GuardedCell<control::MultiController>,
    worlds: usize,
    drones: usize,
    width: usize,
}

#[pymethods]
impl Crowd {
    #[new]
    #[pyo3(signature = (names, of, *, options = "null", avoid = None))]
    fn new(names: Vec<Bound<'_, PyAny>>, of: &Sim, options: &str, avoid: Option<&str>) -> PyResult<Self> {
        let ([worlds, drones, width], known, tick_s) =
            (of.size(), of.interfaces_and_models()?, of.seconds_per_step()?);
        let (options, avoid) = guarded(|| {
            let options: Value = serde_json::from_str(options).map_err(bad("options"))?;
            let avoid = avoid.map(serde_json::from_str::<CollisionAvoidance>).transpose();
            Ok::<_, Error>((options, avoid.map_err(bad("avoid"))?))
        })?;
        let chosen = match &options {
            Value::Array(each) if each.len() == names.len() => {
                names.iter().zip(each).map(|(name, options)| spec(name, options.clone(), None)).collect()
            }
            _ => names.iter().map(|name| spec(name, options.clone(), None)).collect::<PyResult<Vec<_>>>(),
        }?;
        let inner = guarded(|| {
            let sites = known.iter().map(|(interface, model)| ControllerContext {
                model,
                interface: *interface,
                tick_s,
                envs: worlds,
                mode: Mode::Automatic,
            });
            control::MultiController::new(build_each(&chosen, sites)?, worlds, avoid, tick_s)
        })?;
        Ok(Crowd { inner: GuardedCell::new(inner), worlds, drones, width })
    }

    /// New actions, float32 (num_envs, num_drones, 4), for observations, float32 (num_envs, num_drones,
    /// width).
    fn act<'py>(&mut self, py: Python<'py>, observations: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let (w, n) = (self.worlds, self.drones);
        let rows = input::<f32>("observations", &[w, n, self.width], observations)?;
        let actions = empty::<f32>(py, (w, n, ACTION))?;
        let mut out = output::<f32>("actions", &[w, n, ACTION], &actions)?;
        let (rows, out) = (rows.as_slice()?, out.as_slice_mut()?);
        let inner = self.inner.get()?;
        detached(py, w * n, || inner.act(rows, out))?;
        Ok(actions)
    }

    /// Forget the flights: all, or those of the worlds of `mask` (bool, num_envs). Call it for every world
    /// that begins an episode.
    #[pyo3(signature = (mask = None))]
    fn reset(&mut self, mask: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let mask = mask.map(|mask| read_mask("mask", &[self.worlds], mask)).transpose()?;
        let is_chosen =
            |world: usize| mask.as_ref().is_none_or(|mask| mask.get(world).copied().unwrap_or(false));
        self.inner.get()?.reset(&is_chosen);
        Ok(())
    }
}

/// What is measured of an episode of several drones, in the order of the columns of `Sim.metrics()`: names,
/// units, meanings.
#[pyfunction]
pub fn metrics() -> Vec<(&'static str, &'static str, &'static str)> {
    METRICS.to_vec()
}
