#![allow(dead_code)]
//! Worlds of several drones with room for their results.

use crazyflie_env::Result;
use crazyflie_env::model::Model;
use crazyflie_env::observation::Interface;
use crazyflie_env::plant::Command;
use crazyflie_env::swarm::{METRICS, SwarmEnv, SwarmOptions, SwarmOut};

pub struct Fleet {
    pub env: SwarmEnv,
    pub observations: Vec<f32>,
    pub rewards: Vec<f32>,
    pub terminated: Vec<bool>,
    pub truncated: Vec<bool>,
    pub flying: Vec<bool>,
    pub metrics: Vec<f32>,
}

impl Fleet {
    pub fn new(worlds: usize, options: &str) -> Self {
        Fleet::made(SwarmEnv::new(&[Model::thesis()], &SwarmOptions::parse(options).unwrap(), worlds).unwrap())
    }

    pub fn made(env: SwarmEnv) -> Self {
        let (worlds, all) = (env.num_worlds(), env.num_worlds() * env.num_drones());
        Fleet {
            observations: vec![0.0; all * env.width()],
            rewards: vec![0.0; all],
            terminated: vec![false; all],
            truncated: vec![false; all],
            flying: vec![false; all],
            metrics: vec![0.0; worlds * METRICS.len()],
            env,
        }
    }

    /// Each world with its number as its seed, from `first` on.
    pub fn reset(&mut self, first: u64) {
        let seeds: Vec<u64> = (0..self.env.num_worlds() as u64).map(|i| first + i).collect();
        self.env.reset(Some(&seeds), None, &mut self.observations).unwrap();
        self.flying.fill(true);
    }

    pub fn step(&mut self, actions: &[f32]) -> Result<()> {
        let out = SwarmOut {
            observations: &mut self.observations,
            rewards: &mut self.rewards,
            terminated: &mut self.terminated,
            truncated: &mut self.truncated,
            flying: &mut self.flying,
            metrics: &mut self.metrics,
        };
        self.env.step(actions, out)
    }

    /// Actions that carry every drone: what holds its weight, or a height of 80 cm.
    pub fn level(&self) -> Vec<f32> {
        let lift = |interface: Interface| if interface.input.is_pwm() { interface.hover_lift } else { 0.8 };
        let one = |j: usize| {
            let interface = self.env.interface(j).expect("a drone");
            interface.action(&Command::level(lift(interface))).map(|a: f64| a as f32)
        };
        (0..self.env.num_worlds()).flat_map(|_| (0..self.env.num_drones()).flat_map(one)).collect()
    }

    pub fn metric(&self, world: usize, name: &str) -> f32 {
        self.metrics[world * METRICS.len() + METRICS.iter().position(|m| m.0 == name).unwrap()]
    }
}
