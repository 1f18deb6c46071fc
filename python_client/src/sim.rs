//! A batch of environments.

use crazyflie_env::action::{self, ACTION};
use crazyflie_env::config::Options;
use crazyflie_env::error::check_range;
use crazyflie_env::model::Model;
use crazyflie_env::vector::{METRICS, STATE, StepBuffers, VectorEnv};
use crazyflie_env::{Error, Result};
use numpy::{PyArray1, PyArrayDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple, PyType};

use crate::arrays::{empty, input, mask as read_mask, output, shape_of, shaped};
use crate::errors::{Failure, guarded};
use crate::guarded_cell::GuardedCell;
use crate::interface::Interface;
use crate::pilot::BorrowedPilot;
use crate::rollout::{LastStep, RolloutArrays};

/// Beyond this the buffers of a step alone take gigabytes.
const MAX_ENVS: i64 = 1 << 22;

/// Letting go of the interpreter costs more than stepping this many.
pub const FEW_ENVS: usize = 16;

/// Observations, rewards, terminated, truncated, number of episodes that ended.
pub type Step<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, usize);
/// The last observation and true state of an episode.
type Last<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>);
/// Class, arguments, state.
type PickleState<'py> = (Bound<'py, PyType>, (usize, String, Option<Vec<String>>), Bound<'py, PyBytes>);
/// Observation, reward, terminated, truncated, info.
pub type StepOne<'py> = (Bound<'py, PyArray1<f32>>, f64, bool, bool, Bound<'py, PyDict>);

/// A batch of `num_envs` environments. `options` is JSON (see `crazyflie_gym.options`), `models` the texts of
/// model files: none for the thesis's, one for all drones, or one for each drone of an environment.
#[pyclass(subclass, module = "crazyflie_gym._native")]
pub struct Sim {
    env: GuardedCell<VectorEnv>,
    models: Vec<Model>,
    /// Environments in the batch.
    #[pyo3(get, name = "num_envs")]
    envs: usize,
    /// Drones in each environment.
    #[pyo3(get, name = "num_drones")]
    drones: usize,
    /// Numbers in a drone's observation.
    #[pyo3(get)]
    width: usize,
    /// The first axes of all arrays: environments, and where a task has several drones also these.
    lead: Vec<usize>,
    /// Results of the last step.
    last: LastStep,
    /// The observation of a batch of one.
    row: Vec<f32>,
    /// Arguments of its constructor, for pickling.
    made_from: (String, Option<Vec<String>>),
}

/// Checks a number of environments.
///
/// # Errors
/// `ValueError` unless it is 1 to [`MAX_ENVS`].
pub fn checked_envs(num_envs: i64) -> PyResult<usize> {
    guarded(|| check_range("num_envs", num_envs as f64, 1.0, MAX_ENVS as f64))?;
    Ok(num_envs as usize)
}

/// Models by their texts: the thesis's without any.
///
/// # Errors
/// Those of the texts.
pub fn parse_models(texts: &[String]) -> Result<Vec<Model>> {
    if texts.is_empty() {
        return Ok(vec![Model::thesis()]);
    }
    texts.iter().map(|text| Model::parse(text)).collect()
}

/// Run a call without the interpreter's lock, if it is long enough to be worth it.
pub fn detached<T: Send>(
    py: Python<'_>,
    envs: usize,
    call: impl FnOnce() -> Result<T> + Send,
) -> PyResult<T> {
    if envs <= FEW_ENVS { guarded(call) } else { py.detach(|| guarded(call)) }
}

fn interface(env: &VectorEnv, inner: action::Interface) -> Interface {
    Interface { inner, tick_s: env.tick_s(), shard_envs: first_shard(env) }
}

/// Environments of each shard but the last.
fn first_shard(env: &VectorEnv) -> usize {
    env.shard_envs().next().unwrap_or(1)
}

impl Sim {
    /// Environments of each part of the batch but the last, see `VectorEnv::shard_envs`.
    pub fn shard_envs(&self) -> PyResult<usize> {
        self.env.glance(first_shard)
    }

    /// Returns whether observations are the measured rows.
    pub fn gives_measured(&self) -> PyResult<bool> {
        self.env.glance(|env| env.measured(&[]).is_empty())
    }

