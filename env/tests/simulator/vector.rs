//! The batch of environments: the same bits for any batch size, number of threads and instruction set;
//! resets; mistakes.

use crazyflie_control::pid::{Gains, Pid};
use crazyflie_control::{self as control, Controller, Mode};
use crazyflie_env::Error;
use crazyflie_env::action::ACTION;
use crazyflie_env::config::{Autoreset, Options};
use crazyflie_env::isa::Level;
use crazyflie_env::model::Model;
use crazyflie_env::observation::{FIELDS, OBSERVATION};
use crazyflie_env::vector::{STATE, StepBuffers, VectorEnv};
use proptest::prelude::*;

const EVERYTHING: &str = r#"{"camera_noise": {"xy_m": 0.004, "z_m": 0.008, "yaw_deg": 0.5}, "camera_fov": {"diagonal_deg": 120}, "camera_latency": 0.05,
    "camera_drift": {"sigma_m": 0.01}, "camera_outliers": {"probability": 0.02}, "camera_flip": 0.01, "ground_effect": {"coefficient": {"uniform": [1, 8]}},
    "drag_linear": {"uniform": [0, 0.5]}, "drag_quadratic": 0.2, "cmd_delay": {"uniform": [0, 0.06]}, "motor_lag": 0.03, "gust": {"sigma_mps2": 0.3},
    "battery_sag": {"exponent": 1.5, "resistance_ohm": 0.1}, "tilt_loss": {"amount": 1, "sideways": 1}, "exact_tan": 1, "packet_loss": 0.05, "gyro_bias": {"bias_degps": 1, "rate_noise_degps": 0.5},
    "weak_motor": {"motor": {"choice": [1, 2, 3, 4]}, "loss": 0.02}, "euler_kinematics": 1}"#;

fn options(text: &str) -> Options {
    Options::parse(text).unwrap()
}

struct Batch {
    env: VectorEnv,
    observations: Vec<f32>,
    rewards: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
}

impl Batch {
    fn new(envs: usize, options: &Options) -> Self {
        let env = VectorEnv::new(&[Model::thesis()], options, envs).unwrap();
        Batch {
            env,
            observations: vec![0.0; envs * OBSERVATION],
            rewards: vec![0.0; envs],
            terminated: vec![false; envs],
            truncated: vec![false; envs],
        }
    }

    /// Environment `i` gets the seed `first + i`.
    fn reset(&mut self, first: u64) {
        let seeds: Vec<u64> = (0..self.rewards.len() as u64).map(|i| first + i).collect();
        self.env.reset(Some(&seeds), None, &mut self.observations).unwrap();
    }

    fn step(&mut self, actions: &[f32]) -> crazyflie_env::Result<()> {
        let out = StepBuffers::new(
            &mut self.observations,
            &mut self.rewards,
            &mut self.terminated,
            &mut self.truncated,
        );
        self.env.step(actions, out)
    }

    /// Returns the outputs of environment `i`, bit by bit.
    fn row(&self, i: usize) -> Vec<u32> {
        let mut row: Vec<u32> =
            self.observations[i * OBSERVATION..(i + 1) * OBSERVATION].iter().map(|v| v.to_bits()).collect();
        row.extend([self.rewards[i].to_bits(), u32::from(self.terminated[i]), u32::from(self.truncated[i])]);
        row
    }
}

/// Actions that depend on the environment's seed and the step, not on its place in the batch.
fn action(seed: u64, step: u64, axis: usize) -> f32 {
    let h = crazyflie_env::noise::scramble(seed.wrapping_mul(1000) + step * 4 + axis as u64);
    let a = (h >> 40) as f32 / 8_388_608.0 - 1.0;
    if axis == 3 { 0.31 + 0.3 * a } else { a }
}

