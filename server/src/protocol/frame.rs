//! The layout of binary messages, which both ends read and write.

use crazyflie_env::vector::{STATE, VectorEnv};

// numbers are copied as they are
const _: () = assert!(cfg!(target_endian = "little"));

/// Bytes before a request's payload.
pub const REQUEST_HEADER: usize = 16;
/// Bytes before a reply's payload.
pub const REPLY_HEADER: usize = 32;

/// Flag: the reply brings the true states along.
pub const STATES: u8 = 1;
/// Flag of a reply: the last episode of an extension's batch has ended.
pub const OVER: u8 = 2;
/// Flag of a reset: seeds follow.
pub const SEEDS: u8 = 2;
/// Flag of a reset: a mask follows.
pub const MASK: u8 = 4;
/// In a reply, the kind is marked with this bit.
pub const REPLY: u8 = 0x80;

/// The kind of a binary request, and of its reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "docs/protocol.md says what each does")]
pub enum FrameKind {
    Reset = 1,
    Step = 2,
    State = 3,
}

/// Sizes of a session's messages.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layout {
    /// Number of environments.
    pub envs: usize,
    /// Number of drones in each environment.
    pub drones: usize,
    /// Numbers in a drone's observation.
    pub width: usize,
    /// Numbers in an environment's metrics: none where a task has one drone.
    pub metrics: usize,
}

impl Layout {
    /// The sizes of a batch.
    pub fn new(env: &VectorEnv) -> Self {
        Layout {
            envs: env.num_envs(),
            drones: env.num_drones(),
            width: env.width(),
            metrics: env.num_metrics(),
        }
    }

    /// Drones of all environments.
    pub fn rows(&self) -> usize {
        self.envs * self.drones
    }

    /// Numbers of true states in one step.
    pub fn state_numbers(&self, states: bool) -> usize {
        if states { self.rows() * STATE } else { 0 }
    }

    /// Numbers that an episode's end adds to a step's reply, with same-step resets.
    pub fn final_numbers(&self, states: bool) -> usize {
        self.drones * (self.width + if states { STATE } else { 0 })
    }

    /// Truth values of each drone: terminated, truncated, and where there are several whether it flies on.
    pub fn flags(&self) -> usize {
        if self.metrics == 0 { 2 } else { 3 }
    }

    /// Bytes of a step's reply if no episode ends.
    pub fn reply_bytes(&self, steps: usize, states: bool) -> usize {
        let numbers = self.rows() * (self.width + 1) + self.state_numbers(states) + self.envs * self.metrics;
        REPLY_HEADER + steps.saturating_mul(4 * numbers + self.rows() * self.flags())
    }
}
