//! Drone-steps per second of the Rust core on one core: bare and with effects, each including action mapping, observation, reward,
//! termination and automatic reset. `cargo bench -p crazyflie-env`.

use std::hint::black_box;

use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::observation::{ACTION, OBSERVATION};
use crazyflie_env::vector::{Out, VectorEnv};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};

const EFFECTS: &str = r#""vertical": "pwm", "effects": {"camera_noise": {"xy_m": 0.004, "z_m": 0.008, "yaw_deg": 0.5}, "ground_effect": 1.0,
    "drag_linear": 0.3, "cmd_delay": 0.03, "battery_sag": {"exponent": 1.0, "resistance_ohm": 0.1}}"#;

struct Rig {
    env: VectorEnv,
    actions: Vec<f32>,
    observations: Vec<f32>,
    rewards: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
}

impl Rig {
    fn new(envs: usize, threads: usize, effects: bool) -> Self {
        let text = format!(
            "{{\"max_episode_steps\": 500, \"threads\": {threads}{}}}",
            if effects { format!(", {EFFECTS}") } else { String::new() }
        );
        let options = Options::parse(&text).expect("options of the benchmark");
        let mut env = VectorEnv::new(&Model::thesis(), &options, envs).expect("environments");
        let mut observations = vec![0.0; envs * OBSERVATION];
        let seeds: Vec<u64> = (0..envs as u64).collect();
        env.reset(Some(&seeds), None, &mut observations).expect("reset");
        // small tilts to all sides, the weight carried: flights last, and still end at all times
        let hover = env.interface();
        let lift = if effects { (2.0 * hover.hover_lift / hover.lift_max - 1.0) as f32 } else { 0.0 };
        let actions =
            (0..envs * ACTION).map(|i| if i % ACTION == 3 { lift } else { 0.02 * ((i * 7919 % 199) as f32 / 99.0 - 1.0) }).collect();
        Rig { env, actions, observations, rewards: vec![0.0; envs], terminated: vec![false; envs], truncated: vec![false; envs] }
    }

    fn step(&mut self) {
        let out = Out {
            observations: &mut self.observations,
            rewards: &mut self.rewards,
            terminated: &mut self.terminated,
            truncated: &mut self.truncated,
        };
        self.env.step(black_box(&self.actions), out).expect("step");
    }
}

fn bench(c: &mut Criterion) {
    let level = crazyflie_env::isa::Level::best().name();
    for (name, effects) in [("bare", false), ("five_effects", true)] {
        let mut group = c.benchmark_group(format!("{name}/{level}"));
        for (envs, threads) in [(1, 1), (256, 1), (1024, 1), (4096, 1), (16384, 1), (65536, 1), (65536, 2)] {
            let mut rig = Rig::new(envs, threads, effects);
            for _ in 0..600 {
                rig.step();
            }
            group.throughput(Throughput::Elements(envs as u64));
            group.bench_function(BenchmarkId::from_parameter(format!("{envs}_envs_{threads}_threads")), |b| b.iter(|| rig.step()));
        }
        group.finish();
    }
}

criterion_group! { name = steps; config = Criterion::default().sample_size(20).measurement_time(std::time::Duration::from_secs(2)); targets = bench }
criterion_main!(steps);
