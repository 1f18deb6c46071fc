#![allow(dead_code)]
//! Worlds of several drones with room for their results.

use crazyflie_env::Result;
use crazyflie_env::action::Interface;
use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::plant::Command;
use crazyflie_env::vector::{METRICS, StepBuffers, VectorEnv};

/// Returns the options of a task of several drones: "formation" unless they name another.
pub fn fleet_options(text: &str) -> Result<Options> {
    let mut all: serde_json::Map<String, serde_json::Value> = serde_json::from_str(text).unwrap();
    all.entry("task").or_insert_with(|| "formation".into());
    Options::parse(&serde_json::Value::Object(all).to_string())
}

pub struct Fleet {
    pub env: VectorEnv,
    pub observations: Vec<f32>,
    pub rewards: Vec<f32>,
    pub terminated: Vec<bool>,
    pub truncated: Vec<bool>,
    pub flying: Vec<bool>,
    pub metrics: Vec<f32>,
}

impl Fleet {
    pub fn new(worlds: usize, options: &str) -> Self {
        Fleet::made(VectorEnv::new(&[Model::thesis()], &fleet_options(options).unwrap(), worlds).unwrap())
    }

    pub fn made(env: VectorEnv) -> Self {
        let (worlds, all) = (env.num_envs(), env.num_envs() * env.num_drones());
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
        let seeds: Vec<u64> = (0..self.env.num_envs() as u64).map(|i| first + i).collect();
        self.env.reset(Some(&seeds), None, &mut self.observations).unwrap();
        self.flying.fill(true);
    }

    pub fn step(&mut self, actions: &[f32]) -> Result<()> {
        let out = StepBuffers {
            observations: &mut self.observations,
            rewards: &mut self.rewards,
            terminated: &mut self.terminated,
            truncated: &mut self.truncated,
            flying: &mut self.flying,
            metrics: &mut self.metrics,
        };
        self.env.step(actions, out)
    }

    /// Returns actions that carry every drone: the PWM of its weight, or a height of 80 cm.
    pub fn level(&self) -> Vec<f32> {
        let lift = |interface: Interface| if interface.input.is_pwm() { interface.hover_lift } else { 0.8 };
        let one = |j: usize| {
            let interface = self.env.interfaces()[j];
            interface.action(&Command::level(lift(interface))).map(|a: f64| a as f32)
        };
        (0..self.env.num_envs()).flat_map(|_| (0..self.env.num_drones()).flat_map(one)).collect()
    }

    pub fn metric(&self, world: usize, name: &str) -> f32 {
        self.metrics[world * METRICS.len() + METRICS.iter().position(|m| m.0 == name).unwrap()]
    }
}
