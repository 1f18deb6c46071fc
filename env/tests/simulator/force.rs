//! Forces from outside.

use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::vector::{STATE, StepBuffers, VectorEnv, state_index};
use serde_json::json;

const ENVS: usize = 21;
const STEPS: usize = 10;

/// True states after some steps of level flight, under forces that differ from drone to drone.
fn fly(task: &str, threads: usize, force_n: impl Fn(usize) -> [f32; 3]) -> (Vec<f32>, f64) {
    let options = json!({"task": task, "threads": threads, "vertical": "thrust", "effects": {"downwash": 0}});
    let options = Options::parse(&options.to_string()).unwrap();
    let mut env = VectorEnv::new(&[Model::thesis()], &options, ENVS).unwrap();
    let rows = ENVS * env.num_drones();
    let (mut rewards, mut terminated, mut truncated) =
        (vec![0.0; rows], vec![false; rows], vec![false; rows]);
    let (mut flying, mut metrics) = (vec![true; rows], vec![0.0; ENVS * env.num_metrics()]);
    let mut observations = vec![0.0; rows * env.width()];
    let seeds: Vec<u64> = (0..ENVS as u64).collect();
    env.reset(Some(&seeds), None, &mut observations).unwrap();
    let forces: Vec<f32> = (0..rows).flat_map(&force_n).collect();
    env.set_force(Some(&forces)).unwrap();
    let hover = env.interfaces()[0].hover_lift / env.interfaces()[0].lift_max * 2.0 - 1.0;
    let mut actions = vec![0.0; rows * ACTION];
    actions.chunks_mut(ACTION).for_each(|action| action[3] = hover as f32);
    for _ in 0..STEPS {
        let out = StepBuffers {
            observations: &mut observations,
            rewards: &mut rewards,
            terminated: &mut terminated,
            truncated: &mut truncated,
            flying: &mut flying,
            metrics: &mut metrics,
        };
        env.step(&actions, out).unwrap();
    }
    let mut states = vec![0.0; rows * STATE];
    env.states(&mut states).unwrap();
    (states, STEPS as f64 * env.tick_s())
}

#[test]
fn a_force_accelerates_by_the_declared_mass() {
    let mass_kg = Model::thesis().vehicle.mass.value;
    let force_n = |row: usize| [0.01, -0.02 + 0.0005 * row as f32, 0.0];
    for task in ["hover", "swap"] {
        let ((pushed, time_s), (free, _)) = (fly(task, 2, force_n), fly(task, 1, |_| [0.0; 3]));
        for (row, (pushed, free)) in pushed.chunks(STATE).zip(free.chunks(STATE)).enumerate() {
            for (axis, force_n) in force_n(row).into_iter().enumerate() {
                // the thesis's model has no drag: dv = F t / m and dx = F t^2 / (2 m)
                let want_mps = f64::from(force_n) * time_s / mass_kg;
                let got = |place: usize| f64::from(pushed[place + axis]) - f64::from(free[place + axis]);
                let (got_mps, got_m) = (got(state_index::VEL), got(state_index::POS));
                assert!((got_mps - want_mps).abs() < 2e-6, "{task} {row} {axis}: {got_mps}, not {want_mps}");
                let want_m = 0.5 * want_mps * time_s;
                assert!((got_m - want_m).abs() < 2e-6, "{task} {row} {axis}: {got_m}, not {want_m}");
            }
        }
    }
}
