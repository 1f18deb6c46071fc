//! Choices of an observation: the true state, a filter's estimate, fields by name, the last few ticks.

use crate::flight::Flight;
use crazyflie_env::config::Options;
use crazyflie_env::estimator::{Estimator, SensorNoise};
use crazyflie_env::isa::Level;
use crazyflie_env::lanes::Lanes;
use crazyflie_env::model::Model;
use crazyflie_env::observation::{ALL_FIELDS, OBSERVATION, find_field, index};
use crazyflie_env::scalar::Scalar;
use crazyflie_env::vector::{STATE, VectorEnv, state_index};

/// Noise, late and lost frames, and a room full of disturbances.
const EFFECTS: &str = r#""effects": {"camera_noise": {"xy_m": 0.004, "z_m": 0.008, "yaw_deg": 0.5}, "camera_latency": 0.05,
    "camera_fov": {"diagonal_deg": 120}, "drag_linear": {"uniform": [0, 0.5]}, "gust": {"sigma_mps2": 0.3}, "packet_loss": 0.05,
    "gyro_bias": {"bias_degps": 1, "rate_noise_degps": 0.5}}"#;

/// Returns all that a task has: gates and obstacles exist only in a race.
fn all_names(task: &str) -> String {
    let gates = find_field("gate_pos_m").unwrap().first;
    let fields = ALL_FIELDS.iter().filter(|field| task == "race" || field.first < gates);
    let names: Vec<String> = fields.map(|field| format!("{:?}", field.name)).collect();
    format!("\"observation\": [{}]", names.join(", "))
}

#[test]
fn the_same_bits_for_any_batch_threads_and_instruction_set() {
    for task in ["hover", "race", "swap"] {
        for mode in ["next_step", "same_step"] {
            let options = |threads: usize, isa: &str| {
                format!(
                    r#"{EFFECTS}, "task": {task:?}, "max_episode_steps": 30, "autoreset": {mode:?}, "threads": {threads}, "isa": {isa:?}, "history": 3, {}"#,
                    all_names(task)
                )
            };
            let flown = |envs: usize, threads: usize, isa: &str| -> Vec<Vec<u32>> {
                let mut flight = Flight::new(envs, &options(threads, isa));
                (0..80)
                    .map(|_| {
                        flight.step();
                        flight.bits(3)
                    })
                    .collect()
            };
            let reference = flown(3, 1, "baseline");
            for level in Level::available() {
                for (envs, threads) in [(3, 1), (16, 1), (37, 3)] {
                    assert!(
                        flown(envs, threads, level.name()) == reference,
                        "{task}, {mode}: {envs} environments, {threads} threads, {} differ",
                        level.name()
                    );
                }
            }
        }
    }
}

