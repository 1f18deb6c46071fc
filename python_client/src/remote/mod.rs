//! A batch of environments on a server, with the methods of [`crate::sim::Sim`].

mod client;
mod client_error;
mod session;
mod socket;
mod wire;

use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};
use std::time::Duration;

use crazyflie_env::observation::ACTION;
use crazyflie_env::vector::{STATE, StepBuffers};
use crazyflie_server::protocol::frame::Layout;
use numpy::{PyArray1, PyArrayDyn, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use serde_json::{Map, Value};

use crate::arrays::{empty, input, mask as read_mask, output, row};
use crate::interface::Interface;
use crate::sim::{Step, StepOne};
use client::Client;
use client_error::ClientError;
use session::{Session, StartedSession};

/// Stack of the thread that keeps a connection alive: it does little.
const STACK_BYTES: usize = 64 << 10;

/// Observations, rewards, terminated, truncated; true states, final observations, final states where they
/// were asked for.
type Steps<'py> = (Step<'py>, Option<Bound<'py, PyAny>>, Bound<'py, PyAny>, Option<Bound<'py, PyAny>>);
/// The last observation of an episode, and its last true state if such are sent.
type Last<'py> = (Bound<'py, PyAny>, Option<Bound<'py, PyAny>>);

/// A connection to a server at `url` (ws:// or wss://); `token` is a team's, `num_envs` how many environments
/// it will be used for.
#[pyclass(frozen, module = "crazyflie_gym._native")]
pub struct Remote {
    session: Arc<Mutex<Session>>,
    started: OnceLock<StartedSession>,
    /// Dropped with the connection, which ends the thread that keeps it alive.
    _alive: Mutex<Sender<()>>,
}

impl Remote {
    /// The session. Whoever holds it may want the interpreter, to look for signals: it must not be waited for
    /// with the interpreter held.
    fn with<T: Send>(&self, py: Python<'_>, act: impl FnOnce(&mut Session) -> T + Send) -> T {
        py.detach(|| act(&mut self.session.lock().unwrap_or_else(PoisonError::into_inner)))
    }

    fn with_session<T: Send>(
        &self,
        py: Python<'_>,
        act: impl FnOnce(&mut Session) -> Result<T, ClientError> + Send,
    ) -> PyResult<T> {
        self.with(py, act).map_err(PyErr::from)
    }

    fn started(&self) -> PyResult<&StartedSession> {
        self.started.get().ok_or_else(|| PyRuntimeError::new_err("nothing was made yet: call begin() first"))
    }
}

#[pymethods]
impl Remote {
    #[new]
    #[pyo3(signature = (url, token = None, num_envs = 1))]
    fn new(py: Python<'_>, url: &str, token: Option<&str>, num_envs: usize) -> PyResult<Self> {
        let client = py.detach(|| Client::open(url, token, wire::reply_bytes(num_envs)))?;
        let pause = Duration::from_secs_f64((0.5 * client.limits.ping_s).clamp(0.01, 3600.0));
        let session = Arc::new(Mutex::new(Session::new(client)));
        let alive = keep_alive(Arc::downgrade(&session), pause)?;
        Ok(Remote { session, started: OnceLock::new(), _alive: Mutex::new(alive) })
    }

    /// Sends a request in JSON, such as "state", with the `fields` of a JSON object, and returns the reply,
    /// JSON.
    #[pyo3(signature = (kind, fields = "{}"))]
    fn ask(&self, py: Python<'_>, kind: &str, fields: &str) -> PyResult<String> {
        let fields = object(fields)?;
        self.with_session(py, |session| session.client.request(kind, fields)).map(|reply| reply.to_string())
    }

    /// As `ask`, for the requests that begin a session: "make" or "benchmark". With `states` every reply
    /// brings the true states along.
    #[pyo3(signature = (kind, fields, states = false))]
    fn begin(&self, py: Python<'_>, kind: &str, fields: &str, states: bool) -> PyResult<String> {
        let fields = object(fields)?;
        let (reply, started) = self.with_session(py, |session| {
            let reply = session.client.request(kind, fields)?;
            let started = StartedSession::new(session.client.read(reply.clone())?, states);
            (session.with_states, session.layout) = (states, started.layout);
            session.client.session.clone_from(&started.key);
            Ok((reply, started))
        })?;
        self.started
            .set(started)
            .map_err(|_| PyRuntimeError::new_err("this connection has a session already"))?;
        Ok(reply.to_string())
    }

    /// Environments in the batch.
    #[getter]
    fn num_envs(&self) -> PyResult<usize> {
        self.started().map(|started| started.layout.envs)
    }

    /// Drones in each environment.
    #[getter]
    fn num_drones(&self) -> PyResult<usize> {
        self.layout().map(|layout| layout.drones)
    }

    /// Numbers in a drone's observation.
    #[getter]
    fn width(&self) -> PyResult<usize> {
        self.layout().map(|layout| layout.width)
    }

    /// As of `Sim`.
    #[getter]
    fn has_drone_axis(&self) -> PyResult<bool> {
        self.layout().map(|layout| layout.metrics > 0)
    }

    /// Seconds per step.
    #[getter]
    fn tick_s(&self) -> PyResult<f64> {
        self.started().map(|started| started.tick_s)
    }

    /// What an action means.
    #[getter]
    fn interface(&self) -> PyResult<Interface> {
        self.started().map(|started| Interface {
            inner: started.interface,
            tick_s: started.tick_s,
            shard_envs: usize::MAX,
        })
    }

    /// The most steps that one request of `step_many` may ask for.
    #[getter]
    fn max_steps(&self) -> PyResult<usize> {
        // the server counts without true states, which make a reply half as long again
        let StartedSession { max_steps, with_states, .. } = *self.started()?;
        Ok(if with_states { max_steps * 2 / 3 } else { max_steps }.max(1))
    }

    /// For how long a lost session is looked for, in seconds; at first as the server says.
    #[getter]
    fn resume_s(&self, py: Python<'_>) -> f64 {
        self.with(py, |session| session.client.resume_s)
    }

    #[setter]
    fn set_resume_s(&self, py: Python<'_>, resume_s: f64) {
        self.with(py, |session| session.client.resume_s = resume_s);
    }

    /// How many lost connections were mended.
    #[getter]
    fn resumed(&self, py: Python<'_>) -> u64 {
        self.with(py, |session| session.client.resumed)
    }

    /// As of `Sim`.
    #[pyo3(signature = (seeds = None, mask = None, observations = None))]
    fn reset<'py>(
        &self,
        py: Python<'py>,
        seeds: Option<&Bound<'py, PyAny>>,
        mask: Option<&Bound<'py, PyAny>>,
        observations: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (n, shape) = (self.num_envs()?, self.shape(&[], self.width()?)?);
        let seeds = seeds.map(|seeds| input::<u64>("seeds", &[n], seeds)).transpose()?;
        let seeds = seeds.as_ref().map(|seeds| seeds.as_slice()).transpose()?;
        let mask = mask.map(|mask| read_mask("reset_mask", &[n], mask)).transpose()?;
        let rows = observations.unwrap_or_else(|| PyArrayDyn::<f32>::zeros(py, &shape[..], false).into_any());
        let mut out = output::<f32>("observations", &shape, &rows)?;
        let out = out.as_slice_mut()?;
        self.with_session(py, |session| session.reset(seeds, mask.as_deref(), out))?;
        Ok(rows)
    }

    /// As of `Sim`.
    fn step<'py>(&self, py: Python<'py>, actions: &Bound<'py, PyAny>) -> PyResult<Step<'py>> {
        let (wide, lead) =
            (PyTuple::new(py, self.shape(&[], self.width()?)?)?, PyTuple::new(py, self.lead(&[])?)?);
        let (observations, rewards) = (empty::<f32>(py, wide)?, empty::<f32>(py, lead.clone())?);
        let (terminated, truncated) = (empty::<bool>(py, lead.clone())?, empty::<bool>(py, lead)?);
        let ended = self.step_into(py, actions, &observations, &rewards, &terminated, &truncated)?;
        Ok((observations, rewards, terminated, truncated, ended))
    }

    /// As of `Sim`.
    fn step_into<'py>(
        &self,
        py: Python<'py>,
        actions: &Bound<'py, PyAny>,
        observations: &Bound<'py, PyAny>,
        rewards: &Bound<'py, PyAny>,
        terminated: &Bound<'py, PyAny>,
        truncated: &Bound<'py, PyAny>,
    ) -> PyResult<usize> {
        self.fly(py, actions, None, [observations, rewards, terminated, truncated])
    }

    /// As of `Sim`.
    fn step_one<'py>(&self, py: Python<'py>, action: &Bound<'py, PyAny>) -> PyResult<StepOne<'py>> {
        let action = input::<f32>("action", &[ACTION], action)?;
        let action = action.as_slice()?;
        if self.num_envs()? != 1 || self.has_drone_axis()? {
            return Err(PyValueError::new_err("step_one is for a single environment of one drone"));
        }
        let mut observations = vec![0.0; self.width()?];
        let (mut reward, mut terminated, mut truncated) = ([0.0], [false], [false]);
        let (rows, rewards) = (&mut observations[..], &mut reward[..]);
        let out = StepBuffers::new(rows, rewards, &mut terminated[..], &mut truncated[..]);
        self.with_session(py, |session| session.step(1, action, out))?;
        Ok((row(py, &observations), f64::from(reward[0]), terminated[0], truncated[0], PyDict::new(py)))
    }

    /// Several steps in one request: float32 actions (steps, num_envs, 4), at most `max_steps`. Returns what
    /// `step` returns, with an axis of steps in front; true states (steps, num_envs, 12) or `None`; of the
    /// episodes that ended, when automatic resets happen in the same step, the last observations (episodes,
    /// 24) and true states (episodes, 12) or `None`, by step and environment.
    fn step_many<'py>(&self, py: Python<'py>, actions: &Bound<'py, PyAny>) -> PyResult<Steps<'py>> {
        let steps = actions
            .cast::<PyUntypedArray>()
            .ok()
            .and_then(|array| array.shape().first().copied())
            .unwrap_or(0);
        if self.has_drone_axis()? {
            return Err(PyValueError::new_err("step_many is for environments of one drone"));
        }
        let n = self.num_envs()?;
        let (observations, rewards) =
            (empty::<f32>(py, (steps, n, self.width()?))?, empty::<f32>(py, (steps, n))?);
        let (terminated, truncated) = (empty::<bool>(py, (steps, n))?, empty::<bool>(py, (steps, n))?);
        let ended = self.fly(py, actions, Some(steps), [&observations, &rewards, &terminated, &truncated])?;
        let (with_states, own) = (self.started()?.with_states, self.width()?);
        let (width, states, finals) =
            self.with(py, |session| (session.final_width(), session.states.clone(), session.finals.clone()));
        let rows = |from: std::ops::Range<usize>| {
            let numbers: Vec<f32> =
                finals.chunks_exact(width).flat_map(|row| &row[from.clone()]).copied().collect();
            PyArray1::from_vec(py, numbers).call_method1("reshape", ((finals.len() / width, from.len()),))
        };
        let final_states = with_states.then(|| rows(own..width)).transpose()?;
        let states = with_states
            .then(|| PyArray1::from_vec(py, states).call_method1("reshape", ((steps, n, STATE),)))
            .transpose()?;
        Ok(((observations, rewards, terminated, truncated, ended), states, rows(0..own)?, final_states))
    }

    /// The observations: pictures are drawn from no others.
    fn measured<'py>(&self, observations: Bound<'py, PyAny>) -> Bound<'py, PyAny> {
        observations
    }

    /// As of `Sim`.
    fn flying<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        if !self.has_drone_axis()? {
            return Ok(None);
        }
        let flags = self.with(py, |session| session.flying.clone());
        PyArray1::from_vec(py, flags).call_method1("reshape", (PyTuple::new(py, self.lead(&[])?)?,)).map(Some)
    }

    /// As of `Sim`.
    fn metrics<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let layout = self.layout()?;
        if layout.metrics == 0 {
            return Ok(None);
        }
        let numbers = self.with(py, |session| session.metrics.clone());
        PyArray1::from_vec(py, numbers).call_method1("reshape", ((layout.envs, layout.metrics),)).map(Some)
    }

    /// As of `Sim`.
    fn states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let shape = self.shape(&[], STATE)?;
        let states = empty::<f32>(py, PyTuple::new(py, &shape)?)?;
        let mut out = output::<f32>("states", &shape, &states)?;
        let out = out.as_slice_mut()?;
        self.with_session(py, |session| session.states(out))?;
        Ok(states)
    }

    /// As of `Sim`; the true state is `None` unless the session was begun with `states`.
    fn last_of_episode<'py>(&self, py: Python<'py>, env: usize) -> PyResult<Option<Last<'py>>> {
        let layout = self.layout()?;
        let Some(last) = self.with(py, |session| session.final_of(env).map(<[f32]>::to_vec)) else {
            return Ok(None);
        };
        let (observation, state) = last.split_at(layout.drones * layout.width);
        let shaped = |numbers: &[f32], width: usize| {
            let flat = row(py, numbers);
            if layout.metrics > 0 {
                flat.call_method1("reshape", ((layout.drones, width),))
            } else {
                Ok(flat.into_any())
            }
        };
        let state = if state.is_empty() { None } else { Some(shaped(state, STATE)?) };
        Ok(Some((shaped(observation, layout.width)?, state)))
    }

    /// End the session and the connection; may be called twice.
    fn close(&self, py: Python<'_>) {
        self.with(py, |session| session.client.close());
    }
}

