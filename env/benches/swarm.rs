//! Drone-steps per second of worlds that several drones share, with downwash and collisions, observations of
//! all neighbours, rewards, metrics and automatic resets, on one core; beside them the single drone with the
//! same effects. `cargo bench -p crazyflie-env --bench swarm`.

#[path = "../tests/simulator/fleet.rs"]
mod fleet;

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use fleet::Fleet;

const DOWNWASH: &str = r#""effects": {"downwash": 0.118}"#;
const FIVE: &str = r#""vertical": "pwm", "effects": {"camera_noise": {"xy_m": 0.004, "z_m": 0.008, "yaw_deg": 0.5}, "ground_effect": 1.0,
    "drag_linear": 0.3, "cmd_delay": 0.03, "battery_sag": {"exponent": 1.0, "resistance_ohm": 0.1}}"#;

fn bench(c: &mut Criterion) {
    let more = |drones: usize, effects: &str| {
        format!(
            "{{\"task\": \"formation\", \"drones\": {drones}, \"max_episode_steps\": 500, \"task_options\": {{\"roam_m\": 0.1}}, {effects}}}"
        )
    };
    for (name, effects) in [("downwash", DOWNWASH), ("downwash_and_five_effects", FIVE)] {
        let mut group = c.benchmark_group(format!("swarm/{name}"));
        for (drones, worlds) in [(1, 8192), (4, 1024), (8, 1024), (16, 512), (64, 64)] {
            let mut fleet = Fleet::new(worlds, &more(drones, effects));
            fleet.reset(0);
            let actions = fleet.level();
            for _ in 0..100 {
                fleet.step(&actions).expect("step");
            }
            group.throughput(Throughput::Elements((worlds * drones) as u64));
            group.bench_function(
                BenchmarkId::from_parameter(format!("{drones}_drones_{worlds}_worlds")),
                |b| {
                    b.iter(|| fleet.step(black_box(&actions)).expect("step"));
                },
            );
        }
        group.finish();
    }
}

criterion_group! { name = swarm; config = Criterion::default().sample_size(20).measurement_time(std::time::Duration::from_secs(2)); targets = bench }
criterion_main!(swarm);
