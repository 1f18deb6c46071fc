//! The flights of an attempt: environments in lock-step, and all that is kept of them.

use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::vector::{METRICS, StepBuffers};
use sha2::{Digest, Sha256};

use super::error::{Error, Result};
use super::scenario::Scenario;
use crazyflie_server::flight::{self, EnvBatch, FlightEnd, Trace, TraceRow};

/// Interface and size of an attempt, for the controller that flies it.
#[derive(Debug, Clone, Copy)]
pub struct AttemptSpec {
    /// Meaning of the actions.
    pub interface: Interface,
    /// Time from one action to the next.
    pub tick_s: f64,
    /// Flights of the attempt, all flown at once.
    pub episodes: usize,
    /// In each episode.
    pub drones: usize,
}

/// The flight of one drone, with the reward of each row but the first.
#[derive(Debug, Clone)]
pub(super) struct DronePath {
    pub trace: Trace,
    pub rewards: Vec<f32>,
    over: bool,
}

/// One episode: a drone, or several that share the air.
#[derive(Debug, Clone)]
pub(super) struct Episode {
    pub paths: Vec<DronePath>,
    /// Metrics of worlds that several drones share.
    pub world_metrics: Option<[f32; METRICS.len()]>,
}

pub(super) struct EpisodeBatch {
    /// The visible rows are copied from here while a drone flies. Its actions are those that were obeyed: zeros for
    /// flights that are over.
    batch: EnvBatch,
    all: Vec<Episode>,
    ticks: usize,
    tick: usize,
    observations: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
}

impl EpisodeBatch {
    pub(super) fn begin(scenario: &Scenario, seeds: &[u64]) -> Result<EpisodeBatch> {
        let batch = EnvBatch::begin(scenario.env(seeds.len())?, seeds)?;
        let env = &batch.env;
        let trace = Trace::new(env.tick_s(), env.interfaces()[0]);
        let path = DronePath { trace, rewards: vec![0.0], over: false };
        let world_metrics = (env.num_metrics() > 0).then_some([0.0; METRICS.len()]);
        let all = vec![Episode { paths: vec![path; env.num_drones()], world_metrics }; seeds.len()];
        let ticks = (scenario.seconds() / env.tick_s()).round() as usize;
        let (observations, flags) = (batch.observations.clone(), batch.terminated.clone());
        Ok(EpisodeBatch {
            batch,
            all,
            ticks,
            tick: 0,
            observations,
            terminated: flags.clone(),
            truncated: flags,
        })
    }

    /// Drones of all episodes: so many rows go in and out.
    pub(super) fn rows(&self) -> usize {
        self.terminated.len()
    }

    /// Numbers in a row of observations.
    pub(super) fn width(&self) -> usize {
        self.batch.env.width()
    }

    pub(super) fn tick(&self) -> usize {
        self.tick
    }

    pub(super) fn tick_s(&self) -> f64 {
        self.batch.env.tick_s()
    }

    pub(super) fn spec(&self) -> AttemptSpec {
        let (interface, tick_s) = (self.batch.env.interfaces()[0], self.batch.env.tick_s());
        AttemptSpec { interface, tick_s, episodes: self.all.len(), drones: self.batch.env.num_drones() }
    }

    pub(super) fn running(&self) -> usize {
        self.all.iter().filter(|episode| !episode.is_over()).count()
    }

    /// The latest observation of each drone; the last one of those whose flight is over.
    pub(super) fn observations(&self) -> &[f32] {
        &self.observations
    }

    /// True states of all drones now.
    pub(super) fn states(&self) -> &[f32] {
        &self.batch.states
    }

    /// The actions of the last step as they were obeyed.
    pub(super) fn applied_actions(&self) -> &[f32] {
        &self.batch.actions
    }

    fn paths(&mut self) -> impl Iterator<Item = (usize, &mut DronePath)> {
        self.all.iter_mut().flat_map(|episode| &mut episode.paths).enumerate().filter(|(_, path)| !path.over)
    }

