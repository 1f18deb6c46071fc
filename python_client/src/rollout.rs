//! The caller's arrays for several steps at once.

use crazyflie_env::vector::{RolloutBuffers, StepBuffers};
use numpy::PyReadwriteArrayDyn;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The batch that a controller was made for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct BatchParts {
    pub envs: usize,
    /// Environments of each part but the last.
    pub share: usize,
    /// True if each part has a controller of its own.
    pub divisible: bool,
}

impl BatchParts {
    /// # Errors
    /// `ValueError` for a controller in Python, and for one of another batch.
    pub fn check(self, envs: usize, share: usize) -> PyResult<()> {
        if !self.divisible {
            return Err(PyValueError::new_err(
                "controller: one in Python answers for the whole batch at once, so that no rollout can fly it: \
                 call its `act` and `step` for every step",
            ));
        }
        if (self.envs, self.share) == (envs, share) {
            return Ok(());
        }
        Err(PyValueError::new_err(format!(
            "controller: it was made for another batch, of {} environments in parts of {}; expected {envs} in \
             parts of {share}: the `controller` method of the environment makes one",
            self.envs, self.share
        )))
    }
}

/// Results of the last step.
pub struct LastStep {
    /// Flags of a task with several drones.
    pub flying: Vec<bool>,
    pub metrics: Vec<f32>,
    /// Rewards of a rollout: made when the first one is flown.
    pub rewards: Vec<f32>,
    pub flags: [Vec<bool>; 2],
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