/// The trajectory of the environment with seed `seed` in a batch of `envs` whose seeds begin at `first`.
fn trajectory(envs: usize, first: u64, seed: u64, options: &Options, steps: u64) -> Vec<Vec<u32>> {
    let mut batch = Batch::new(envs, options);
    batch.reset(first);
    let i = (seed - first) as usize;
    let mut rows = vec![batch.row(i)];
    for step in 0..steps {
        let actions: Vec<f32> =
            (0..envs * ACTION).map(|k| action(first + (k / ACTION) as u64, step, k % ACTION)).collect();
        batch.step(&actions).unwrap();
        rows.push(batch.row(i));
    }
    rows
}

#[test]
fn the_same_bits_for_any_batch_threads_and_instruction_set() {
    for mode in ["next_step", "same_step"] {
        let with = |threads: usize, isa: &str| {
            options(&format!(
                r#"{{"effects": {EVERYTHING}, "vertical": "pwm", "max_episode_steps": 70, "autoreset": "{mode}", "threads": {threads}, "isa": "{isa}"}}"#
            ))
        };
        let reference = trajectory(1, 40, 40, &with(1, "baseline"), 200);
        assert!(
            reference.iter().any(|r| r[OBSERVATION + 1] == 1 || r[OBSERVATION + 2] == 1),
            "episodes end within the test"
        );
        let plain = |threads: usize, isa: &str| {
            options(&format!(
                r#"{{"max_episode_steps": 70, "autoreset": "{mode}", "threads": {threads}, "isa": "{isa}"}}"#
            ))
        };
        let bare = trajectory(1, 40, 40, &plain(1, "baseline"), 200);
        for level in Level::available() {
            for (envs, first, threads) in [(1, 40, 1), (100, 0, 1), (100, 7, 3)] {
                let same = trajectory(envs, first, 40, &plain(threads, level.name()), 200) == bare;
                assert!(
                    same,
                    "{mode}, no effects: {envs} environments, {threads} threads, {} differ",
                    level.name()
                );
            }
            for (envs, first, threads) in
                [(1, 40, 1), (3, 38, 1), (16, 40, 1), (17, 24, 1), (100, 0, 1), (100, 0, 2), (100, 7, 3)]
            {
                let same = trajectory(envs, first, 40, &with(threads, level.name()), 200) == reference;
                assert!(same, "{mode}: {envs} environments, {threads} threads, {} differ", level.name());
            }
        }
    }
}

/// A change of this number is a change of the physics or of the noise: note it in the changelog.
#[test]
fn golden_hash() {
    for level in Level::available() {
        let isa = level.name();
        let o = options(&format!(
            r#"{{"effects": {EVERYTHING}, "vertical": "thrust", "max_episode_steps": 70, "isa": "{isa}"}}"#
        ));
        let hash = trajectory(20, 0, 11, &o, 300)
            .iter()
            .flatten()
            .fold(0xcbf2_9ce4_8422_2325_u64, |h, v| (h ^ u64::from(*v)).wrapping_mul(0x0100_0000_01b3));
        assert_eq!(format!("{hash:016x}"), GOLDEN, "{isa}");
    }
}
const GOLDEN: &str = "bb533e3e7477562f";