    /// One tick of every flight; `actions` of flights that are over are ignored.
    ///
    /// # Errors
    /// Before anything moves: [`Error::Over`], and the environment's for a wrong number of actions or one
    /// that is not from -1 to 1.
    pub(super) fn step(&mut self, actions: &[f32]) -> Result<bool> {
        if self.running() == 0 {
            return Err(Error::Over);
        }
        if actions.len() != self.batch.actions.len() {
            let want = format!("{} numbers", self.batch.actions.len());
            return Err(crazyflie_env::Error::Shape {
                what: "actions",
                want,
                got: actions.len().to_string(),
            }
            .into());
        }
        let mut obeyed = vec![0.0; actions.len()];
        for (i, _) in self.paths() {
            obeyed[i * ACTION..(i + 1) * ACTION].copy_from_slice(&actions[i * ACTION..(i + 1) * ACTION]);
        }
        let last = std::mem::replace(&mut self.batch.actions, obeyed);
        let rows: Vec<TraceRow> = (0..self.rows()).map(|i| self.batch.row(i)).collect();
        if let Err(error) = self.batch.step() {
            self.batch.actions = last;
            return Err(error.into());
        }
        self.paths().for_each(|(i, path)| path.trace.rows.push(rows[i]));
        self.tick += 1;
        self.take_results();
        Ok(self.running() == 0)
    }

    /// Takes over the results of the step. Flights that end with it get their last row.
    fn take_results(&mut self) {
        let (out_of_time, width, drones) =
            (self.tick >= self.ticks, self.width(), self.batch.env.num_drones());
        let metrics = self.batch.metrics.as_chunks().0;
        for (episode, metrics) in self.all.iter_mut().zip(metrics).filter(|(episode, _)| !episode.is_over()) {
            episode.world_metrics = episode.world_metrics.map(|_| *metrics);
        }
        let paths = self.all.iter_mut().flat_map(|episode| &mut episode.paths);
        for (i, path) in paths.enumerate() {
            if path.over {
                continue;
            }
            let row = i * width..(i + 1) * width;
            self.observations[row.clone()].copy_from_slice(&self.batch.observations[row]);
            self.terminated[i] = !self.batch.flying[i];
            self.truncated[i] = out_of_time;
            path.rewards.push(self.batch.rewards[i]);
            path.trace.reward += f64::from(self.batch.rewards[i]);
            path.over = self.terminated[i] || out_of_time;
            if path.over {
                path.trace.rows.push(self.batch.row(i));
                // why one of several ended is told by the figures of its world
                path.trace.end = if self.terminated[i] && drones == 1 {
                    flight::end(&path.trace.rows)
                } else {
                    FlightEnd::Time
                };
            }
        }
    }

    /// # Errors
    /// The environment's, for buffers of the wrong lengths.
    pub(super) fn check(&self, out: &StepBuffers<'_>) -> Result<()> {
        let rows = self.rows();
        let want = [rows * self.width(), rows, rows, rows];
        let got = [out.observations.len(), out.rewards.len(), out.terminated.len(), out.truncated.len()];
        if want == got {
            return Ok(());
        }
        let shape = crazyflie_env::Error::Shape {
            what: "buffers of a step",
            want: format!("{want:?}"),
            got: format!("{got:?}"),
        };
        Err(shape.into())
    }

    /// Copies what the client is shown into buffers of the right lengths: no rewards, which know the true state.
    pub(super) fn copy_results(&self, out: StepBuffers<'_>) {
        out.observations.copy_from_slice(&self.observations);
        out.rewards.fill(0.0);
        out.terminated.copy_from_slice(&self.terminated);
        out.truncated.copy_from_slice(&self.truncated);
    }

    /// The flights, once all are over.
    pub(super) fn finish(self) -> Result<Vec<Episode>> {
        match self.running() {
            0 => Ok(self.all),
            left => Err(Error::NotOver { left, all: self.all.len() }),
        }
    }
}

impl Episode {
    fn is_over(&self) -> bool {
        self.paths.iter().all(|path| path.over)
    }

    /// SHA-256 over the true states of all ticks, drone by drone, as little-endian f32.
    pub(super) fn state_hash(&self) -> String {
        let mut hash = Sha256::new();
        let rows = self.paths.iter().flat_map(|path| &path.trace.rows);
        rows.flat_map(|row| row.state).for_each(|number| hash.update(number.to_le_bytes()));
        hex::encode(hash.finalize())
    }
}
