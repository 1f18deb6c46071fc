//! A batch of environments.

use crazyflie_env::config::Options;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::observation::{self, ACTION, OBSERVATION};
use crazyflie_env::vector::{Out, STATE, VectorEnv};
use crazyflie_env::{Error, Result};
use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{empty, input, mask as read_mask, output, row};
use crate::errors::{Failure, guarded};
use crate::held::Held;

/// Beyond this the buffers of a step alone take gigabytes.
pub const MOST_ENVS: i64 = 1 << 22;

/// Letting go of the interpreter costs more than stepping this many.
pub const FEW_ENVS: usize = 16;

/// Observations, rewards, terminated, truncated, number of episodes that ended.
pub type Step<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, usize);
/// The last observation and true state of an episode.
type Last<'py> = (Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>);
/// Observation, reward, terminated, truncated, info.
pub type StepOne<'py> = (Bound<'py, PyArray1<f32>>, f64, bool, bool, Bound<'py, PyDict>);

fn vertical_name(input: VerticalInput) -> &'static str {
    match input {
        VerticalInput::Height => "height",
        VerticalInput::Pwm => "pwm",
        VerticalInput::Thrust => "thrust",
    }
}

/// What an action means: the ranges that -1..1 is mapped to.
#[pyclass(frozen, module = "crazyflie_gym._native")]
pub struct Interface {
    pub inner: observation::Interface,
    /// Seconds per step.
    #[pyo3(get)]
    pub tick_s: f64,
}

#[pymethods]
impl Interface {
    /// As a server describes it.
    #[new]
    #[pyo3(signature = (*, tick_s, vertical, tilt_max_rad, yaw_rate_max_radps, lift_max, hover_lift, yaw_sign))]
    fn new(
        tick_s: f64,
        vertical: &str,
        tilt_max_rad: f64,
        yaw_rate_max_radps: f64,
        lift_max: f64,
        hover_lift: f64,
        yaw_sign: f64,
    ) -> PyResult<Self> {
        let known = [VerticalInput::Height, VerticalInput::Pwm, VerticalInput::Thrust];
        let input = known.into_iter().find(|input| vertical_name(*input) == vertical);
        let input = input.ok_or_else(|| PyValueError::new_err(format!("vertical is {vertical:?}, expected height, pwm or thrust")))?;
        Ok(Interface { inner: observation::Interface { input, tilt_max_rad, yaw_rate_max_radps, lift_max, hover_lift, yaw_sign }, tick_s })
    }

    /// Which height input is commanded: "height", "pwm" or "thrust".
    #[getter]
    fn vertical(&self) -> &'static str {
        vertical_name(self.inner.input)
    }
    /// Roll and pitch of an action of 1, in radians.
    #[getter]
    fn tilt_max_rad(&self) -> f64 {
        self.inner.tilt_max_rad
    }
    /// Yaw rate of an action of 1, in the vehicle's own sign, in rad/s.
    #[getter]
    fn yaw_rate_max_radps(&self) -> f64 {
        self.inner.yaw_rate_max_radps
    }
    /// Height in metres, or PWM, of an action of 1; an action of -1 is zero.
    #[getter]
    fn lift_max(&self) -> f64 {
        self.inner.lift_max
    }
    /// The PWM that carries the weight; zero where the command is a height.
    #[getter]
    fn hover_lift(&self) -> f64 {
        self.inner.hover_lift
    }
    /// +1 or -1: the direction in which a positive yaw-rate command turns, right-handed.
    #[getter]
    fn yaw_sign(&self) -> f64 {
        self.inner.yaw_sign
    }
}

/// A batch of `num_envs` environments. `options` is JSON (see `crazyflie_gym.options`), `model` the text of a model file.
#[pyclass(module = "crazyflie_gym._native")]
pub struct Sim {
    env: Held<VectorEnv>,
    envs: usize,
}

/// Run a call without holding the interpreter, if it is long enough to be worth it.
pub fn detached<T: Send>(py: Python<'_>, envs: usize, call: impl FnOnce() -> Result<T> + Send) -> PyResult<T> {
    if envs <= FEW_ENVS { guarded(call) } else { py.detach(|| guarded(call)) }
}

#[pymethods]
impl Sim {
    #[new]
    #[pyo3(signature = (num_envs, options = "{}", model = None))]
    fn new(py: Python<'_>, num_envs: i64, options: &str, model: Option<&str>) -> PyResult<Self> {
        if !(1..=MOST_ENVS).contains(&num_envs) {
            return Err(PyValueError::new_err(format!("num_envs is {num_envs}, expected 1 to {MOST_ENVS}")));
        }
        let envs = num_envs as usize;
        let env = py.detach(|| {
            guarded(|| {
                let model = model.map_or_else(|| Ok(Model::thesis()), Model::parse)?;
                VectorEnv::new(&model, &Options::parse(options)?, envs)
            })
        })?;
        Ok(Sim { env: Held::new(env), envs })
    }

    /// Environments in the batch.
    #[getter]
    fn num_envs(&self) -> usize {
        self.envs
    }

    /// Seconds per step.
    #[getter]
    fn tick_s(&self) -> PyResult<f64> {
        self.env.glance(VectorEnv::tick_s)
    }

