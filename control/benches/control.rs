//! Cost of an answer of each controller: rows per second, one thread, on observations of a flight through the lab's
//! camera.

use std::hint::black_box;

use crazyflie_control::{Controller, ControllerContext, ControllerSpec, Mode, registry};
use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::vector::{StepBuffers, VectorEnv};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

const ENVS: usize = 256;
/// The first second, in which commands are at their limits.
const TICKS: usize = 50;
const OPTIONS: &str = r#"{"task": "hover", "vertical": "thrust", "effects": {"camera": 1, "camera_latency": 0.05, "camera_noise": {"xy_m": 0.005, "z_m": 0.01}}}"#;

/// The controller, and what it sees in its own flight.
fn flown(name: &str) -> (Box<dyn Controller>, Vec<Vec<f32>>) {
    let model = Model::thesis();
    let mut env =
        VectorEnv::new(std::slice::from_ref(&model), &Options::parse(OPTIONS).expect("options"), ENVS)
            .expect("environments");
    let site = ControllerContext {
        model: &model,
        interface: env.interfaces()[0],
        tick_s: env.tick_s(),
        envs: ENVS,
        mode: Mode::Automatic,
    };
    let mut pilot = ControllerSpec::named(name).and_then(|chosen| chosen.build(&site)).expect("controller");
    let (mut observations, mut actions) = (vec![0.0; ENVS * OBSERVATION], vec![0.0; ENVS * ACTION]);
    let (mut rewards, mut terminated, mut truncated) =
        (vec![0.0; ENVS], vec![false; ENVS], vec![false; ENVS]);
    let seeds: Vec<u64> = (0..ENVS as u64).collect();
    env.reset(Some(&seeds), None, &mut observations).expect("reset");
    let mut seen = Vec::new();
    for _ in 0..TICKS {
        seen.push(observations.clone());
        pilot.act(&observations, &mut actions).expect("act");
        let out = StepBuffers::new(&mut observations, &mut rewards, &mut terminated, &mut truncated);
        env.step(&actions, out).expect("step");
    }
    (pilot, seen)
}

fn answers(c: &mut Criterion) {
    let mut group = c.benchmark_group("control");
    group.throughput(Throughput::Elements((ENVS * TICKS) as u64)).sample_size(10);
    for name in registry().iter().filter(|e| e.file.is_none()).map(|e| e.name).chain(["kalman+thesis-pid"]) {
        let (mut pilot, seen) = flown(name);
        let mut actions = vec![0.0; ENVS * ACTION];
        group.bench_function(name, |b| {
            b.iter(|| {
                pilot.reset(&|_| true);
                for observations in &seen {
                    pilot.act(observations, black_box(&mut actions)).expect("act");
                }
            });
        });
    }
    group.finish();
}

criterion_group!(benches, answers);
criterion_main!(benches);
