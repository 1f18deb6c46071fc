//! The flights of an attempt: environments in lock-step, and all that is kept of them.

use crazyflie_env::observation::{ACTION, Interface, OBSERVATION};
use crazyflie_env::vector::{Out, STATE, VectorEnv};
use sha2::{Digest, Sha256};

use super::error::{Error, Result};
use super::scenario::Scenario;
use crate::flight::{self, End, Row, Trace};

/// One flight, with the reward that each row but the first came with.
#[derive(Debug, Clone)]
pub(super) struct Episode {
    pub trace: Trace,
    pub rewards: Vec<f32>,
    over: bool,
}

pub(super) struct Episodes {
    env: VectorEnv,
    all: Vec<Episode>,
    ticks: usize,
    tick: usize,
    /// As the environments see and give them; what is shown is copied from here while an episode lasts.
    inner: Buffers,
    states: Vec<f32>,
    /// The actions as they were obeyed: zeros for flights that are over.
    obeyed: Vec<f32>,
    shown: Buffers,
}

struct Buffers {
    observations: Vec<f32>,
    rewards: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
}

impl Buffers {
    fn new(envs: usize) -> Self {
        let (rewards, flags) = (vec![0.0; envs], vec![false; envs]);
        Buffers { observations: vec![0.0; envs * OBSERVATION], rewards, terminated: flags.clone(), truncated: flags }
    }
}

impl Episodes {
    pub(super) fn begin(scenario: &Scenario, seeds: &[u64]) -> Result<Episodes> {
        let (envs, mut env) = (seeds.len(), scenario.env(seeds.len())?);
        let (mut inner, mut shown) = (Buffers::new(envs), Buffers::new(envs));
        env.reset(Some(seeds), None, &mut inner.observations)?;
        shown.observations.copy_from_slice(&inner.observations);
        let trace = Trace { tick_s: env.tick_s(), interface: env.interface(), rows: Vec::new(), end: End::Time };
        let all = vec![Episode { trace, rewards: vec![0.0], over: false }; envs];
        let ticks = (scenario.seconds() / env.tick_s()).round() as usize;
        let mut states = vec![0.0; envs * STATE];
        env.states(&mut states)?;
        Ok(Episodes { env, all, ticks, tick: 0, inner, states, obeyed: vec![0.0; envs * ACTION], shown })
    }

    pub(super) fn len(&self) -> usize {
        self.all.len()
    }

    pub(super) fn tick(&self) -> usize {
        self.tick
    }

    pub(super) fn tick_s(&self) -> f64 {
        self.env.tick_s()
    }

    pub(super) fn interface(&self) -> Interface {
        self.env.interface()
    }

    pub(super) fn under_way(&self) -> usize {
        self.all.iter().filter(|episode| !episode.over).count()
    }

    /// The latest observation of each flight; the last one of those that are over.
    pub(super) fn observations(&self) -> &[f32] {
        &self.shown.observations
    }

    /// The actions of the last step as they were obeyed.
    pub(super) fn obeyed(&self) -> &[f32] {
        &self.obeyed
    }

    /// One tick of every flight; `actions` of flights that are over are ignored.
    ///
    /// # Errors
    /// Before anything moves: [`Error::Over`], and the environment's for a wrong number of actions or one that is not from -1 to 1.
    pub(super) fn step(&mut self, actions: &[f32]) -> Result<bool> {
        if self.under_way() == 0 {
            return Err(Error::Over);
        }
        if actions.len() != self.obeyed.len() {
            let want = format!("{} numbers", self.obeyed.len());
            return Err(crazyflie_env::Error::Shape { what: "actions", want, got: actions.len().to_string() }.into());
        }
        for (i, episode) in self.all.iter().enumerate() {
            let row = i * ACTION..(i + 1) * ACTION;
            if episode.over {
                self.obeyed[row].fill(0.0);
            } else {
                self.obeyed[row.clone()].copy_from_slice(&actions[row]);
            }
        }
        let Buffers { observations, rewards, terminated, truncated } = &mut self.inner;
        let seen = observations.clone();
        self.env.step(&self.obeyed, Out { observations, rewards, terminated, truncated })?;
        for (i, episode) in self.all.iter_mut().enumerate().filter(|(_, episode)| !episode.over) {
            episode.trace.rows.push(row(i, &seen, &self.states, &self.obeyed));
        }
        self.env.states(&mut self.states)?;
        self.tick += 1;
        self.settle();
        Ok(self.under_way() == 0)
    }

    /// What came of the step: for the client, and for flights that end with it their last row.
    fn settle(&mut self) {
        let out_of_time = self.tick >= self.ticks;
        for (i, episode) in self.all.iter_mut().enumerate() {
            if episode.over {
                self.shown.rewards[i] = 0.0;
                continue;
            }
            let observation = i * OBSERVATION..(i + 1) * OBSERVATION;
            self.shown.observations[observation.clone()].copy_from_slice(&self.inner.observations[observation]);
            self.shown.rewards[i] = self.inner.rewards[i];
            self.shown.terminated[i] = self.inner.terminated[i];
            self.shown.truncated[i] = out_of_time;
            episode.rewards.push(self.inner.rewards[i]);
            episode.over = self.inner.terminated[i] || out_of_time;
            if episode.over {
                episode.trace.rows.push(row(i, &self.inner.observations, &self.states, &self.obeyed));
                episode.trace.end = if self.inner.terminated[i] { flight::end(&episode.trace.rows) } else { End::Time };
            }
        }
    }

    /// # Errors
    /// The environment's, for buffers of the wrong lengths.
    pub(super) fn check(&self, out: &Out<'_>) -> Result<()> {
        let want = [self.len() * OBSERVATION, self.len(), self.len(), self.len()];
        let got = [out.observations.len(), out.rewards.len(), out.terminated.len(), out.truncated.len()];
        if want == got {
            return Ok(());
        }
        let shape = crazyflie_env::Error::Shape { what: "buffers of a step", want: format!("{want:?}"), got: format!("{got:?}") };
        Err(shape.into())
    }

    /// Copies what the client is shown into buffers of the right lengths.
    pub(super) fn show(&self, out: Out<'_>) {
        out.observations.copy_from_slice(&self.shown.observations);
        out.rewards.copy_from_slice(&self.shown.rewards);
        out.terminated.copy_from_slice(&self.shown.terminated);
        out.truncated.copy_from_slice(&self.shown.truncated);
    }

    /// The flights, once all are over.
    pub(super) fn finish(self) -> Result<Vec<Episode>> {
        match self.under_way() {
            0 => Ok(self.all),
            left => Err(Error::NotOver { left, all: self.len() }),
        }
    }
}

impl Episode {
    /// SHA-256 over the true states of all ticks, as little-endian f32.
    pub(super) fn state_hash(&self) -> String {
        let mut hash = Sha256::new();
        self.trace.rows.iter().flat_map(|row| row.state).for_each(|number| hash.update(number.to_le_bytes()));
        hex::encode(hash.finalize())
    }
}

fn row(i: usize, observations: &[f32], states: &[f32], actions: &[f32]) -> Row {
    Row {
        observation: std::array::from_fn(|k| observations[i * OBSERVATION + k]),
        state: std::array::from_fn(|k| states[i * STATE + k]),
        action: std::array::from_fn(|k| actions[i * ACTION + k]),
    }
}
