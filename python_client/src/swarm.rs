//! Worlds that several drones share.

use crazyflie_env::control::avoid::Avoid;
use crazyflie_env::control::{self, Mode, Site, choose};
use crazyflie_env::model::Model;
use crazyflie_env::observation::ACTION;
use crazyflie_env::swarm::{METRICS, MOST_DRONES, SwarmEnv, SwarmOptions, SwarmOut, mission};
use crazyflie_env::vector::STATE;
use crazyflie_env::{Error, Result};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;

use crate::arrays::{empty, input, mask as read_mask, output};
use crate::errors::guarded;
use crate::held::Held;
use crate::sim::{Interface, MOST_ENVS, detached};

/// Observations, rewards, terminated, truncated, flying, metrics.
type Step<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>);

/// A batch of `num_worlds` worlds of several drones. `options` is JSON (see `crazyflie_gym.swarm`), `models` the texts of model files: none for
/// the thesis's, one for all drones, or one for each.
#[pyclass(module = "crazyflie_gym._native")]
pub struct Swarm {
    env: Held<SwarmEnv>,
    models: Vec<Model>,
    worlds: usize,
    drones: usize,
    width: usize,
    tick_s: f64,
}

#[pymethods]
impl Swarm {
    #[new]
    #[pyo3(signature = (num_worlds, options = "{}", models = None))]
    fn new(py: Python<'_>, num_worlds: i64, options: &str, models: Option<Vec<String>>) -> PyResult<Self> {
        let most = MOST_ENVS / MOST_DRONES as i64;
        if !(1..=most).contains(&num_worlds) {
            return Err(PyValueError::new_err(format!("num_worlds is {num_worlds}, expected 1 to {most}")));
        }
        let worlds = num_worlds as usize;
        let (env, models) = py.detach(|| {
            guarded(|| {
                let texts = models.unwrap_or_default();
                let mut models = texts.iter().map(|text| Model::parse(text)).collect::<Result<Vec<_>>>()?;
                if models.is_empty() {
                    models.push(Model::thesis());
                }
                Ok::<_, Error>((SwarmEnv::new(&models, &SwarmOptions::parse(options)?, worlds)?, models))
            })
        })?;
        let (drones, width, tick_s) = (env.num_drones(), env.width(), env.tick_s());
        Ok(Swarm { env: Held::new(env), models, worlds, drones, width, tick_s })
    }

    /// Worlds in the batch.
    #[getter]
    fn num_worlds(&self) -> usize {
        self.worlds
    }

    /// Drones in each world.
    #[getter]
    fn num_drones(&self) -> usize {
        self.drones
    }

    /// Numbers in a drone's observation: its own 24, then 8 for each of the others.
    #[getter]
    fn width(&self) -> usize {
        self.width
    }

    /// Seconds per step.
    #[getter]
    fn tick_s(&self) -> f64 {
        self.tick_s
    }

    /// The instruction set in use: "baseline", "avx2" or "avx512". The results are the same.
    #[getter]
    fn isa(&self) -> PyResult<&'static str> {
        self.env.glance(|env| env.level().name())
    }

    /// What an action of a drone means.
    fn interface(&self, drone: usize) -> PyResult<Interface> {
        let inner = self.env.glance(|env| env.interface(drone))?;
        let inner = inner.ok_or_else(|| PyIndexError::new_err(format!("drone is {drone}, expected 0 to {}", self.drones - 1)))?;
        Ok(Interface { inner, tick_s: self.tick_s })
    }

    /// Begin episodes: in all worlds, or in those of `mask`. With `seeds` the first episode of each seed, without them the next. Writes the
    /// rows of `observations` (num_worlds, num_drones, width) that begin, or makes a new array, and returns it.
    #[pyo3(signature = (seeds = None, mask = None, observations = None))]
    fn reset<'py>(
        &mut self,
        py: Python<'py>,
        seeds: Option<&Bound<'py, PyAny>>,
        mask: Option<&Bound<'py, PyAny>>,
        observations: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (worlds, shape) = (self.worlds, [self.worlds, self.drones, self.width]);
        let seeds = seeds.map(|seeds| input::<u64>("seeds", &[worlds], seeds)).transpose()?;
        let seeds = seeds.as_ref().map(|seeds| seeds.as_slice()).transpose()?;
        let mask = mask.map(|mask| read_mask("reset_mask", &[worlds], mask)).transpose()?;
        let rows = match observations {
            Some(given) => given,
            None => numpy::PyArray3::<f32>::zeros(py, shape, false).into_any(),
        };
        let mut out = output::<f32>("observations", &shape, &rows)?;
        let (env, out) = (self.env.get()?, out.as_slice_mut()?);
        detached(py, worlds, || env.reset(seeds, mask.as_deref(), out))?;
        Ok(rows)
    }

    /// One step of every world: float32 actions (num_worlds, num_drones, 4) from -1 to 1. Returns new arrays: observations (num_worlds,
    /// num_drones, width), rewards, terminated, truncated, flying (num_worlds, num_drones), metrics (num_worlds, 6).
    fn step<'py>(&mut self, py: Python<'py>, actions: &Bound<'py, PyAny>) -> PyResult<Step<'py>> {
        let (w, n) = (self.worlds, self.drones);
        let (observations, rewards) = (empty::<f32>(py, (w, n, self.width))?, empty::<f32>(py, (w, n))?);
        let (terminated, truncated) = (empty::<bool>(py, (w, n))?, empty::<bool>(py, (w, n))?);
        let (flying, metrics) = (empty::<bool>(py, (w, n))?, empty::<f32>(py, (w, METRICS.len()))?);
        {
            let actions = input::<f32>("actions", &[w, n, ACTION], actions)?;
            let mut o = output::<f32>("observations", &[w, n, self.width], &observations)?;
            let mut r = output::<f32>("rewards", &[w, n], &rewards)?;
            let mut t = output::<bool>("terminated", &[w, n], &terminated)?;
            let mut u = output::<bool>("truncated", &[w, n], &truncated)?;
            let mut f = output::<bool>("flying", &[w, n], &flying)?;
            let mut m = output::<f32>("metrics", &[w, METRICS.len()], &metrics)?;
            let out = SwarmOut {
                observations: o.as_slice_mut()?,
                rewards: r.as_slice_mut()?,
                terminated: t.as_slice_mut()?,
                truncated: u.as_slice_mut()?,
                flying: f.as_slice_mut()?,
                metrics: m.as_slice_mut()?,
            };
            let (env, actions) = (self.env.get()?, actions.as_slice()?);
            detached(py, w * n, || env.step(actions, out))?;
        }
        Ok((observations, rewards, terminated, truncated, flying, metrics))
    }

    /// The true states, float32 (num_worlds, num_drones, 12): position, velocity, roll pitch yaw, their rates; metres, seconds, radians.
    fn states<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let shape = (self.worlds, self.drones, STATE);
        let states = empty::<f32>(py, shape)?;
        let mut out = output::<f32>("states", &[shape.0, shape.1, shape.2], &states)?;
        let (env, rows) = (self.env.get()?, out.as_slice_mut()?);
        guarded(|| env.states(rows))?;
        Ok(states)
    }

    /// Where the loads are, float32 (num_worlds, 3), or `None` where nothing is carried.
    fn loads<'py>(&mut self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let loads = empty::<f32>(py, (self.worlds, 3))?;
        let mut out = output::<f32>("loads", &[self.worlds, 3], &loads)?;
        let (env, rows) = (self.env.get()?, out.as_slice_mut()?);
        let carried = guarded(|| env.loads(rows))?;
        Ok(carried.then_some(loads))
    }

    /// Of an episode that ended in the last step of world `world`, when automatic resets happen in the same step: the drones' last
    /// observations, float32 (num_drones * width,). `None` in the other modes and out of range.
    fn last_of_episode<'py>(&mut self, py: Python<'py>, world: usize) -> PyResult<Option<Bound<'py, PyAny>>> {
        if world >= self.worlds {
            return Ok(None);
        }
        Ok(self.env.get()?.last_of_episode(world).map(|rows| crate::arrays::row(py, rows).into_any()))
    }
}

