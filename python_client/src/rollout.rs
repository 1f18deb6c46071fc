//! The caller's arrays for several steps at once.

use crazyflie_env::vector::{RolloutBuffers, StepBuffers};
use numpy::PyReadwriteArrayDyn;
use pyo3::prelude::*;

/// Results of the last step.
pub struct LastStep {
    /// Flags of a task with several drones.
    pub flying: Vec<bool>,
    pub metrics: Vec<f32>,
    /// Rewards of a rollout: made when the first one is flown.
    pub rewards: Vec<f32>,
    pub flags: [Vec<bool>; 2],
}

impl LastStep {
    /// Takes over flags and metrics of a state: of all environments, or of one for all.
    pub fn restore(&mut self, [flags, metrics]: [&[u8]; 2]) {
        self.flying.iter_mut().zip(flags.iter().cycle()).for_each(|(flies, byte)| *flies = *byte != 0);
        let metrics = metrics.as_chunks().0.iter().cycle();
        self.metrics.iter_mut().zip(metrics).for_each(|(number, bytes)| *number = f32::from_le_bytes(*bytes));
    }
}

/// The caller's arrays for a rollout.
pub struct RolloutArrays<'py> {
    pub rows: PyReadwriteArrayDyn<'py, f32>,
    pub returns: PyReadwriteArrayDyn<'py, f32>,
    /// Rewards, observations.
    pub numbers: [Option<PyReadwriteArrayDyn<'py, f32>>; 2],
    /// Terminated, truncated.
    pub flags: [Option<PyReadwriteArrayDyn<'py, bool>>; 2],
}

impl RolloutArrays<'_> {
    /// # Errors
    /// `ValueError` for an array that is not contiguous.
    pub fn buffers<'a>(&'a mut self, last: &'a mut LastStep) -> PyResult<RolloutBuffers<'a>> {
        fn slice<'a, T: numpy::Element>(
            array: &'a mut Option<PyReadwriteArrayDyn<'_, T>>,
        ) -> PyResult<&'a mut [T]> {
            array.as_mut().map_or(Ok(&mut [][..]), |array| Ok(array.as_slice_mut()?))
        }
        let RolloutArrays { rows, returns, numbers: [rewards, observations], flags: [terminated, truncated] } =
            self;
        let returns = returns.as_slice_mut()?;
        last.rewards.resize(returns.len(), 0.0);
        last.flags.iter_mut().for_each(|flags| flags.resize(returns.len(), false));
        let [last_terminated, last_truncated] = &mut last.flags;
        let (observations, rewards) = (slice(observations)?, slice(rewards)?);
        let (terminated, truncated) = (slice(terminated)?, slice(truncated)?);
        let last = StepBuffers {
            observations: rows.as_slice_mut()?,
            rewards: &mut last.rewards,
            terminated: last_terminated,
            truncated: last_truncated,
            flying: &mut last.flying,
            metrics: &mut last.metrics,
        };
        Ok(RolloutBuffers { last, returns, observations, rewards, terminated, truncated })
    }
}
