//! A batch that flies by actions which depend on the environment and the step alone.

use crazyflie_env::Result;
use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::vector::{StepBuffers, VectorEnv};

/// A batch under way, with its buffers.
pub(crate) struct Flight {
    pub(crate) env: VectorEnv,
    pub(crate) observations: Vec<f32>,
    pub(crate) rewards: Vec<f32>,
    pub(crate) terminated: Vec<bool>,
    pub(crate) truncated: Vec<bool>,
    pub(crate) flying: Vec<bool>,
    pub(crate) metrics: Vec<f32>,
    pub(crate) step: u64,
}

impl Flight {
    pub(crate) fn new(envs: usize, options: &str) -> Self {
        let options = Options::parse(&format!("{{{options}}}")).unwrap();
        Flight::begin(VectorEnv::new(&[Model::thesis()], &options, envs).unwrap())
    }

    /// Begin the flights of a batch.
    pub(crate) fn begin(mut env: VectorEnv) -> Self {
        let envs = env.num_envs();
        let rows = envs * env.num_drones();
        let mut observations = vec![0.0; rows * env.width()];
        let seeds: Vec<u64> = (0..envs as u64).collect();
        env.reset(Some(&seeds), None, &mut observations).unwrap();
        let (flying, metrics) =
            if env.num_metrics() == 0 { (0, 0) } else { (rows, envs * env.num_metrics()) };
        Flight {
            env,
            observations,
            rewards: vec![0.0; rows],
            terminated: vec![false; rows],
            truncated: vec![false; rows],
            flying: vec![true; flying],
            metrics: vec![0.0; metrics],
            step: 0,
        }
    }

    /// One step.
    pub(crate) fn step(&mut self) {
        self.try_step().unwrap();
    }

    /// Steps like [`Flight::step`] and returns any error.
    pub(crate) fn try_step(&mut self) -> Result<()> {
        let actions = self.actions(|axis, share| if axis == 3 { -0.3 + 0.1 * share } else { 0.6 * share });
        self.step_with(&actions)
    }

    /// Actions of which each number is made by `number` of its axis and a share from -1 to 1, which depends on the
    /// environment, the step and the axis alone.
    pub(crate) fn actions(&self, number: impl Fn(usize, f32) -> f32) -> Vec<f32> {
        let per_env = self.env.num_drones() * ACTION;
        let action = |i: usize| {
            let seed = (i / per_env) as u64 * 7919 + self.step * 64 + (i % per_env) as u64;
            number(i % ACTION, (crazyflie_env::noise::scramble(seed) >> 40) as f32 / 8_388_608.0 - 1.0)
        };
        (0..self.rewards.len() * ACTION).map(action).collect()
    }

    /// One step with these actions.
    pub(crate) fn step_with(&mut self, actions: &[f32]) -> Result<()> {
        let out = StepBuffers {
            observations: &mut self.observations,
            rewards: &mut self.rewards,
            terminated: &mut self.terminated,
            truncated: &mut self.truncated,
            flying: &mut self.flying,
            metrics: &mut self.metrics,
        };
        self.step += 1;
        self.env.step(actions, out)
    }

    pub(crate) fn row(&self, row: usize) -> &[f32] {
        &self.observations[row * self.env.width()..(row + 1) * self.env.width()]
    }

    pub(crate) fn bits(&self, envs: usize) -> Vec<u32> {
        let rows = envs * self.env.num_drones();
        self.observations[..rows * self.env.width()].iter().map(|number| number.to_bits()).collect()
    }
}
