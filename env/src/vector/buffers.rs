//! A step's buffers: the caller's, and those of one drone per environment tile by tile.

use crate::action::ACTION;
use crate::lanes::LANES;
use crate::observation::OBSERVATION;

/// The caller's buffers for the results of a step: a row for each drone, environment by environment.
#[derive(Debug)]
pub struct StepBuffers<'a> {
    /// Rows of [`super::VectorEnv::width`]. They are written a tenth to a fifth faster where they begin at a
    /// multiple of 32 bytes.
    pub observations: &'a mut [f32],
    /// One reward per drone, for this step alone.
    pub rewards: &'a mut [f32],
    /// The drone's flight ended in this step: collided, crashed, or its part done.
    pub terminated: &'a mut [bool],
    /// Its environment's time ran out in this step.
    pub truncated: &'a mut [bool],
    /// It flies on: its next action counts. May be empty where a task has one drone.
    pub flying: &'a mut [bool],
    /// Rows of [`super::METRICS`], one for each environment, empty where a task has one drone; in an
    /// episode's last step those of the whole episode, also where the next one began at once.
    pub metrics: &'a mut [f32],
}

impl<'a> StepBuffers<'a> {
    /// For a task of one drone, whose flag of flying on is of no interest.
    pub fn new(
        observations: &'a mut [f32],
        rewards: &'a mut [f32],
        terminated: &'a mut [bool],
        truncated: &'a mut [bool],
    ) -> Self {
        StepBuffers { observations, rewards, terminated, truncated, flying: &mut [], metrics: &mut [] }
    }

    /// Cuts off the buffers of the first `envs` environments of `drones`, or of all that are left.
    pub(super) fn split(
        &mut self,
        envs: usize,
        drones: usize,
        width: usize,
        metrics: usize,
    ) -> StepBuffers<'a> {
        let rows = envs * drones;
        StepBuffers {
            observations: cut(&mut self.observations, rows * width),
            rewards: cut(&mut self.rewards, rows),
            terminated: cut(&mut self.terminated, rows),
            truncated: cut(&mut self.truncated, rows),
            flying: cut(&mut self.flying, rows),
            metrics: cut(&mut self.metrics, envs * metrics),
        }
    }
}

impl StepBuffers<'_> {
    pub(super) fn reborrow(&mut self) -> StepBuffers<'_> {
        StepBuffers {
            observations: &mut *self.observations,
            rewards: &mut *self.rewards,
            terminated: &mut *self.terminated,
            truncated: &mut *self.truncated,
            flying: &mut *self.flying,
            metrics: &mut *self.metrics,
        }
    }
}

/// The caller's buffers for the results of a rollout of K steps, each row as in [`StepBuffers`].
#[derive(Debug)]
pub struct RolloutBuffers<'a> {
    /// Of the last step. While a part of the batch flies its steps, those of the steps before are here.
    pub last: StepBuffers<'a>,
    /// For each drone the sum of its rewards, until its first flight ends.
    pub returns: &'a mut [f32],
    /// Of all steps, one after the other. Each of these may be empty, where it is of no interest.
    pub observations: &'a mut [f32],
    /// As `observations`.
    pub rewards: &'a mut [f32],
    /// As `observations`.
    pub terminated: &'a mut [bool],
    /// As `observations`.
    pub truncated: &'a mut [bool],
}

/// Takes the first `count` away, or all that are left.
pub(super) fn cut<'a, T>(rest: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let count = count.min(rest.len());
    let (first, others) = std::mem::take(rest).split_at_mut(count);
    *rest = others;
    first
}

/// The results of a step for a whole tile.
pub(super) struct TileRows<'a> {
    pub(super) observations: &'a mut [f32; LANES * OBSERVATION],
    pub(super) rewards: &'a mut [f32; LANES],
    pub(super) terminated: &'a mut [bool; LANES],
    pub(super) truncated: &'a mut [bool; LANES],
    /// Where an [`super::observer::Observer`] writes, of all tiles; empty where there is none.
    pub(super) observed: &'a mut [f32],
}

/// A step's buffers by tiles. A last tile of fewer than sixteen environments is stepped in buffers of its
/// own.
pub(super) struct TileBuffers<'a> {
    actions: &'a [[f32; LANES * ACTION]],
    observations: &'a mut [[f32; LANES * OBSERVATION]],
    rewards: &'a mut [[f32; LANES]],
    terminated: &'a mut [[bool; LANES]],
    truncated: &'a mut [[bool; LANES]],
    observed: &'a mut [f32],
    /// Where the last tile's results go.
    last: StepBuffers<'a>,
    tail: &'a mut TailBuffers,
}

pub(super) struct TailBuffers {
    actions: [f32; LANES * ACTION],
    observations: [f32; LANES * OBSERVATION],
    rewards: [f32; LANES],
    terminated: [bool; LANES],
    truncated: [bool; LANES],
}

impl TailBuffers {
    pub(super) fn new(actions: &[f32]) -> Self {
        let (_, actions) = actions.as_chunks::<{ LANES * ACTION }>();
        let mut tail = TailBuffers {
            actions: [0.0; LANES * ACTION],
            observations: [0.0; LANES * OBSERVATION],
            rewards: [0.0; LANES],
            terminated: [false; LANES],
            truncated: [false; LANES],
        };
        tail.actions[..actions.len()].copy_from_slice(actions);
        tail
    }
}

impl<'a> TileBuffers<'a> {
    pub(super) fn new(
        actions: &'a [f32],
        observed: &'a mut [f32],
        out: StepBuffers<'a>,
        tail: &'a mut TailBuffers,
    ) -> Self {
        let (observations, last_observations) = out.observations.as_chunks_mut();
        let (rewards, last_rewards) = out.rewards.as_chunks_mut();
        let (terminated, last_terminated) = out.terminated.as_chunks_mut();
        let (truncated, last_truncated) = out.truncated.as_chunks_mut();
        let last = StepBuffers::new(last_observations, last_rewards, last_terminated, last_truncated);
        TileBuffers {
            actions: actions.as_chunks().0,
            observations,
            rewards,
            terminated,
            truncated,
            observed,
            last,
            tail,
        }
    }

    #[inline(always)]
    pub(super) fn actions(&self, tile: usize) -> &[f32; LANES * ACTION] {
        self.actions.get(tile).unwrap_or(&self.tail.actions)
    }

    #[inline(always)]
    pub(super) fn rows(&mut self, tile: usize) -> TileRows<'_> {
        if tile == self.observations.len() {
            let TailBuffers { observations, rewards, terminated, truncated, .. } = &mut *self.tail;
            let observed = &mut *self.observed;
            return TileRows { observations, rewards, terminated, truncated, observed };
        }
        TileRows {
            observations: &mut self.observations[tile],
            rewards: &mut self.rewards[tile],
            terminated: &mut self.terminated[tile],
            truncated: &mut self.truncated[tile],
            observed: &mut *self.observed,
        }
    }

    /// Hands over the last tile's results.
    pub(super) fn finish(self) {
        let StepBuffers { observations, rewards, terminated, truncated, .. } = self.last;
        observations.copy_from_slice(&self.tail.observations[..observations.len()]);
        rewards.copy_from_slice(&self.tail.rewards[..rewards.len()]);
        terminated.copy_from_slice(&self.tail.terminated[..terminated.len()]);
        truncated.copy_from_slice(&self.tail.truncated[..truncated.len()]);
    }
}