#[test]
fn what_is_measured_does_not_depend_on_what_is_asked_for() {
    for task in ["hover", "swap"] {
        let options = format!(r#"{EFFECTS}, "task": {task:?}, "max_episode_steps": 20"#);
        let mut plain = Flight::new(18, &options);
        let mut other = Flight::new(18, &format!(r#"{options}, "observation": "state", "threads": 2"#));
        for _ in 0..50 {
            let (seen, kept) = (&plain.observations, other.env.measured(&other.observations));
            assert!(seen.iter().map(|v| v.to_bits()).eq(kept.iter().map(|v| v.to_bits())), "{task}");
            assert_eq!(plain.rewards, other.rewards);
            plain.step();
            other.step();
        }
    }
}

#[test]
fn the_state_is_the_true_one_and_the_error_points_to_the_set_point() {
    for task in ["hover", "track", "swap"] {
        let mut flight = Flight::new(5, &format!(r#"{EFFECTS}, "task": {task:?}, "observation": "state""#));
        let drones = flight.env.num_drones();
        for _ in 0..40 {
            flight.step();
            let mut states = vec![0.0; 5 * drones * STATE];
            flight.env.states(&mut states).unwrap();
            for (i, state) in states.chunks(STATE).enumerate() {
                let row = flight.row(i);
                if !flight.flying.is_empty() && !flight.flying[i] {
                    continue;
                }
                assert_eq!(row[..state_index::YAW], state[..state_index::YAW], "{task}");
                assert_eq!(row[state_index::RATE..STATE], state[state_index::RATE..]);
                let setpoint = &row[16..20];
                for axis in 0..3 {
                    assert_eq!(row[STATE + axis], setpoint[axis] - state[axis]);
                }
                let turn = f64::from(setpoint[3] - state[state_index::YAW] - row[STATE + 3]);
                assert!((turn / std::f64::consts::TAU - (turn / std::f64::consts::TAU).round()).abs() < 1e-6);
            }
        }
    }
}

/// The filter is the one that controllers use, row by row on what was measured.
#[test]
fn the_estimate_is_the_filters_on_what_was_measured() {
    let model = Model::thesis();
    let mut flight = Flight::new(
        20,
        &format!(
            r#"{EFFECTS}, "observation": ["est_pos_m", "est_vel_mps", "est_yaw_rad", "est_push_mps2", "est_error_m", "setpoint"]"#
        ),
    );
    let input = flight.env.interfaces()[0].input;
    let new = || Estimator::<Lanes>::new(&model, input, flight.env.tick_s(), &SensorNoise::default());
    let mut filters: Vec<_> = (0..20).map(|_| new()).collect();
    for step in 0..200 {
        let over = flight.terminated.clone();
        if step > 0 {
            flight.step();
        }
        for (filter, over) in filters.iter_mut().zip(over) {
            if over {
                filter.reset(Lanes::zero().le(Lanes::zero()));
            }
        }
        let measured = flight.env.measured(&flight.observations);
        for (i, filter) in filters.iter_mut().enumerate() {
            let rows = &measured[i * OBSERVATION..(i + 1) * OBSERVATION];
            let lanes: [Lanes; OBSERVATION] = std::array::from_fn(|k| Lanes::from_f64(f64::from(rows[k])));
            let estimate = filter.update(&lanes);
            let row = flight.row(i);
            for axis in 0..3 {
                assert_eq!(row[axis], estimate.pos_m[axis].array()[0]);
                assert_eq!(row[3 + axis], estimate.vel_mps[axis].array()[0]);
                assert_eq!(row[7 + axis], estimate.push_mps2[axis].array()[0]);
                assert_eq!(row[10 + axis], rows[index::SETPOINT_X + axis] - row[axis]);
            }
            assert_eq!(row[6], estimate.yaw_rad.array()[0]);
        }
    }
}

#[test]
fn history_holds_the_last_ticks_and_begins_full() {
    for task in ["hover", "swap"] {
        for mode in ["next_step", "same_step"] {
            let options = format!(
                r#"{EFFECTS}, "task": {task:?}, "max_episode_steps": 12, "autoreset": {mode:?}, "observation": ["pos_m", "est_vel_mps", "gyro_radps"]"#
            );
            let mut now = Flight::new(18, &options);
            let mut long = Flight::new(18, &format!(r#"{options}, "history": 4, "threads": 2"#));
            let (width, rows) = (now.env.width(), now.rewards.len());
            assert_eq!(long.env.width(), 4 * width);
            let mut past: Vec<Vec<f32>> = (0..rows).map(|i| now.row(i).repeat(4)).collect();
            for step in 0..60 {
                for (i, past) in past.iter().enumerate() {
                    assert_eq!(long.row(i), past, "{task}, {mode}, row {i}, step {step}");
                }
                let drones = now.env.num_drones();
                let begun = |flight: &Flight, env: usize, before: &[bool]| match mode {
                    "same_step" => {
                        let of = env * drones..(env + 1) * drones;
                        flight.env.last_of_episode(env).is_some()
                            && (flight.terminated[of.clone()].contains(&true)
                                || flight.truncated[of.clone()].contains(&true))
                            && (flight.flying.is_empty() || flight.flying[of].iter().all(|flies| *flies))
                    }
                    _ => before[env],
                };
                let over = |flight: &Flight| -> Vec<bool> {
                    (0..18)
                        .map(|env| {
                            let of = env * drones..(env + 1) * drones;
                            if flight.flying.is_empty() {
                                flight.terminated[env] || flight.truncated[env]
                            } else {
                                !flight.flying[of].contains(&true)
                            }
                        })
                        .collect()
                };
                let before = over(&now);
                now.step();
                long.step();
                for (i, past) in past.iter_mut().enumerate() {
                    if begun(&now, i / drones, &before) {
                        *past = now.row(i).repeat(4);
                    } else if now.row(i).iter().all(|number| *number == 0.0) {
                        // it no longer flies
                        past.fill(0.0);
                    } else {
                        past.drain(..width);
                        past.extend_from_slice(now.row(i));
                    }
                }
            }
        }
    }
}

#[test]
fn the_last_observation_of_an_episode_is_of_the_kind_that_was_asked_for() {
    let options = r#""max_episode_steps": 5, "autoreset": "same_step", "observation": "state", "history": 2"#;
    let mut flight = Flight::new(17, options);
    for _ in 0..5 {
        flight.step();
    }
    assert!(flight.truncated.iter().all(|over| *over));
    for env in 0..17 {
        let (observation, state) = flight.env.last_of_episode(env).unwrap();
        let width = flight.env.width() / 2;
        assert_eq!(observation.len(), 2 * width);
        assert_eq!(observation[width..width + 6], state[..6]);
        assert_ne!(observation[..3], observation[width..width + 3], "it moved");
        assert_eq!(flight.row(env)[..width], flight.row(env)[width..], "the next one has just begun");
    }
}

#[test]
fn a_batch_goes_on_from_a_snapshot_with_filter_and_history() {
    for task in ["hover", "swap"] {
        let options = format!(
            r#"{EFFECTS}, "task": {task:?}, "max_episode_steps": 25, "history": 3, {}"#,
            all_names(task)
        );
        let mut first = Flight::new(18, &options);
        for _ in 0..17 {
            first.step();
        }
        let mut second = Flight::new(18, &format!(r#"{options}, "isa": "baseline", "threads": 2"#));
        second.env.restore(&first.env.snapshot()).unwrap();
        second.step = first.step;
        for _ in 0..40 {
            first.step();
            second.step();
            assert!(first.bits(18) == second.bits(18), "{task}");
        }
        let bad = Flight::new(18, &format!(r#""task": {task:?}"#)).env.snapshot();
        assert!(first.env.restore(&bad).unwrap_err().to_string().contains("other models, options or size"));
    }
}

#[test]
fn numbers_stay_within_the_bounds_of_their_fields() {
    let race = r#""task": "race", "task_options": {"level": 4}"#;
    let mut flight = Flight::new(33, &format!("{EFFECTS}, {race}, {}", all_names("race")));
    for _ in 0..300 {
        flight.step();
        for row in flight.observations.chunks(flight.env.width()) {
            for field in ALL_FIELDS {
                let within = f64::from(field.low as f32)..=f64::from(field.high as f32);
                for number in &row[field.range()] {
                    assert!(within.contains(&f64::from(*number)), "{} is {number}", field.name);
                }
            }
        }
    }
}

#[test]
fn mistakes_are_named() {
    let error = |options: &str| {
        let options = Options::parse(&format!("{{{options}}}"));
        let made = options.and_then(|options| VectorEnv::new(&[Model::thesis()], &options, 2));
        made.map(|_| ()).unwrap_err().to_string()
    };
    for (options, words) in [
        (r#""observation": "flat""#, "known: measured, estimate, state"),
        (r#""observation": ["pos"]"#, "did you mean \"pos_m\""),
        (
            r#""observation": ["pos_m", "gate_pos_m"]"#,
            "the task hover has no gates and no obstacles, hence no field \"gate_pos_m\"",
        ),
        (r#""history": 0"#, "history is 0, expected 1 to 64"),
        (r#""history": 65"#, "history is 65, expected 1 to 64"),
    ] {
        assert!(error(options).contains(words), "{options} gave: {}", error(options));
    }
    assert_eq!(find_field("vel_mps").unwrap().unit, "m/s");
}
