//! The benchmark on real files.

mod attempts;
mod baselines;
mod gaming;
mod handed_out;
mod hidden;
mod multi_drone;
mod seasons;
mod spelled;
mod stores;
mod tampering;
mod teams;

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Mutex;

use crazyflie_control::ControllerSpec;
use crazyflie_env::vector::StepBuffers;

use super::baselines::submit as submit_now;
use super::{Attempt, Bench, Result, TeamLimits};

/// A database of this test's own, beside the test's program. It stays until the next run, to be looked at.
fn path(test: &'static str) -> PathBuf {
    static BEGUN: Mutex<BTreeSet<&str>> = Mutex::new(BTreeSet::new());
    let folder = std::env::current_exe().unwrap().with_file_name("bench-tests").join(test);
    if BEGUN.lock().unwrap().insert(test) {
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
    }
    folder.join("bench.sqlite")
}

fn open(test: &'static str) -> Bench {
    Bench::open(&path(test)).unwrap()
}

fn submit(bench: &Bench, scenario: &str, controller: &str) -> String {
    submit_now(bench, scenario, &ControllerSpec::named(controller).unwrap().into()).unwrap().id
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
        let n = attempt.rows().unwrap();
        let (rewards, flags) = (vec![0.0; n], vec![false; n]);
        Buffers {
            observations: vec![0.0; n * attempt.width().unwrap()],
            rewards,
            terminated: flags.clone(),
            truncated: flags,
        }
    }

    fn step(&mut self, attempt: &mut Attempt, actions: &[f32]) -> Result<bool> {
        let Buffers { observations, rewards, terminated, truncated } = self;
        attempt.step(actions, StepBuffers::new(observations, rewards, terminated, truncated))
    }
}