    fn rows(&self) -> usize {
        self.envs * self.drones
    }

    /// The shape of an array with so many numbers for each drone.
    fn shape(&self, width: usize) -> Vec<usize> {
        [&self.lead[..], &[width]].concat()
    }

    fn arrays<'py>(
        &self,
        steps: usize,
        [rows, returns]: [&Bound<'py, PyAny>; 2],
        [rewards, observations]: [Option<&Bound<'py, PyAny>>; 2],
        [terminated, truncated]: [Option<&Bound<'py, PyAny>>; 2],
    ) -> PyResult<RolloutArrays<'py>> {
        let (wide, lead) = (self.shape(self.width), &self.lead);
        let (all, all_wide) = ([&[steps], &lead[..]].concat(), [&[steps], &wide[..]].concat());
        let flags = |what, array: Option<&Bound<'py, PyAny>>| {
            array.map(|array| output::<bool>(what, &all, array)).transpose()
        };
        Ok(RolloutArrays {
            rows: output::<f32>("rows", &wide, rows)?,
            returns: output::<f32>("returns", lead, returns)?,
            numbers: [
                rewards.map(|array| output::<f32>("rewards", &all, array)).transpose()?,
                observations.map(|array| output::<f32>("observations", &all_wide, array)).transpose()?,
            ],
            flags: [flags("terminated", terminated)?, flags("truncated", truncated)?],
        })
    }

    /// For each drone, with the model that a controller may believe in.
    pub fn interfaces_and_models(&self) -> PyResult<Vec<(action::Interface, Model)>> {
        let interfaces = self.env.glance(|env| env.interfaces().to_vec())?;
        let model = |drone: usize| self.models.get(drone).unwrap_or(&self.models[0]).clone();
        Ok(interfaces.into_iter().enumerate().map(|(drone, interface)| (interface, model(drone))).collect())
    }

    /// Splits the state of `envs` environments into that of the batch and the flags and metrics of the last step.
    fn split_state<'a>(&self, state: &'a [u8], envs: usize) -> PyResult<(&'a [u8], [&'a [u8]; 2])> {
        let [flags, numbers] = [self.last.flying.len(), self.last.metrics.len()].map(|all| all / self.envs);
        let split = state.len().checked_sub(envs * (flags + 4 * numbers)).map(|at| state.split_at(at));
        let too_few = || PyValueError::new_err(format!("state: {} bytes are too few", state.len()));
        let (batch, last) = split.ok_or_else(too_few)?;
        let (flags, metrics) = last.split_at(envs * flags);
        Ok((batch, [flags, metrics]))
    }

    /// Environments, drones of each, numbers in a drone's observation.
    pub fn size(&self) -> [usize; 3] {
        [self.envs, self.drones, self.width]
    }
}

#[pymethods]
impl Sim {
    #[new]
    #[pyo3(signature = (num_envs, options = "{}", models = None))]
    fn new(py: Python<'_>, num_envs: i64, options: &str, models: Option<Vec<String>>) -> PyResult<Self> {
        let envs = checked_envs(num_envs)?;
        let made_from = (options.to_owned(), models.clone());
        let (env, models) = py.detach(|| {
            guarded(|| {
                let models = parse_models(models.as_deref().unwrap_or_default())?;
                Ok::<_, Error>((VectorEnv::new(&models, &Options::parse(options)?, envs)?, models))
            })
        })?;
        let (drones, width, metrics) = (env.num_drones(), env.width(), env.num_metrics());
        let (lead, flying) = if metrics == 0 {
            (vec![envs], Vec::new())
        } else {
            (vec![envs, drones], vec![true; envs * drones])
        };
        Ok(Sim {
            env: GuardedCell::new(env),
            models,
            envs,
            drones,
            width,
            lead,
            last: LastStep {
                flying,
                metrics: vec![0.0; envs * metrics],
                rewards: Vec::new(),
                flags: Default::default(),
            },
            row: vec![0.0; if envs == 1 { drones * width } else { 0 }],
            made_from,
        })
    }

    /// True if the task has several drones, so that arrays have an axis of drones.
    #[getter]
    fn has_drone_axis(&self) -> bool {
        self.lead.len() > 1
    }

