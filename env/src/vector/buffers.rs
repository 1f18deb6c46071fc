//! The caller's buffers for a step or for several.

use std::ops::{Deref, DerefMut, Range};

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
    /// No buffers.
    pub(super) fn none() -> Self {
        StepBuffers::new(&mut [], &mut [], &mut [], &mut [])
    }

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
    /// Buffers of the last step. While a part of the batch flies its steps, they contain those of the steps before.
    pub last: StepBuffers<'a>,
    /// For each drone the sum of its rewards, until its first flight ends.
    pub returns: &'a mut [f32],
    /// Values of all steps, one after the other. Each of these may be empty if it is not needed.
    pub observations: &'a mut [f32],
    /// Rewards, like `observations`.
    pub rewards: &'a mut [f32],
    /// Terminations, like `observations`.
    pub terminated: &'a mut [bool],
    /// Truncations, like `observations`.
    pub truncated: &'a mut [bool],
}

/// Takes the first `count` away, or all that are left.
pub(super) fn cut<'a, T>(rest: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let count = count.min(rest.len());
    let (first, others) = std::mem::take(rest).split_at_mut(count);
    *rest = others;
    first
}

/// Numbers that begin at a cache line, where rows are written faster.
pub(super) struct AlignedNumbers {
    room: Vec<f32>,
    numbers: Range<usize>,
}

impl AlignedNumbers {
    /// So many zeros.
    pub(super) fn zeros(count: usize) -> Self {
        let room = vec![0.0; if count == 0 { 0 } else { count + CACHE_LINE }];
        let first = room.as_ptr().align_offset(CACHE_LINE * size_of::<f32>()).min(room.len() - count);
        AlignedNumbers { room, numbers: first..first + count }
    }
}

impl Deref for AlignedNumbers {
    type Target = [f32];
    fn deref(&self) -> &[f32] {
        &self.room[self.numbers.clone()]
    }
}

impl DerefMut for AlignedNumbers {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.room[self.numbers.clone()]
    }
}

/// Numbers in a cache line.
const CACHE_LINE: usize = 16;
