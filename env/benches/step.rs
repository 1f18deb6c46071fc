//! Drone-steps per second of the Rust core: bare and with effects, each including action mapping,
//! observation, reward, termination and automatic reset; on one core with every instruction set of the
//! machine, and on two. Criterion prints the median in the middle of its three figures. `cargo bench -p
//! crazyflie-env`.

use std::hint::black_box;

use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::isa::Level;
use crazyflie_env::model::Model;
use crazyflie_env::observation::CHOICES;
use crazyflie_env::vector::{StepBuffers, VectorEnv};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};

const EFFECTS: &str = r#""vertical": "pwm", "effects": {"camera_noise": {"xy_m": 0.004, "z_m": 0.008, "yaw_deg": 0.5}, "ground_effect": 1.0,
    "drag_linear": 0.3, "cmd_delay": 0.03, "battery_sag": {"exponent": 1.0, "resistance_ohm": 0.1}}"#;

struct Rig {
    env: VectorEnv,
    actions: Vec<f32>,
    /// With room to begin the rows at a cache line, see [`Out`].
    room: Vec<f32>,
    skip: usize,
    rewards: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
}

impl Rig {
    fn new(envs: usize, threads: usize, isa: &str, effects: bool, more: &str) -> Self {
        let text = format!(
            "{{\"max_episode_steps\": 500, \"threads\": {threads}, \"isa\": \"{isa}\"{}{more}}}",
            if effects { format!(", {EFFECTS}") } else { String::new() }
        );
        let options = Options::parse(&text).expect("options of the benchmark");
        let mut env = VectorEnv::new(&[Model::thesis()], &options, envs).expect("environments");
        let numbers = envs * env.width();
        let mut room = vec![0.0_f32; numbers + 16];
        let skip = room.as_ptr().align_offset(64);
        let seeds: Vec<u64> = (0..envs as u64).collect();
        env.reset(Some(&seeds), None, &mut room[skip..skip + numbers]).expect("reset");
        // small tilts to all sides, the weight carried: flights last, and still end at all times
        let hover = env.interfaces()[0];
        let lift = if effects { (2.0 * hover.hover_lift / hover.lift_max - 1.0) as f32 } else { 0.0 };
        let actions = (0..envs * ACTION)
            .map(|i| if i % ACTION == 3 { lift } else { 0.02 * ((i * 7919 % 199) as f32 / 99.0 - 1.0) })
            .collect();
        Rig {
            env,
            actions,
            room,
            skip,
            rewards: vec![0.0; envs],
            terminated: vec![false; envs],
            truncated: vec![false; envs],
        }
    }

    fn step(&mut self) {
        let out = StepBuffers::new(
            &mut self.room[self.skip..self.skip + self.rewards.len() * self.env.width()],
            &mut self.rewards,
            &mut self.terminated,
            &mut self.truncated,
        );
        self.env.step(black_box(&self.actions), out).expect("step");
    }
}

fn bench(c: &mut Criterion) {
    println!(
        "{}, {} logical cores, load {}",
        processor(),
        std::thread::available_parallelism().map_or(0, usize::from),
        load()
    );
    println!(
        "hover, next-step resets, at most 500 steps per episode; five effects: {}",
        EFFECTS.replace("\n   ", "")
    );
    for (name, effects) in [("bare", false), ("five_effects", true)] {
        for level in Level::available() {
            let mut group = c.benchmark_group(format!("{name}/{}", level.name()));
            let (best, sizes) = (level == Level::best(), [256, 1024, 4096, 16384, 65536]);
            let one_core = sizes.into_iter().filter(|envs| best || *envs == 1024).map(|envs| (envs, 1));
            let others = [(1, 1), (65536, 2)].into_iter().filter(|_| best);
            for (envs, threads) in one_core.chain(others) {
                let mut rig = Rig::new(envs, threads, level.name(), effects, "");
                for _ in 0..600 {
                    rig.step();
                }
                group.throughput(Throughput::Elements(envs as u64));
                let cores = if threads == 1 { "one_core" } else { "two_cores" };
                group.bench_function(BenchmarkId::from_parameter(format!("{envs}_envs_{cores}")), |b| {
                    b.iter(|| rig.step())
                });
            }
            group.finish();
        }
    }
}

/// Observations by name, at the size that agents train at.
fn bench_observations(c: &mut Criterion) {
    let mut group = c.benchmark_group("observation");
    for choice in CHOICES {
        let more = format!(", \"observation\": {:?}", choice.name);
        let mut rig = Rig::new(4096, 1, Level::best().name(), false, &more);
        for _ in 0..600 {
            rig.step();
        }
        group.throughput(Throughput::Elements(4096));
        group.bench_function(choice.name, |b| b.iter(|| rig.step()));
    }
    group.finish();
}

/// Rewards and ends of a user's own, beside the task's at the same size.
fn bench_expressions(c: &mut Criterion) {
    let mut group = c.benchmark_group("expression");
    let own = r#", "reward": "exp(-4*dist**2) - 0.01*rate2""#;
    // true where the walls have ended the flight before: as many resets as without it
    let both = format!("{own}, \"termination\": \"dist > 9 or tilt > 0.8\"");
    let watched = r#", "watch": ["dist", "rate2", "vel_mps"]"#;
    for (name, more) in [("built_in", ""), ("reward", own), ("reward_and_end", &both), ("watched", watched)] {
        let mut rig = Rig::new(4096, 1, Level::best().name(), false, more);
        for _ in 0..600 {
            rig.step();
        }
        group.throughput(Throughput::Elements(4096));
        group.bench_function(name, |b| b.iter(|| rig.step()));
    }
    group.finish();
}

/// Returns the processor's name, if the system reports it.
fn processor() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    name.map_or(std::env::consts::ARCH.into(), |(_, name)| name.into())
}

/// Returns the load of the machine.
fn load() -> String {
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    load.split(' ').next().filter(|l| !l.is_empty()).unwrap_or("unknown").into()
}

criterion_group! { name = steps; config = Criterion::default().sample_size(20).measurement_time(std::time::Duration::from_secs(2)); targets = bench, bench_expressions, bench_observations }
criterion_main!(steps);
