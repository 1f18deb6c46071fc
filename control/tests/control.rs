//! Controllers in the simulator: all reach the marker, the filter is better than the last fix, and deviations from
//! the model are trimmed away.

use crazyflie_control::{
    Controller, ControllerContext, ControllerSpec, Estimator, Mode, SensorNoise, registry,
};
use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::model::Model;
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::vector::{STATE, StepBuffers, VectorEnv};

/// The lab's camera: 30 frames a second, 50 ms old, with the noise of a good ArUco pose.
const CAMERA: &str =
    r#""camera": 1, "camera_latency": 0.05, "camera_noise": {"xy_m": 0.005, "z_m": 0.01, "yaw_deg": 1}"#;
const ENVS: usize = 16;

/// A batch with all that a step returns.
struct Flight {
    env: VectorEnv,
    observations: Vec<f32>,
    states: Vec<f32>,
    pilot: Box<dyn Controller>,
}

impl Flight {
    fn new(controller: &str, vertical: &str, task: &str, effects: &str) -> Flight {
        let options =
            Options::parse(&format!(r#"{{"vertical": "{vertical}", {task}, "effects": {{{effects}}}}}"#))
                .unwrap();
        let model = Model::thesis();
        let mut env = VectorEnv::new(std::slice::from_ref(&model), &options, ENVS).unwrap();
        let site = ControllerContext {
            model: &model,
            interface: env.interfaces()[0],
            tick_s: env.tick_s(),
            envs: ENVS,
            mode: Mode::Automatic,
        };
        let pilot = ControllerSpec::named(controller).unwrap().build(&site).unwrap();
        let mut observations = vec![0.0; ENVS * OBSERVATION];
        let seeds: Vec<u64> = (100..100 + ENVS as u64).collect();
        env.reset(Some(&seeds), None, &mut observations).unwrap();
        let mut states = vec![0.0; ENVS * STATE];
        env.states(&mut states).unwrap();
        Flight { env, observations, states, pilot }
    }

    fn step(&mut self) {
        let (mut actions, mut rewards) = ([0.0; ENVS * ACTION], [0.0; ENVS]);
        let (mut terminated, mut truncated) = ([false; ENVS], [false; ENVS]);
        self.pilot.act(&self.observations, &mut actions).unwrap();
        let out = StepBuffers::new(&mut self.observations, &mut rewards, &mut terminated, &mut truncated);
        self.env.step(&actions, out).unwrap();
        assert!(!terminated.contains(&true), "a flight ended");
        self.env.states(&mut self.states).unwrap();
    }

    /// Root mean square distance to the set-point over all flights and the ticks from `from` on.
    fn error_m(mut self, from: usize, ticks: usize) -> f64 {
        let mut squares = 0.0;
        for tick in 0..ticks {
            self.step();
            if tick >= from {
                let rows = self.states.chunks(STATE).zip(self.observations.chunks(OBSERVATION));
                squares += rows
                    .map(|(x, o)| (0..3).map(|i| f64::from(x[i] - o[16 + i]).powi(2)).sum::<f64>())
                    .sum::<f64>();
            }
        }
        (squares / (ENVS * (ticks - from)) as f64).sqrt()
    }
}

const HOVER: &str = r#""task": "hover", "task_options": {"start_radius_m": 0.5, "start_yaw_deg": 30}"#;

#[test]
fn every_controller_comes_to_the_marker_with_every_vertical_form() {
    let flies = |name: &str| !["hover", "random", "stock-pid"].contains(&name);
    for entry in registry().iter().filter(|e| e.file.is_none() && flies(e.name)) {
        for vertical in ["height", "pwm", "thrust", "motors"] {
            let error = Flight::new(entry.name, vertical, HOVER, CAMERA).error_m(400, 600);
            println!("{} by {vertical}: {:.1} cm after 8 s", entry.name, 100.0 * error);
            // table 7.1 swings with this dead time: its 9 degrees of margin are all it has
            assert!(
                error < if entry.name.ends_with("pid") { 0.4 } else { 0.05 },
                "{} by {vertical}: {error}",
                entry.name
            );
        }
    }
}

/// Errors of the newest fix and of the estimate over flights of the thesis's PID from the second second on:
/// root mean square, and the largest.
fn localisation(effects: &str, task: &str) -> [[f64; 2]; 2] {
    let mut flight = Flight::new("thesis-pid", "pwm", task, effects);
    let model = Model::thesis();
    let estimator = Estimator::<f64>::new(
        &model,
        flight.env.interfaces()[0].input,
        flight.env.tick_s(),
        &SensorNoise::default(),
    );
    let mut all = vec![estimator; ENVS];
    let (mut squares, mut most, from, ticks) = ([0.0; 2], [0.0_f64; 2], 50, 600);
    for tick in 0..ticks {
        for (i, (estimator, o)) in all.iter_mut().zip(flight.observations.chunks(OBSERVATION)).enumerate() {
            let o: [f64; OBSERVATION] = std::array::from_fn(|k| f64::from(o[k]));
            let pos_m = estimator.update(&o).pos_m;
            let x = &flight.states[i * STATE..];
            let off = |p: &[f64]| (0..3).map(|k| (p[k] - f64::from(x[k])).powi(2)).sum::<f64>();
            for (k, off) in [off(&o[..3]), off(&pos_m)].into_iter().enumerate().filter(|_| tick >= from) {
                squares[k] += off;
                most[k] = most[k].max(off.sqrt());
            }
        }
        flight.step();
    }
    [squares.map(|s| (s / (ENVS * (ticks - from)) as f64).sqrt()), most]
}

#[test]
fn the_filter_knows_better_than_the_last_fix() {
    let outliers = format!(r#"{CAMERA}, "camera_outliers": {{"probability": 0.03}}"#);
    let tilted = format!(r#"{CAMERA}, "imu_tilt": {{"roll_deg": 1, "pitch_deg": -1}}"#);
    let drifting = format!(
        r#"{CAMERA}, "gyro_bias": {{"bias_degps": 1, "rate_noise_degps": 0.1, "angle_noise_deg": 0.2}}"#
    );
    let cases = [
        ("ArUco noise", CAMERA, 2.0),
        ("outliers", &outliers, 2.5),
        ("a tilted IMU", &tilted, 2.0),
        ("a drifting gyro", &drifting, 2.0),
    ];
    for (what, effects, better) in cases {
        let [[fix, estimate], [worst_fix, worst]] = localisation(effects, HOVER);
        println!(
            "{what}: fix {:.2} cm, estimate {:.2} cm; at worst {:.1} and {:.1} cm",
            100.0 * fix,
            100.0 * estimate,
            100.0 * worst_fix,
            100.0 * worst
        );
        assert!(better * estimate < fix && worst < worst_fix, "{what}: {fix} {estimate} {worst_fix} {worst}");
    }
}

/// Without noise all that is wrong with a fix is its age: none of that is left.
#[test]
fn a_late_fix_is_held_against_where_the_vehicle_was() {
    let late = r#""camera": 1, "camera_latency": 0.1"#;
    let [[fix, estimate], [_, worst]] =
        localisation(late, r#""task": "track", "task_options": {"period_s": 4}"#);
    println!(
        "100 ms late: fix {:.2} cm, estimate {:.3} cm, at worst {:.3} cm",
        100.0 * fix,
        100.0 * estimate,
        100.0 * worst
    );
    assert!(fix > 0.03 && estimate < 0.004 && worst < 0.02, "{fix} {estimate} {worst}");
}

#[test]
fn the_filter_steadies_the_thesis_pid() {
    let error = |name| Flight::new(name, "pwm", HOVER, CAMERA).error_m(250, 750);
    let (alone, filtered) = (error("thesis-pid"), error("kalman+thesis-pid"));
    println!(
        "thesis PID from 5 s on: {:.1} cm by the last fix, {:.1} cm by the filter",
        100.0 * alone,
        100.0 * filtered
    );
    assert!(2.0 * filtered < alone, "{alone} {filtered}");
}

/// A constant torque, a tilted command frame, a wind, more mass: the model-based controllers learn what it
/// takes.
#[test]
fn what_the_model_lacks_is_trimmed_away() {
    for (what, effect) in [
        ("a torque", r#""com_offset": {"roll_deg": 2, "pitch_deg": -2}"#),
        ("wind", r#""wind": {"x_mps2": 0.5, "y_mps2": -0.3}"#),
        ("mass", r#""mass_change": 0.003"#),
        ("weak thrust", r#""thrust_scale": 0.93"#),
    ] {
        for name in ["lqr", "mpc", "velocity"] {
            let error = Flight::new(name, "thrust", HOVER, &format!("{CAMERA}, {effect}")).error_m(500, 750);
            println!("{name} with {what}: {:.1} cm after 10 s", 100.0 * error);
            assert!(error < 0.06, "{name} with {what}: {error}");
        }
    }
}