impl Remote {
    fn layout(&self) -> PyResult<Layout> {
        self.started().map(|started| started.layout)
    }

    /// The first axes of arrays: what stands in front, environments, and where a task has several drones also
    /// these.
    fn lead(&self, front: &[usize]) -> PyResult<Vec<usize>> {
        let layout = self.layout()?;
        let axes: &[usize] = if layout.metrics > 0 { &[layout.envs, layout.drones] } else { &[layout.envs] };
        Ok([front, axes].concat())
    }

    fn shape(&self, front: &[usize], width: usize) -> PyResult<Vec<usize>> {
        Ok([self.lead(front)?, vec![width]].concat())
    }

    fn fly<'py>(
        &self,
        py: Python<'py>,
        actions: &Bound<'py, PyAny>,
        steps: Option<usize>,
        into: [&Bound<'py, PyAny>; 4],
    ) -> PyResult<usize> {
        let front: Vec<usize> = steps.into_iter().collect();
        let steps = steps.unwrap_or(1);
        let (Ok(count @ 1..), true) = (u16::try_from(steps), steps <= self.max_steps()?) else {
            return Err(PyValueError::new_err(format!(
                "actions: {steps} steps, expected 1 to {}",
                self.max_steps()?
            )));
        };
        let lead = self.lead(&front)?;
        let actions = input::<f32>("actions", &self.shape(&front, ACTION)?, actions)?;
        let mut observations = output::<f32>("observations", &self.shape(&front, self.width()?)?, into[0])?;
        let mut rewards = output::<f32>("rewards", &lead, into[1])?;
        let mut terminated = output::<bool>("terminated", &lead, into[2])?;
        let mut truncated = output::<bool>("truncated", &lead, into[3])?;
        let (actions, observations, rewards) =
            (actions.as_slice()?, observations.as_slice_mut()?, rewards.as_slice_mut()?);
        let (terminated, truncated) = (terminated.as_slice_mut()?, truncated.as_slice_mut()?);
        self.with_session(py, |session| {
            session.step(count, actions, StepBuffers::new(observations, rewards, terminated, truncated))
        })
    }
}

fn object(fields: &str) -> PyResult<Map<String, Value>> {
    serde_json::from_str(fields).map_err(|e| PyValueError::new_err(format!("fields: {e}")))
}

/// A server closes connections that are silent for long, and a learner may think for long.
fn keep_alive(session: Weak<Mutex<Session>>, pause: Duration) -> PyResult<Sender<()>> {
    let (alive, dropped) = channel::<()>();
    let beat = move || {
        while let Err(RecvTimeoutError::Timeout) = dropped.recv_timeout(pause) {
            let Some(session) = session.upgrade() else { return };
            // a connection in use needs no sign of life
            if let Ok(mut session) = session.try_lock() {
                session.client.beat();
            }
        }
    };
    std::thread::Builder::new().name("crazyflie-alive".into()).stack_size(STACK_BYTES).spawn(beat)?;
    Ok(alive)
}
