//! A batch of environments with the arrays that it is flown by.

use crazyflie_env::Error;
use crazyflie_env::action::ACTION;
use crazyflie_env::vector::{STATE, StepBuffers, VectorEnv};

use super::{TraceRow, row};

/// Environments in lock-step, and what is known of them: in each array a row for each drone, environment by
/// environment.
pub struct EnvBatch {
    /// The environments.
    pub env: VectorEnv,
    /// Actions of the next tick, or of the last one.
    pub actions: Vec<f32>,
    /// Observations after the last tick.
    pub observations: Vec<f32>,
    /// True states.
    pub states: Vec<f32>,
    /// Rewards of the last tick.
    pub rewards: Vec<f32>,
    /// The drone's flight ended in the last tick.
    pub terminated: Vec<bool>,
    /// Its environment's time ran out in the last tick.
    pub truncated: Vec<bool>,
    /// It flies on.
    pub flying: Vec<bool>,
    /// Rows of [`crazyflie_env::vector::METRICS`], one for each environment of several drones.
    pub metrics: Vec<f32>,
}

impl EnvBatch {
    /// Begins the first episode of each seed.
    ///
    /// # Errors
    /// For another number of seeds than of environments.
    pub fn begin(env: VectorEnv, seeds: &[u64]) -> Result<EnvBatch, Error> {
        let rows = env.num_envs() * env.num_drones();
        let mut batch = EnvBatch {
            actions: vec![0.0; rows * ACTION],
            observations: vec![0.0; rows * env.width()],
            states: vec![0.0; rows * STATE],
            rewards: vec![0.0; rows],
            terminated: vec![false; rows],
            truncated: vec![false; rows],
            flying: vec![true; rows],
            metrics: vec![0.0; env.num_envs() * env.num_metrics()],
            env,
        };
        batch.env.reset(Some(seeds), None, &mut batch.observations)?;
        batch.env.states(&mut batch.states)?;
        Ok(batch)
    }

    /// Flies a tick with the actions.
    ///
    /// # Errors
    /// Before anything moves, for an action that is not made of numbers from -1 to 1.
    pub fn step(&mut self) -> Result<(), Error> {
        let out = StepBuffers {
            observations: &mut self.observations,
            rewards: &mut self.rewards,
            terminated: &mut self.terminated,
            truncated: &mut self.truncated,
            flying: &mut self.flying,
            metrics: &mut self.metrics,
        };
        self.env.step(&self.actions, out)?;
        self.env.states(&mut self.states)
    }

    /// Returns the row of a drone now.
    pub fn row(&self, drone: usize) -> TraceRow {
        row(drone, self.env.width(), &self.observations, &self.states, &self.actions)
    }
}
