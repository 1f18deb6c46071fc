//! A step's buffers, tile by tile.

use super::Out;
use crate::lanes::LANES;
use crate::observation::{ACTION, OBSERVATION};

/// The results of a step for a whole tile.
pub(super) struct Rows<'a> {
    pub(super) observations: &'a mut [f32; LANES * OBSERVATION],
    pub(super) rewards: &'a mut [f32; LANES],
    pub(super) terminated: &'a mut [bool; LANES],
    pub(super) truncated: &'a mut [bool; LANES],
}

/// A step's buffers by tiles. A last tile of fewer than sixteen environments is stepped in buffers of its own.
pub(super) struct Buffers<'a> {
    actions: &'a [[f32; LANES * ACTION]],
    observations: &'a mut [[f32; LANES * OBSERVATION]],
    rewards: &'a mut [[f32; LANES]],
    terminated: &'a mut [[bool; LANES]],
    truncated: &'a mut [[bool; LANES]],
    /// Where the last tile's results go.
    last: Out<'a>,
    rest: &'a mut Rest,
}

pub(super) struct Rest {
    actions: [f32; LANES * ACTION],
    observations: [f32; LANES * OBSERVATION],
    rewards: [f32; LANES],
    terminated: [bool; LANES],
    truncated: [bool; LANES],
}

impl Rest {
    pub(super) fn new(actions: &[f32]) -> Self {
        let (_, actions) = actions.as_chunks::<{ LANES * ACTION }>();
        let mut rest = Rest {
            actions: [0.0; LANES * ACTION],
            observations: [0.0; LANES * OBSERVATION],
            rewards: [0.0; LANES],
            terminated: [false; LANES],
            truncated: [false; LANES],
        };
        rest.actions[..actions.len()].copy_from_slice(actions);
        rest
    }
}

impl<'a> Buffers<'a> {
    pub(super) fn new(actions: &'a [f32], out: Out<'a>, rest: &'a mut Rest) -> Self {
        let (observations, last_observations) = out.observations.as_chunks_mut();
        let (rewards, last_rewards) = out.rewards.as_chunks_mut();
        let (terminated, last_terminated) = out.terminated.as_chunks_mut();
        let (truncated, last_truncated) = out.truncated.as_chunks_mut();
        let last = Out { observations: last_observations, rewards: last_rewards, terminated: last_terminated, truncated: last_truncated };
        Buffers { actions: actions.as_chunks().0, observations, rewards, terminated, truncated, last, rest }
    }

    #[inline(always)]
    pub(super) fn actions(&self, tile: usize) -> &[f32; LANES * ACTION] {
        self.actions.get(tile).unwrap_or(&self.rest.actions)
    }

    #[inline(always)]
    pub(super) fn rows(&mut self, tile: usize) -> Rows<'_> {
        if tile == self.observations.len() {
            let Rest { observations, rewards, terminated, truncated, .. } = &mut *self.rest;
            return Rows { observations, rewards, terminated, truncated };
        }
        Rows {
            observations: &mut self.observations[tile],
            rewards: &mut self.rewards[tile],
            terminated: &mut self.terminated[tile],
            truncated: &mut self.truncated[tile],
        }
    }

    /// Hands over the last tile's results.
    pub(super) fn finish(self) {
        let Out { observations, rewards, terminated, truncated } = self.last;
        observations.copy_from_slice(&self.rest.observations[..observations.len()]);
        rewards.copy_from_slice(&self.rest.rewards[..rewards.len()]);
        terminated.copy_from_slice(&self.rest.terminated[..terminated.len()]);
        truncated.copy_from_slice(&self.rest.truncated[..truncated.len()]);
    }
}