#[test]
fn a_seed_is_an_episode_and_the_next_one_differs() {
    let o = options(&format!(r#"{{"effects": {EVERYTHING}}}"#));
    let mut batch = Batch::new(5, &o);
    batch.reset(9);
    let first = batch.observations.clone();
    batch.env.reset(None, None, &mut batch.observations).unwrap();
    let second = batch.observations.clone();
    assert_ne!(first, second);
    batch.reset(9);
    assert_eq!(first, batch.observations);
    batch.env.reset(None, None, &mut batch.observations).unwrap();
    assert_eq!(second, batch.observations);
    // environments of neighbouring seeds start elsewhere
    assert_ne!(first[..OBSERVATION], first[OBSERVATION..2 * OBSERVATION]);
}

#[test]
fn observations_stay_within_their_bounds_and_measure_the_state() {
    let mut batch = Batch::new(64, &options(r#"{"vertical": "thrust"}"#));
    batch.reset(0);
    for step in 0..400 {
        let actions: Vec<f32> =
            (0..64 * ACTION).map(|k| action((k / ACTION) as u64, step, k % ACTION)).collect();
        batch.step(&actions).unwrap();
        let mut states = vec![0.0; 64 * STATE];
        batch.env.states(&mut states).unwrap();
        for (row, x) in batch.observations.chunks(OBSERVATION).zip(states.chunks(STATE)) {
            for f in FIELDS {
                for v in &row[f.first..f.first + f.length] {
                    assert!((f.low as f32..=f.high as f32).contains(v), "{} is {v}", f.name);
                }
            }
            assert_eq!(row[..3], x[..3], "without a camera the marker pose is the position");
            assert_eq!((row[4], row[5]), (0.0, 1.0));
            assert_eq!(row[9..12], x[9..12]);
        }
    }
}

/// Fly a task with the PID; rewards and the final true states.
fn fly_pid(
    task: &str,
    gains: Gains,
    mode: Mode,
    vertical: &str,
    effects: &str,
    steps: usize,
) -> (Vec<f32>, Vec<Vec<f32>>) {
    let n = 32;
    let mut batch = Batch::new(
        n,
        &options(&format!(r#"{{"task": "{task}", "vertical": "{vertical}", "effects": {effects}}}"#)),
    );
    batch.reset(1);
    let mut pid =
        control::Batch::new(n, Pid::new(gains, batch.env.interfaces()[0], batch.env.tick_s(), mode));
    let mut actions = vec![0.0; n * ACTION];
    let mut sum = vec![0.0; n];
    let mut states = vec![0.0; n * STATE];
    let mut flights = Vec::new();
    for _ in 0..steps {
        pid.act(&batch.observations, &mut actions).unwrap();
        batch.step(&actions).unwrap();
        assert!(task == "land" || batch.terminated.iter().all(|t| !t), "no flight ends early");
        sum.iter_mut().zip(&batch.rewards).for_each(|(s, r)| *s += r);
        batch.env.states(&mut states).unwrap();
        flights.push(states.clone());
    }
    (sum, flights)
}

#[test]
fn the_thesis_pid_settles_over_the_marker_with_every_loop_of_the_right_sign() {
    for vertical in ["height", "pwm", "thrust", "motors"] {
        let (rewards, flights) = fly_pid("hover", Gains::THESIS, Mode::Automatic, vertical, "{}", 1000);
        for x in flights.last().unwrap().chunks(STATE) {
            let off = (x[0] * x[0] + x[1] * x[1]).sqrt();
            assert!(
                off < 0.02 && (x[2] - 0.7).abs() < 0.02 && x[5].abs() < 0.02,
                "{vertical}: ends at {x:?}"
            );
        }
        assert!(rewards.iter().all(|r| *r > 700.0), "{vertical}: {rewards:?}");
    }
}

#[test]
fn yaw_errors_to_both_sides_are_turned_back() {
    for gains in [Gains::THESIS, Gains::CRAZYFLIE_ROS] {
        for yaw in [-40.0, 40.0] {
            let o = format!(
                r#"{{"task_options": {{"start_radius_m": 0.0, "setpoint_yaw_deg": {yaw}, "start_yaw_deg": 30.0}}, "vertical": "pwm"}}"#
            );
            let mut batch = Batch::new(4, &options(&o));
            batch.reset(3);
            let mut pid = control::Batch::new(
                4,
                Pid::new(gains, batch.env.interfaces()[0], batch.env.tick_s(), Mode::Automatic),
            );
            let mut actions = [0.0; 16];
            for _ in 0..500 {
                pid.act(&batch.observations, &mut actions).unwrap();
                batch.step(&actions).unwrap();
            }
            for row in batch.observations.chunks(OBSERVATION) {
                assert!(
                    (row[8].to_degrees() - yaw as f32).abs() < 3.0,
                    "yaw is {} instead of {yaw}",
                    row[8].to_degrees()
                );
            }
        }
    }
}

#[test]
fn takeoff_and_landing_states_fly() {
    let (_, flights) = fly_pid("takeoff", Gains::THESIS, Mode::Takeoff, "pwm", "{}", 900);
    let last = flights.last().unwrap();
    assert!(flights[50][2] == 0.0, "the motors ramp up before anything moves");
    assert!(last.chunks(STATE).all(|x| (x[2] - 0.7).abs() < 0.03), "{:?}", &last[..STATE]);
    let (rewards, flights) = fly_pid("land", Gains::THESIS, Mode::Landing, "thrust", "{}", 400);
    // on 5.4 the height creeps towards the 5 cm at which the motors are cut, and only noise takes it below
    assert!(flights.iter().any(|x| x[2] == 0.0), "it comes down");
    assert!(rewards.iter().all(|r| *r > -60.0));
}

#[test]
fn autoreset_modes_are_those_of_gymnasium() {
    let of = |mode: &str| options(&format!(r#"{{"max_episode_steps": 3, "autoreset": "{mode}"}}"#));
    let zeros = [0.0; 2 * ACTION];
    let mut next = Batch::new(2, &of("next_step"));
    next.reset(0);
    for _ in 0..3 {
        next.step(&zeros).unwrap();
    }
    assert_eq!((next.truncated[0], next.terminated[0]), (true, false));
    next.step(&zeros).unwrap();
    assert_eq!((next.truncated[0], next.rewards[0]), (false, 0.0), "the step after the end only resets");
    let reset_row = next.observations.clone();
    next.step(&zeros).unwrap();
    assert!(next.rewards[0] > 0.0);

    let mut same = Batch::new(2, &of("same_step"));
    same.reset(0);
    for _ in 0..3 {
        same.step(&zeros).unwrap();
    }
    assert!(same.truncated[0] && same.rewards[0] > 0.0);
    assert_eq!(same.observations, reset_row, "both modes begin the same second episode");
    let (last, state) = same.env.last_of_episode(0).unwrap();
    assert_ne!(last, &same.observations[..OBSERVATION]);
    assert_eq!(last[..3], state[..3]);

    let mut disabled = Batch::new(2, &of("disabled"));
    disabled.reset(0);
    for _ in 0..3 {
        disabled.step(&zeros).unwrap();
    }
    let before = disabled.observations.clone();
    assert_eq!(disabled.step(&zeros), Err(Error::Ended { env: 0 }));
    disabled.env.reset(None, Some(&[true, false]), &mut disabled.observations).unwrap();
    assert_eq!(disabled.observations[..OBSERVATION], reset_row[..OBSERVATION]);
    assert_eq!(disabled.observations[OBSERVATION..], before[OBSERVATION..], "what is not reset stays");
    assert_eq!(disabled.step(&zeros), Err(Error::Ended { env: 1 }));
    assert_eq!(of("disabled").autoreset, Autoreset::Disabled);
}

#[test]
fn bad_actions_and_buffers_are_named_and_nothing_moves() {
    let mut batch = Batch::new(40, &options("{}"));
    assert_eq!(batch.step(&[0.0; 160]), Err(Error::NotReset));
    batch.reset(0);
    let before = batch.observations.clone();
    for (value, at, env, axis) in
        [(f32::NAN, 5, 1, 1), (1.5, 159, 39, 3), (f32::INFINITY, 0, 0, 0), (-1.000_001, 64, 16, 0)]
    {
        let mut actions = [0.0; 160];
        actions[at] = value;
        match batch.step(&actions) {
            Err(Error::Action { env: e, axis: a, .. }) => assert_eq!((e, a), (env, axis)),
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(
        batch.step(&[0.0; 156]),
        Err(Error::Shape { what: "actions", want: "160 numbers".into(), got: "156".into() })
    );
    assert_eq!(before, batch.observations);
    let mut fresh = Batch::new(40, &options("{}"));
    fresh.reset(0);
    fresh.step(&[0.1; 160]).unwrap();
    batch.step(&[0.1; 160]).unwrap();
    assert_eq!(fresh.observations, batch.observations, "refused steps left no trace");
}

#[test]
fn wrong_options_are_named() {
    for (text, words) in [
        (r#"{"task": "hovr"}"#, "did you mean \"hover\""),
        (r#"{"isa": "avx1024"}"#, "baseline"),
        (r#"{"physics_hz": 70}"#, "one of 300, 150, 100, 50"),
        (r#"{"task_options": {"start_radius": 1}}"#, "start_radius"),
        (r#"{"task_options": {"start_radius_m": 9}}"#, "start_radius_m is 9"),
        (r#"{"task": "track", "task_options": {"shape": "circel"}}"#, "circel"),
    ] {
        let made = Options::parse(text).and_then(|options| VectorEnv::new(&[Model::thesis()], &options, 1));
        let error = made.err().expect(text).to_string();
        assert!(error.contains(words), "{text}: {error}");
    }
    assert!(VectorEnv::new(&[Model::thesis()], &options("{}"), 0).is_err());
}

proptest! {
    #[test]
    fn no_text_makes_the_parsers_panic(text in ".{0,200}") {
        let _ = Options::parse(&text);
        let _ = Model::parse(&text);
    }

    #[test]
    fn no_damage_to_a_model_makes_the_parser_panic(at in 0..5000_usize, with in "[ -~]{0,6}", length in 0..8_usize) {
        let text = crazyflie_env::model::THESIS_TOML;
        let at = (0..=at.min(text.len())).rev().find(|i| text.is_char_boundary(*i)).unwrap_or(0);
        let end = (at + length).min(text.len());
        if text.is_char_boundary(end) {
            let damaged = format!("{}{with}{}", &text[..at], &text[end..]);
            if let Ok(model) = Model::parse(&damaged) {
                let _ = VectorEnv::new(std::slice::from_ref(&model), &Options::default(), 1);
            }
        }
    }
}

#[test]
fn the_first_states_are_those_of_all() {
    let mut batch = Batch::new(70, &options(r#"{"threads": 3}"#));
    batch.reset(5);
    batch.step(&[0.3; 70 * ACTION]).unwrap();
    let mut all = vec![0.0; 70 * STATE];
    batch.env.states(&mut all).unwrap();
    for n in [0, 1, 5, 16, 33, 70] {
        let mut first = vec![f32::NAN; n * STATE];
        batch.env.first_states(&mut first).unwrap();
        assert_eq!(first, all[..n * STATE], "{n}");
    }
    for odd in [STATE - 1, STATE + 1, 71 * STATE] {
        assert!(matches!(batch.env.first_states(&mut vec![0.0; odd]), Err(Error::Shape { .. })), "{odd}");
    }
}

#[test]
fn a_hover_begins_with_the_speed_and_the_tilt_that_are_asked_for() {
    let options = r#"{"task_options": {"start_speed_mps": {"uniform": [0.5, 1.0]}, "start_tilt_deg": 10}, "vertical": "pwm"}"#;
    let mut env = VectorEnv::new(&[Model::thesis()], &Options::parse(options).unwrap(), 64).unwrap();
    let seeds: Vec<u64> = (0..64).collect();
    let mut rows = vec![0.0; 64 * OBSERVATION];
    env.reset(Some(&seeds), None, &mut rows).unwrap();
    let mut states = vec![0.0; 64 * STATE];
    env.states(&mut states).unwrap();
    let mut ways = [false; 4];
    for (row, x) in rows.chunks_exact(OBSERVATION).zip(states.chunks_exact(STATE)) {
        let (speed, tilt) = (x[3].hypot(x[4]), x[6].hypot(x[7]));
        assert!((0.5..=1.0).contains(&speed) && x[5] == 0.0, "{speed}");
        assert!((tilt.to_degrees() - 10.0).abs() < 1e-4, "{tilt}");
        assert_eq!(row[6..8], x[6..8], "the IMU shows the tilt");
        ways[usize::from(x[3] > 0.0) + 2 * usize::from(x[4] > 0.0)] = true;
    }
    assert_eq!(ways, [true; 4], "all directions occur");
}
