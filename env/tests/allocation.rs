//! A step allocates nothing: counted by the allocator itself.
#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::vector::{RolloutBuffers, StepBuffers, VectorEnv};

struct Counting;

static CALLS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system's allocator unchanged
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        CALLS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's promise
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

#[test]
fn a_step_allocates_nothing_also_where_episodes_end() {
    for threads in [1, 2] {
        for level in crazyflie_env::action::registry() {
            no_allocation(threads, level.name, "motors");
            if !level.level.is_below_attitude() {
                no_allocation(threads, level.name, "pwm");
            }
        }
    }
}

fn no_allocation(threads: usize, level: &str, vertical: &str) {
    let text = r#"{"max_episode_steps": 20, "action": LEVEL, "threads": THREADS, "vertical": VERTICAL, "autoreset": "same_step", "effects": {"camera_noise": {"xy_m": 0.004}, "camera_latency": 0.05,
        "cmd_delay": 0.03, "battery_sag": {"exponent": 1}, "drag_linear": {"uniform": [0, 1]}, "gust": 0.2}}"#;
    let n = 100;
    let mut env = VectorEnv::new(
        &[Model::thesis()],
        &Options::parse(
            &text
                .replace("THREADS", &threads.to_string())
                .replace("LEVEL", &format!("{level:?}"))
                .replace("VERTICAL", &format!("{vertical:?}")),
        )
        .unwrap(),
        n,
    )
    .unwrap();
    let mut observations = vec![0.0; n * OBSERVATION];
    let seeds: Vec<u64> = (0..n as u64).collect();
    env.reset(Some(&seeds), None, &mut observations).unwrap();
    let actions = vec![0.1; n * ACTION];
    let (mut rewards, mut terminated, mut truncated) = (vec![0.0; n], vec![false; n], vec![false; n]);
    let (mut before, mut ended) = (0, 0);
    for step in 0..220 {
        // the standard library makes a thread's handle when it is first asked for
        if step == 20 {
            (before, ended) = (CALLS.load(Ordering::Relaxed), 0);
        }
        let out = StepBuffers::new(&mut observations, &mut rewards, &mut terminated, &mut truncated);
        env.step(&actions, out).unwrap();
        ended += truncated.iter().filter(|t| **t).count();
    }
    assert_eq!(CALLS.load(Ordering::Relaxed) - before, 0);
    assert_eq!(ended, 1000);
    let (steps, mut returns, mut history) = (40, vec![0.0; n], vec![0.0; 40 * n]);
    let actions = vec![0.1; steps * n * ACTION];
    let out = RolloutBuffers {
        last: StepBuffers::new(&mut observations, &mut rewards, &mut terminated, &mut truncated),
        returns: &mut returns,
        observations: &mut [],
        rewards: &mut history,
        terminated: &mut [],
        truncated: &mut [],
    };
    before = CALLS.load(Ordering::Relaxed);
    env.rollout(&actions, steps, out).unwrap();
    assert_eq!(CALLS.load(Ordering::Relaxed) - before, 0, "in a rollout");
}
