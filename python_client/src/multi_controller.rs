//! Controllers for several drones that share the air.

use crazyflie_control::avoidance::CollisionAvoidance;
use crazyflie_control::{self as control, ControllerContext, ControllerSpec, InputNeeds, Mode, build_each};
use crazyflie_env::action::{self, ACTION};
use crazyflie_env::coupling::NEIGHBOUR;
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::vector::{METRICS, STATE};
use crazyflie_env::{Error, Result};
use pyo3::prelude::*;
use serde_json::Value;

use crate::arrays::{empty, input, mask as read_mask, output};
use crate::controller::{check_batch, check_rows};
use crate::custom::spec;
use crate::errors::guarded;
use crate::guarded_cell::GuardedCell;
use crate::rollout::BatchParts;
use crate::sim::{Sim, detached};

fn bad(what: &'static str) -> impl Fn(serde_json::Error) -> Error {
    move |e| Error::Config(format!("{what}: {e}"))
}

/// Controllers for the drones of a `Sim` whose task has several: one for all of them, or one for each, by
/// their names or of one's own (see `Controller`). With a layer that avoids collisions (`avoid`: JSON of its parameters) or without it (`None`). `options` is JSON.
/// With `drone` it flies that one alone, whose rows hold all others.
#[pyclass(module = "crazyflie_gym._native")]
pub struct Crowd {
    /// One for each part of the batch that a thread flies by itself in a rollout.
    inner: GuardedCell<Vec<control::MultiController>>,
    batch: BatchParts,
    drones: usize,
    /// Actions that the first drone's controller commands.
    pub interface: action::Interface,
    /// Numbers of a drone's measured row.
    width: usize,
    /// The observations of its environment are the measured rows that it reads.
    reads_rows: bool,
}

impl Crowd {
    /// Returns what its controllers need beside measured rows: each part the same.
    pub fn needs(&mut self) -> PyResult<InputNeeds> {
        Ok(self.inner.get()?.first().map_or_else(InputNeeds::default, control::MultiController::needs))
    }

    /// Writes actions for measured rows, and true states where they are needed.
    pub fn answer(&mut self, py: Python<'_>, rows: &[f32], states: &[f32], out: &mut [f32]) -> PyResult<()> {
        let (w, n) = (self.batch.envs, self.drones);
        check_batch(rows.len(), w * n * self.width)?;
        let (share, width, parts) = (self.batch.share * n, self.width, self.inner.get()?);
        detached(py, w * n, || {
            let mut states = states.chunks(share * STATE);
            let rows = rows.chunks(share * width).zip(out.chunks_mut(share * ACTION));
            parts.iter_mut().zip(rows).try_for_each(|(part, (rows, out))| {
                if let Some(states) = states.next() {
                    part.set_states(states);
                }
                part.act(rows, out)
            })
        })
    }

    /// One for each part of a batch of `worlds` worlds, `share` in each.
    pub fn parts(&mut self, worlds: usize, share: usize) -> PyResult<&mut [control::MultiController]> {
        self.batch.check(worlds, share)?;
        self.inner.get().map(Vec::as_mut_slice)
    }
}

#[pymethods]
impl Crowd {
    #[new]
    #[pyo3(signature = (names, of, *, options = "null", avoid = None, drone = None))]
    fn new(
        names: Vec<Bound<'_, PyAny>>,
        of: &Sim,
        options: &str,
        avoid: Option<&str>,
        drone: Option<usize>,
    ) -> PyResult<Self> {
        let ([worlds, all, _], mut known, tick_s) =
            (of.size(), of.interfaces_and_models()?, of.seconds_per_step()?);
        if let Some(drone) = drone {
            let missing = || Error::Config(format!("drone is {drone}, expected less than {all}"));
            known = vec![guarded(|| known.into_iter().nth(drone).ok_or_else(missing))?];
        }
        let drones = known.len();
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
        let divisible = chosen.iter().all(ControllerSpec::is_divisible);
        let share = if divisible { of.shard_envs()? } else { worlds };
        let inner = guarded(|| {
            let part = |first: usize| {
                let envs = share.min(worlds - first);
                let sites = known.iter().map(|(interface, model)| ControllerContext {
                    model,
                    interface: *interface,
                    tick_s,
                    envs,
                    mode: Mode::Automatic,
                });
                let controllers = build_each(&chosen, sites, first)?;
                control::MultiController::among(controllers, all - 1, envs, avoid, tick_s)
            };
            (0..worlds).step_by(share).map(part).collect::<Result<Vec<_>>>()
        })?;
        let batch = BatchParts { envs: worlds, share, divisible };
        let (width, reads_rows) = (OBSERVATION + NEIGHBOUR * (all - 1), of.gives_measured()?);
        let interface = known[0].0;
        Ok(Crowd { inner: GuardedCell::new(inner), batch, drones, interface, width, reads_rows })
    }

    /// New actions, float32 (num_envs, num_drones, 4), for observations, float32 (num_envs, num_drones,
    /// width).
    fn act<'py>(&mut self, py: Python<'py>, observations: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        check_rows(self.reads_rows)?;
        let (w, n) = (self.batch.envs, self.drones);
        let rows = input::<f32>("observations", &[w, n, self.width], observations)?;
        let actions = empty::<f32>(py, (w, n, ACTION))?;
        let mut out = output::<f32>("actions", &[w, n, ACTION], &actions)?;
        self.answer(py, rows.as_slice()?, &[], out.as_slice_mut()?)?;
        Ok(actions)
    }

    /// Raise `ValueError` for controllers that read the true state; `reason` says why none is known.
    fn check_measured(&mut self, reason: &str) -> PyResult<()> {
        let needs = self.needs()?;
        guarded(|| needs.refuse_truth("controller", reason))
    }

    /// Forget the flights: all, or those of the worlds of `mask` (bool, num_envs). Call it for every world
    /// that begins an episode.
    #[pyo3(signature = (mask = None))]
    fn reset(&mut self, mask: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let mask = mask.map(|mask| read_mask("mask", &[self.batch.envs], mask)).transpose()?;
        let is_chosen =
            |world: usize| mask.as_ref().is_none_or(|mask| mask.get(world).copied().unwrap_or(false));
        let share = self.batch.share;
        for (i, part) in self.inner.get()?.iter_mut().enumerate() {
            part.reset(&|world| is_chosen(i * share + world));
        }
        Ok(())
    }
}

/// The metrics of an episode of several drones, in the order of the columns of `Sim.metrics()`: names, units,
/// meanings.
#[pyfunction]
pub fn metrics() -> Vec<(&'static str, &'static str, &'static str)> {
    METRICS.to_vec()
}