    /// Seconds per step.
    #[getter]
    pub fn tick_s(&self) -> PyResult<f64> {
        self.env.glance(VectorEnv::tick_s)
    }

    /// The instruction set in use: "baseline", "avx2" or "avx512". The results are the same.
    #[getter]
    fn isa(&self) -> PyResult<&'static str> {
        self.env.glance(|env| env.level().name())
    }

    /// The meaning of an action, of the first drone.
    #[getter]
    fn interface(&self) -> PyResult<Interface> {
        self.env.glance(|env| interface(env, env.interfaces()[0]))
    }

    /// The meaning of an action, for each drone of an environment.
    #[getter]
    fn interfaces(&self) -> PyResult<Vec<Interface>> {
        self.env.glance(|env| env.interfaces().iter().map(|inner| interface(env, *inner)).collect())
    }

    /// Begin episodes: in all environments, or in those of `mask`. With `seeds` the first episode of each seed,
    /// without them the next. Writes the rows of `observations` (num_envs, 24) that begin, or makes a new array, and
    /// returns it. For a task with several drones, the shape is (num_envs, num_drones, width).
    #[pyo3(signature = (seeds = None, mask = None, observations = None))]
    fn reset<'py>(
        &mut self,
        py: Python<'py>,
        seeds: Option<&Bound<'py, PyAny>>,
        mask: Option<&Bound<'py, PyAny>>,
        observations: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (n, shape) = (self.envs, self.shape(self.width));
        let seeds = seeds.map(|seeds| input::<u64>("seeds", &[n], seeds)).transpose()?;
        let seeds = seeds.as_ref().map(|seeds| seeds.as_slice()).transpose()?;
        let mask = mask.map(|mask| read_mask("reset_mask", &[n], mask)).transpose()?;
        let rows = match observations {
            Some(given) => given,
            // rows outside the mask stay as they are, so a new array must begin as something
            None => PyArrayDyn::<f32>::zeros(py, &shape[..], false).into_any(),
        };
        let mut out = output::<f32>("observations", &shape, &rows)?;
        let (count, env, out) = (self.envs * self.drones, self.env.get()?, out.as_slice_mut()?);
        detached(py, count, || env.reset(seeds, mask.as_deref(), out))?;
        Ok(rows)
    }

    /// One step of every environment: float32 actions (num_envs, 4) from -1 to 1. Returns new arrays: observations
    /// (num_envs, 24), rewards, terminated, truncated (num_envs,), and the number of flights that ended. For a task
    /// with several drones, (num_envs,) is (num_envs, num_drones) in all of these, and 24 is `width`; see also
    /// `flying` and `metrics`.
    fn step<'py>(&mut self, py: Python<'py>, actions: &Bound<'py, PyAny>) -> PyResult<Step<'py>> {
        let (wide, lead) = (PyTuple::new(py, self.shape(self.width))?, PyTuple::new(py, &self.lead)?);
        let (observations, rewards) = (empty::<f32>(py, wide)?, empty::<f32>(py, lead.clone())?);
        let (terminated, truncated) = (empty::<bool>(py, lead.clone())?, empty::<bool>(py, lead)?);
        let ended = self.step_into(py, actions, &observations, &rewards, &terminated, &truncated)?;
        Ok((observations, rewards, terminated, truncated, ended))
    }

    /// `step` into arrays of the caller; returns the number of flights that ended.
    fn step_into<'py>(
        &mut self,
        py: Python<'py>,
        actions: &Bound<'py, PyAny>,
        observations: &Bound<'py, PyAny>,
        rewards: &Bound<'py, PyAny>,
        terminated: &Bound<'py, PyAny>,
        truncated: &Bound<'py, PyAny>,
    ) -> PyResult<usize> {
        let count = self.rows();
        let actions = input::<f32>("actions", &self.shape(ACTION), actions)?;
        let mut observations = output::<f32>("observations", &self.shape(self.width), observations)?;
        let mut rewards = output::<f32>("rewards", &self.lead, rewards)?;
        let mut terminated = output::<bool>("terminated", &self.lead, terminated)?;
        let mut truncated = output::<bool>("truncated", &self.lead, truncated)?;
        let Sim { env, last: LastStep { flying, metrics, .. }, .. } = self;
        let (env, actions) = (env.get()?, actions.as_slice()?);
        let (observations, rewards) = (observations.as_slice_mut()?, rewards.as_slice_mut()?);
        let (terminated, truncated) = (terminated.as_slice_mut()?, truncated.as_slice_mut()?);
        detached(py, count, || {
            let out = StepBuffers::new(observations, rewards, &mut *terminated, &mut *truncated);
            let out = StepBuffers { flying, metrics, ..out };
            env.step(actions, out)?;
            Ok(terminated.iter().zip(&*truncated).map(|(t, o)| usize::from(t | o)).sum())
        })
    }

    /// Several steps with known actions, float32 (steps, num_envs, 4), to the bit as `step` would fly them; see
    /// `crazyflie_gym.vector` for the rest. `rows` are the observations of the last step, float32, which are
    /// overwritten with those of the new last step; arrays that are not requested are `None`.
    #[allow(clippy::too_many_arguments)]
    #[pyo3(signature = (actions, rows, returns, rewards, terminated, truncated, observations))]
    fn rollout_into<'py>(
        &mut self,
        py: Python<'py>,
        actions: &Bound<'py, PyAny>,
        rows: &Bound<'py, PyAny>,
        returns: &Bound<'py, PyAny>,
        rewards: Option<&Bound<'py, PyAny>>,
        terminated: Option<&Bound<'py, PyAny>>,
        truncated: Option<&Bound<'py, PyAny>>,
        observations: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<()> {
        let steps = shape_of(actions).first().copied().unwrap_or(0);
        let actions = input::<f32>("actions", &[&[steps], &self.shape(ACTION)[..]].concat(), actions)?;
        let mut arrays =
            self.arrays(steps, [rows, returns], [rewards, observations], [terminated, truncated])?;
        let out = arrays.buffers(&mut self.last)?;
        let (env, actions) = (self.env.get()?, actions.as_slice()?);
        py.detach(|| guarded(|| env.rollout(actions, steps, out)))
    }

    /// `rollout_into` with the actions of a controller that was made for this batch. Returns the last actions.
    #[allow(clippy::too_many_arguments)]
    #[pyo3(signature = (controller, steps, rows, returns, rewards, terminated, truncated, observations))]
    fn fly_into<'py>(
        &mut self,
        py: Python<'py>,
        controller: &Bound<'py, PyAny>,
        steps: usize,
        rows: &Bound<'py, PyAny>,
        returns: &Bound<'py, PyAny>,
        rewards: Option<&Bound<'py, PyAny>>,
        terminated: Option<&Bound<'py, PyAny>>,
        truncated: Option<&Bound<'py, PyAny>>,
        observations: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let shape = self.shape(ACTION);
        let last_actions = empty::<f32>(py, PyTuple::new(py, &shape)?)?;
        let mut flown = output::<f32>("actions", &shape, &last_actions)?;
        let flown = flown.as_slice_mut()?;
        let mut arrays =
            self.arrays(steps, [rows, returns], [rewards, observations], [terminated, truncated])?;
        let share = self.shard_envs()?;
        let out = arrays.buffers(&mut self.last)?;
        let env = self.env.get()?;
        let mut pilot = BorrowedPilot::new(controller, &env.interfaces()[0])?;
        pilot.get().fly(py, env, share, steps, flown, out)?;
        Ok(last_actions)
    }

    /// The step of a batch of one, as `gymnasium.Env.step` returns it: float32 action (4,), observation
    /// (24,), empty info.
    fn step_one<'py>(&mut self, py: Python<'py>, action: &Bound<'py, PyAny>) -> PyResult<StepOne<'py>> {
        if self.rows() != 1 || self.has_drone_axis() {
            return Err(PyValueError::new_err("step_one is for a single environment of one drone"));
        }
        let action = input::<f32>("action", &[ACTION], action)?;
        let (mut reward, mut terminated, mut truncated) = ([0.0], [false], [false]);
        let Sim { env, row: observation, .. } = self;
        let env = env.get()?;
        let out = StepBuffers::new(observation, &mut reward, &mut terminated, &mut truncated);
        let actions = action.as_slice()?;
        guarded(|| {
            env.step(actions, out).map_err(|error| match error {
                // there is only one: no number and no mask to name it by
                Error::Ended { .. } => {
                    Failure::Moment("the episode has ended: call reset() before the next step()".into())
                }
                other => other.into(),
            })
        })?;
        Ok((
            PyArray1::from_slice(py, observation),
            f64::from(reward[0]),
            terminated[0],
            truncated[0],
            PyDict::new(py),
        ))
    }

    /// Actions of a controller that was made for this batch, float32 (num_envs, 4) or (num_envs, num_drones, 4), after
    /// the last step or reset, whose result was `observations`. It reads what is measured, whatever the observations
    /// hold, and the true state if it asks for that.
    fn act<'py>(
        &mut self,
        py: Python<'py>,
        controller: &Bound<'py, PyAny>,
        observations: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let shape = self.shape(ACTION);
        let actions = empty::<f32>(py, PyTuple::new(py, &shape)?)?;
        let mut out = output::<f32>("actions", &shape, &actions)?;
        let (observed, states, out) = (self.shape(self.width), self.rows() * STATE, out.as_slice_mut()?);
        let env = self.env.get()?;
        let rows = env
            .measured(&[])
            .is_empty()
            .then(|| input::<f32>("observations", &observed, observations))
            .transpose()?;
        let rows = rows.as_ref().map_or(Ok(&[][..]), |rows| rows.as_slice())?;
        let mut pilot = BorrowedPilot::new(controller, &env.interfaces()[0])?;
        let truth = pilot.get().needs()?.truth;
        let mut truth = vec![0.0; if truth { states } else { 0 }];
        if !truth.is_empty() {
            guarded(|| env.states(&mut truth))?;
        }
        pilot.get().answer(py, env.measured(rows), &truth, out)?;
        Ok(actions)
    }

    /// The measurements of the last step or reset, whose result was `observations`: float32 (num_envs, 24), or
    /// (num_envs, num_drones, 24 and 8 for each of the others). These are the observations themselves unless other
    /// fields were chosen.
    fn measured<'py>(&self, py: Python<'py>, observations: Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let kept = self.env.glance(|env| {
            let rows = env.measured(&[]);
            (!rows.is_empty()).then(|| (rows.to_vec(), env.measured_width()))
        })?;
        match kept {
            None => Ok(observations),
            Some((rows, width)) => {
                PyArray1::from_vec(py, rows).call_method1("reshape", (PyTuple::new(py, self.shape(width))?,))
            }
        }
    }

    /// The numbers of the option `watch`, of each drone at the end of the last step, before any reset: float32
    /// (num_envs, numbers), or (num_envs, num_drones, numbers).
    fn watched<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let env = self.env.get()?;
        let shape = [&self.lead[..], &[env.watched_width()]].concat();
        let rows = empty::<f32>(py, PyTuple::new(py, &shape)?)?;
        let mut out = output::<f32>("watched", &shape, &rows)?;
        guarded(|| env.watched(out.as_slice_mut().unwrap_or_default()))?;
        Ok(rows)
    }

    /// End flights by a rule of one's own: bool (num_envs,), or (num_envs, num_drones). With resets in the next step
    /// that step resets them. `ValueError` where resets happen in the same step.
    fn end_flights(&mut self, ends: &Bound<'_, PyAny>) -> PyResult<()> {
        let flags = read_mask("ends", &self.lead, ends)?;
        let env = self.env.get()?;
        guarded(|| env.end_flights(&flags))?;
        for (flying, ends) in self.last.flying.iter_mut().zip(flags.iter()) {
            *flying &= !ends;
        }
        Ok(())
    }

    /// After a step of a task of several drones: bool (num_envs, num_drones), which ones fly on, so that
    /// their next action counts. `None` where a task has one drone.
    fn flying<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.has_drone_axis().then(|| shaped(py, &self.last.flying, &self.lead)).transpose()
    }

    /// After a step of a task of several drones: float32 (num_envs, 6), see `crazyflie_gym.metrics()`. `None`
    /// where a task has one drone.
    fn metrics<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let shape = [self.envs, METRICS.len()];
        self.has_drone_axis().then(|| shaped(py, &self.last.metrics, &shape)).transpose()
    }

    /// All that the flights go on from, as bytes for `set_state`; the same for every thread count and
    /// instruction set.
    fn get_state<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let env = self.env.get()?;
        let mut bytes = py.detach(|| env.snapshot());
        bytes.extend(self.last.flying.iter().map(|flies| u8::from(*flies)));
        bytes.extend(self.last.metrics.iter().flat_map(|number| number.to_le_bytes()));
        Ok(PyBytes::new(py, &bytes))
    }

    /// Go on from where another `Sim` of the same models and options was, to the bit as that one does.
    /// `ValueError` for the bytes of another batch, and for damaged ones; nothing has changed then.
    fn set_state(&mut self, py: Python<'_>, state: &[u8]) -> PyResult<()> {
        let (batch, last) = self.split_state(state, self.envs)?;
        let env = self.env.get()?;
        py.detach(|| guarded(|| env.restore(batch)))?;
        self.last.restore(last);
        Ok(())
    }

    /// Every environment goes on from where the one of another `Sim` of the same models and options was, given by
    /// its `get_state`; with `seeds`, uint64 (num_envs,), each in the noise of its own seed.
    #[pyo3(signature = (state, seeds = None))]
    fn set_copies(&mut self, py: Python<'_>, state: &[u8], seeds: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let seeds = seeds.map(|seeds| input::<u64>("seeds", &[self.envs], seeds)).transpose()?;
        let seeds = seeds.as_ref().map(|seeds| seeds.as_slice()).transpose()?;
        let (batch, last) = self.split_state(state, 1)?;
        let env = self.env.get()?;
        py.detach(|| guarded(|| env.restore_copies(batch, seeds)))?;
        self.last.restore(last);
        Ok(())
    }

    /// Forces from outside from now on: float32 (num_envs, 3), where a task has several drones (num_envs,
    /// num_drones, 3), N in the world frame, or `None` for none.
    #[pyo3(signature = (force_n))]
    fn set_force(&mut self, force_n: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let force_n = force_n.map(|rows| input::<f32>("force_n", &self.shape(3), rows)).transpose()?;
        let force_n = force_n.as_ref().map(|rows| rows.as_slice()).transpose()?;
        let env = self.env.get()?;
        guarded(|| env.set_force(force_n))
    }

    /// For pickling and copying.
    fn __reduce__<'py>(&mut self, py: Python<'py>) -> PyResult<PickleState<'py>> {
        let class = py.get_type::<Sim>();
        let (options, models) = self.made_from.clone();
        Ok((class, (self.envs, options, models), self.get_state(py)?))
    }

    fn __setstate__(&mut self, py: Python<'_>, state: &[u8]) -> PyResult<()> {
        self.set_state(py, state)
    }

    /// The true states, float32 (num_envs, 12): position, velocity, roll pitch yaw, their rates; metres, seconds,
    /// radians. For a task with several drones, (num_envs, num_drones, 12).
    fn states<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let shape = self.shape(STATE);
        let states = empty::<f32>(py, PyTuple::new(py, &shape)?)?;
        let mut out = output::<f32>("states", &shape, &states)?;
        let (count, env, out) = (self.envs * self.drones, self.env.get()?, out.as_slice_mut()?);
        detached(py, count, move || env.states(out))?;
        Ok(states)
    }

    /// The positions of the loads, float32 (num_envs, 3), or `None` if nothing is carried.
    fn loads<'py>(&mut self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let loads = empty::<f32>(py, (self.envs, 3))?;
        let mut out = output::<f32>("loads", &[self.envs, 3], &loads)?;
        let (env, rows) = (self.env.get()?, out.as_slice_mut()?);
        let carried = guarded(|| env.loads(rows))?;
        Ok(carried.then_some(loads))
    }

    /// The last observation (24,) and the last true state (12,) of an episode that ended in the last step of
    /// environment `env`, when automatic resets happen in the same step. For a task with several drones, (num_drones,
    /// width) and (num_drones, 12). `None` in the other modes and out of range.
    fn last_of_episode<'py>(&mut self, py: Python<'py>, env: usize) -> PyResult<Option<Last<'py>>> {
        if env >= self.envs {
            return Ok(None);
        }
        let [observed, known] = [self.width, STATE].map(|width| self.shape(width));
        let Some((observation, state)) = self.env.get()?.last_of_episode(env) else { return Ok(None) };
        Ok(Some((shaped(py, observation, &observed[1..])?, shaped(py, state, &known[1..])?)))
    }
}