fn bad(what: &'static str) -> impl Fn(serde_json::Error) -> Error {
    move |e| Error::Config(format!("{what}: {e}"))
}

/// A controller of `crazyflie_gym.controllers()` for every drone of a `Swarm`, with a layer that avoids collisions (`avoid`: JSON of its
/// parameters) or without it (`None`). `options` is JSON.
#[pyclass(module = "crazyflie_gym._native")]
pub struct Crowd {
    inner: Held<control::Crowd>,
    worlds: usize,
    drones: usize,
    width: usize,
}

#[pymethods]
impl Crowd {
    #[new]
    #[pyo3(signature = (name, of, *, options = "null", avoid = None))]
    fn new(name: &str, of: &Swarm, options: &str, avoid: Option<&str>) -> PyResult<Self> {
        let interfaces = of.env.glance(|env| (0..of.drones).filter_map(|j| env.interface(j)).collect::<Vec<_>>())?;
        let inner = guarded(|| {
            let options: Value = serde_json::from_str(options).map_err(bad("options"))?;
            let avoid = avoid.map(serde_json::from_str::<Avoid>).transpose().map_err(bad("avoid"))?;
            let chosen = choose(name, options, &|path| std::fs::read(path))?;
            let one = |(j, interface): (usize, &crazyflie_env::observation::Interface)| {
                let model = of.models.get(j).unwrap_or(&of.models[0]);
                chosen.build(&Site { model, interface: *interface, tick_s: of.tick_s, envs: of.worlds, mode: Mode::Automatic })
            };
            let controllers = interfaces.iter().enumerate().map(one).collect::<Result<_>>()?;
            control::Crowd::new(controllers, of.worlds, avoid, of.tick_s)
        })?;
        Ok(Crowd { inner: Held::new(inner), worlds: of.worlds, drones: of.drones, width: of.width })
    }

    /// New actions, float32 (num_worlds, num_drones, 4), for observations, float32 (num_worlds, num_drones, width).
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

    /// Forget the flights: all, or those of the worlds of `mask` (bool, num_worlds). Call it for every world that begins an episode.
    #[pyo3(signature = (mask = None))]
    fn reset(&mut self, mask: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let mask = mask.map(|mask| read_mask("mask", &[self.worlds], mask)).transpose()?;
        let of = |world: usize| mask.as_ref().is_none_or(|mask| mask.get(world).copied().unwrap_or(false));
        self.inner.get()?.reset(&of);
        Ok(())
    }
}

/// Every mission of several drones, as a dict: name, id (Gymnasium's), about, reward, max_episode_steps, drones.
#[pyfunction]
pub fn missions(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    let one = |entry: &mission::Entry| {
        let dict = PyDict::new(py);
        for (key, text) in [("name", entry.name), ("id", entry.id), ("about", entry.about), ("reward", entry.reward)] {
            dict.set_item(key, text)?;
        }
        dict.set_item("max_episode_steps", entry.max_episode_steps)?;
        dict.set_item("drones", entry.drones)?;
        Ok(dict)
    };
    mission::registry().iter().map(one).collect()
}

/// What is measured of a world's episode: name, unit and meaning of each column of a step's metrics.
#[pyfunction]
pub fn metrics() -> Vec<(&'static str, &'static str, &'static str)> {
    METRICS.to_vec()
}
