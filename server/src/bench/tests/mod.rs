//! The benchmark on real files.

mod attempts;
mod baselines;
mod handed_out;
mod hidden;
mod tampering;
mod teams;

use std::path::PathBuf;

use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::vector::Out;

use super::baselines::{Baseline, submit as submit_now};
use super::{Attempt, Bench, Limits, Result};

/// A database of this test's own. The folder stays until the next run, to be looked at.
fn path(test: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("crazyflie-bench-{}", std::process::id())).join(test);
    std::fs::create_dir_all(&folder).unwrap();
    folder.join("bench.sqlite")
}

fn open(test: &str) -> Bench {
    Bench::open(&path(test), Limits::default()).unwrap()
}

fn submit(bench: &Bench, scenario: &str, baseline: Baseline) -> String {
    submit_now(bench, scenario, baseline).unwrap().id
}

/// A client's buffers.
struct Buffers {
    observations: Vec<f32>,
    rewards: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
}

impl Buffers {
    fn new(attempt: &Attempt) -> Buffers {
        let n = attempt.num_envs();
        let (rewards, flags) = (vec![0.0; n], vec![false; n]);
        Buffers { observations: vec![0.0; n * OBSERVATION], rewards, terminated: flags.clone(), truncated: flags }
    }

    fn step(&mut self, attempt: &mut Attempt, actions: &[f32]) -> Result<bool> {
        let Buffers { observations, rewards, terminated, truncated } = self;
        attempt.step(actions, Out { observations, rewards, terminated, truncated })
    }
}
