//! What an attempt flies in: environments of one drone each, or worlds that several drones share. Rows are episode by episode, and within an
//! episode drone by drone.

use crazyflie_env::observation::{ACTION, Interface, OBSERVATION};
use crazyflie_env::swarm::{METRICS, SwarmEnv, SwarmOut};
use crazyflie_env::vector::{Out, STATE, VectorEnv};

use super::error::Result;

pub(crate) enum Fleet {
    Alone(VectorEnv),
    /// With what the actions of each drone mean.
    Shared(SwarmEnv, Interface),
}

/// What a step of a fleet gives.
pub(crate) struct Given {
    /// Rows of [`Fleet::width`], one for each drone; so are all that follow but the last.
    pub observations: Vec<f32>,
    pub rewards: Vec<f32>,
    /// Its flight ended.
    pub terminated: Vec<bool>,
    pub truncated: Vec<bool>,
    /// Its next action counts.
    pub flying: Vec<bool>,
    /// Rows of [`METRICS`], one for each episode.
    pub metrics: Vec<f32>,
}

impl Fleet {
    pub(crate) fn episodes(&self) -> usize {
        match self {
            Fleet::Alone(env) => env.num_envs(),
            Fleet::Shared(env, _) => env.num_worlds(),
        }
    }

    /// In each episode.
    pub(crate) fn drones(&self) -> usize {
        match self {
            Fleet::Alone(_) => 1,
            Fleet::Shared(env, _) => env.num_drones(),
        }
    }

    /// Numbers in a drone's observation.
    pub(crate) fn width(&self) -> usize {
        match self {
            Fleet::Alone(_) => OBSERVATION,
            Fleet::Shared(env, _) => env.width(),
        }
    }

    pub(crate) fn tick_s(&self) -> f64 {
        match self {
            Fleet::Alone(env) => env.tick_s(),
            Fleet::Shared(env, _) => env.tick_s(),
        }
    }

    /// Of each drone.
    pub(crate) fn interface(&self) -> Interface {
        match self {
            Fleet::Alone(env) => env.interface(),
            Fleet::Shared(_, interface) => *interface,
        }
    }

    /// Begins an episode for each seed.
    pub(crate) fn begin(&mut self, seeds: &[u64]) -> Result<Given> {
        let (drones, episodes) = (self.episodes() * self.drones(), self.episodes());
        let mut given = Given {
            observations: vec![0.0; drones * self.width()],
            rewards: vec![0.0; drones],
            terminated: vec![false; drones],
            truncated: vec![false; drones],
            flying: vec![true; drones],
            metrics: vec![0.0; episodes * METRICS.len()],
        };
        match self {
            Fleet::Alone(env) => env.reset(Some(seeds), None, &mut given.observations)?,
            Fleet::Shared(env, _) => env.reset(Some(seeds), None, &mut given.observations)?,
        }
        Ok(given)
    }

    /// One tick of every drone: rows of [`ACTION`].
    ///
    /// # Errors
    /// Before anything moves, of the environment.
    pub(crate) fn step(&mut self, actions: &[f32], given: &mut Given) -> Result<()> {
        debug_assert_eq!(actions.len(), given.rewards.len() * ACTION);
        let Given { observations, rewards, terminated, truncated, flying, metrics } = given;
        match self {
            Fleet::Alone(env) => {
                env.step(actions, Out { observations, rewards, terminated, truncated })?;
                flying.iter_mut().zip(&*terminated).for_each(|(flying, terminated)| *flying = !terminated);
            }
            Fleet::Shared(env, _) => env.step(actions, SwarmOut { observations, rewards, terminated, truncated, flying, metrics })?,
        }
        Ok(())
    }

    /// The true states, rows of [`STATE`].
    pub(crate) fn states(&self) -> Result<Vec<f32>> {
        let mut states = vec![0.0; self.episodes() * self.drones() * STATE];
        match self {
            Fleet::Alone(env) => env.states(&mut states)?,
            Fleet::Shared(env, _) => env.states(&mut states)?,
        }
        Ok(states)
    }
}