    /// The instruction set in use: "baseline", "avx2" or "avx512". The results are the same.
    #[getter]
    fn isa(&self) -> PyResult<&'static str> {
        self.env.glance(|env| env.level().name())
    }

    /// What an action means.
    #[getter]
    fn interface(&self) -> PyResult<Interface> {
        self.env.glance(|env| Interface { inner: env.interface(), tick_s: env.tick_s() })
    }

    /// Begin episodes: in all environments, or in those of `mask`. With `seeds` the first episode of each seed, without them the next.
    /// Writes the rows of `observations` (num_envs, 24) that begin, or makes a new array, and returns it.
    #[pyo3(signature = (seeds = None, mask = None, observations = None))]
    fn reset<'py>(
        &mut self,
        py: Python<'py>,
        seeds: Option<&Bound<'py, PyAny>>,
        mask: Option<&Bound<'py, PyAny>>,
        observations: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let n = self.envs;
        let seeds = seeds.map(|seeds| input::<u64>("seeds", &[n], seeds)).transpose()?;
        let seeds = seeds.as_ref().map(|seeds| seeds.as_slice()).transpose()?;
        let mask = mask.map(|mask| read_mask("reset_mask", &[n], mask)).transpose()?;
        let rows = match observations {
            Some(given) => given,
            // rows outside the mask stay as they are, so a new array must begin as something
            None => numpy::PyArray2::<f32>::zeros(py, [n, OBSERVATION], false).into_any(),
        };
        let mut out = output::<f32>("observations", &[n, OBSERVATION], &rows)?;
        let (env, out) = (self.env.get()?, out.as_slice_mut()?);
        detached(py, n, || env.reset(seeds, mask.as_deref(), out))?;
        Ok(rows)
    }

    /// One step of every environment: float32 actions (num_envs, 4) from -1 to 1. Returns new arrays: observations (num_envs, 24),
    /// rewards, terminated, truncated (num_envs,), and the number of episodes that ended.
    fn step<'py>(&mut self, py: Python<'py>, actions: &Bound<'py, PyAny>) -> PyResult<Step<'py>> {
        let n = self.envs;
        let (observations, rewards) = (empty::<f32>(py, (n, OBSERVATION))?, empty::<f32>(py, (n,))?);
        let (terminated, truncated) = (empty::<bool>(py, (n,))?, empty::<bool>(py, (n,))?);
        let ended = self.step_into(py, actions, &observations, &rewards, &terminated, &truncated)?;
        Ok((observations, rewards, terminated, truncated, ended))
    }

    /// As `step`, into arrays of the caller; returns the number of episodes that ended.
    fn step_into<'py>(
        &mut self,
        py: Python<'py>,
        actions: &Bound<'py, PyAny>,
        observations: &Bound<'py, PyAny>,
        rewards: &Bound<'py, PyAny>,
        terminated: &Bound<'py, PyAny>,
        truncated: &Bound<'py, PyAny>,
    ) -> PyResult<usize> {
        let n = self.envs;
        let actions = input::<f32>("actions", &[n, ACTION], actions)?;
        let mut observations = output::<f32>("observations", &[n, OBSERVATION], observations)?;
        let mut rewards = output::<f32>("rewards", &[n], rewards)?;
        let mut terminated = output::<bool>("terminated", &[n], terminated)?;
        let mut truncated = output::<bool>("truncated", &[n], truncated)?;
        let (env, actions) = (self.env.get()?, actions.as_slice()?);
        let (observations, rewards) = (observations.as_slice_mut()?, rewards.as_slice_mut()?);
        let (terminated, truncated) = (terminated.as_slice_mut()?, truncated.as_slice_mut()?);
        detached(py, n, || {
            env.step(actions, Out { observations, rewards, terminated: &mut *terminated, truncated: &mut *truncated })?;
            Ok(terminated.iter().zip(&*truncated).map(|(t, o)| usize::from(t | o)).sum())
        })
    }

    /// The step of a batch of one, as `gymnasium.Env.step` returns it: float32 action (4,), observation (24,), empty info.
    fn step_one<'py>(&mut self, py: Python<'py>, action: &Bound<'py, PyAny>) -> PyResult<StepOne<'py>> {
        let action = input::<f32>("action", &[ACTION], action)?;
        let (mut observation, mut reward, mut terminated, mut truncated) = ([0.0; OBSERVATION], [0.0], [false], [false]);
        let env = self.env.get()?;
        let out = Out { observations: &mut observation, rewards: &mut reward, terminated: &mut terminated, truncated: &mut truncated };
        let actions = action.as_slice()?;
        guarded(|| {
            env.step(actions, out).map_err(|error| match error {
                // there is only one: no number and no mask to name it by
                Error::Ended { .. } => Failure::Moment("the episode has ended: call reset() before the next step()".into()),
                other => other.into(),
            })
        })?;
        Ok((row(py, &observation), f64::from(reward[0]), terminated[0], truncated[0], PyDict::new(py)))
    }

    /// The true states, float32 (num_envs, 12): position, velocity, roll pitch yaw, their rates; metres, seconds, radians.
    fn states<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let n = self.envs;
        let states = empty::<f32>(py, (n, STATE))?;
        let mut out = output::<f32>("states", &[n, STATE], &states)?;
        let (env, out) = (self.env.get()?, out.as_slice_mut()?);
        detached(py, n, move || env.states(out))?;
        Ok(states)
    }

    /// Of an episode that ended in the last step of environment `env`, when automatic resets happen in the same step: the last
    /// observation (24,) and the last true state (12,). `None` in the other modes and out of range.
    fn last_of_episode<'py>(&mut self, py: Python<'py>, env: usize) -> PyResult<Option<Last<'py>>> {
        if env >= self.envs {
            return Ok(None);
        }
        Ok(self.env.get()?.last_of_episode(env).map(|(observation, state)| (row(py, observation), row(py, state))))
    }
}
