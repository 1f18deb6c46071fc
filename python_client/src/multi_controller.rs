//! Controllers for several drones that share the air.

use crazyflie_control::avoidance::CollisionAvoidance;
use crazyflie_control::{
    Controller, ControllerContext, ControllerSpec, ExtraInputs, InputNeeds, Mode, MultiController, build_each,
};
use crazyflie_env::coupling::NEIGHBOUR;
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::vector::METRICS;
use crazyflie_env::{Error, Result};
use pyo3::prelude::*;
use serde_json::Value;

use crate::custom::spec;
use crate::errors::{guarded, parse_json};
use crate::parts::{ControlledBatch, PartControllers};
use crate::sim::Sim;

/// Controllers for the drones of a `Sim` whose task has several: one for all of them, or one for each, by
/// their names or of one's own (see `Controller`). With a layer that avoids collisions (`avoid`: JSON of its parameters) or without it (`None`). `options` is JSON.
/// With `drone` it flies that one alone, whose rows hold all others.
#[pyclass(module = "crazyflie_gym._native")]
pub struct Crowd {
    pub parts: PartControllers,
}

/// Controllers of several drones as one of their batch.
struct Together(MultiController);

impl Controller for Together {
    fn set_mode(&mut self, mode: Mode) {
        self.0.set_mode(mode);
    }
    fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        self.0.reset(of);
    }
    fn needs(&self) -> InputNeeds {
        self.0.needs()
    }
    fn set_inputs(&mut self, inputs: ExtraInputs<'_>) {
        self.0.set_states(inputs.states);
    }
    fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        self.0.act(observations, actions)
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
        let ([worlds, all, _], mut known, tick_s) = (of.size(), of.interfaces_and_models()?, of.tick_s()?);
        if let Some(drone) = drone {
            let missing = || Error::Config(format!("drone is {drone}, expected less than {all}"));
            known = vec![guarded(|| known.into_iter().nth(drone).ok_or_else(missing))?];
        }
        let (options, avoid) = guarded(|| {
            let avoid = avoid.map(|text| parse_json::<CollisionAvoidance>("avoid", text)).transpose();
            Ok::<_, Error>((parse_json::<Value>("options", options)?, avoid?))
        })?;
        let chosen = match &options {
            Value::Array(each) if each.len() == names.len() => {
                names.iter().zip(each).map(|(name, options)| spec(name, options.clone(), None)).collect()
            }
            _ => names.iter().map(|name| spec(name, options.clone(), None)).collect::<PyResult<Vec<_>>>(),
        }?;
        let divisible = chosen.iter().all(ControllerSpec::is_divisible);
        let share = if divisible { of.shard_envs()? } else { worlds };
        let batch = ControlledBatch {
            envs: worlds,
            drones: known.len(),
            width: OBSERVATION + NEIGHBOUR * (all - 1),
            share,
            divisible,
            reads_rows: of.gives_measured()?,
            interface: known[0].0,
        };
        let parts = PartControllers::build(batch, |first, envs| {
            let sites = known.iter().map(|(interface, model)| ControllerContext {
                model,
                interface: *interface,
                tick_s,
                envs,
                mode: Mode::Automatic,
            });
            let controllers = build_each(&chosen, sites, first)?;
            let together = MultiController::among(controllers, all - 1, envs, avoid, tick_s)?;
            Ok(Box::new(Together(together)) as Box<dyn Controller>)
        })?;
        Ok(Crowd { parts })
    }

    /// New actions, float32 (num_envs, num_drones, 4), for observations, float32 (num_envs, num_drones,
    /// width).
    fn act<'py>(&mut self, py: Python<'py>, observations: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let ControlledBatch { envs, drones, .. } = self.parts.of;
        self.parts.act(py, observations, &[envs, drones])
    }

    /// Raise `ValueError` for controllers that read the true state; `reason` says why none is known.
    fn check_measured(&mut self, reason: &str) -> PyResult<()> {
        let needs = self.parts.needs()?;
        guarded(|| needs.refuse_truth("controller", reason))
    }

    /// Forget the flights: all, or those of the worlds of `mask` (bool, num_envs). Call it for every world
    /// that begins an episode.
    #[pyo3(signature = (mask = None))]
    fn reset(&mut self, mask: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        self.parts.reset(mask)
    }
}

/// The metrics of an episode of several drones, in the order of the columns of `Sim.metrics()`: names, units,
/// meanings.
#[pyfunction]
pub fn metrics() -> Vec<(&'static str, &'static str, &'static str)> {
    METRICS.to_vec()
}
