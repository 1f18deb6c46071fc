//! Rewards and ends of a user's own, in every task, and what is kept for callers.

use crate::flight::Flight;
use crazyflie_env::config::Options;
use crazyflie_env::expression::expression_fields;
use crazyflie_env::isa::Level;
use crazyflie_env::task;
use crazyflie_env::vector::STATE;

const EFFECTS: &str = r#""effects": {"camera_noise": {"xy_m": 0.004}, "gust": {"sigma_mps2": 0.3}}"#;

/// The reward of the hover, as its documentation writes it.
const HOVER: &str =
    "(0.8 + 0.2 / (1 + yaw_error_rad**2)) / (1 + (dist / 0.3)**2) - 0.05 * norm(action_change)**2 / 4";

#[test]
fn the_hover_s_own_reward_can_be_written() {
    let mut built_in = Flight::new(40, EFFECTS);
    let mut own = Flight::new(40, &format!("{EFFECTS}, \"reward\": \"{HOVER}\""));
    for _ in 0..200 {
        built_in.step();
        own.step();
        assert_eq!(built_in.bits(40), own.bits(40), "a reward changes no flight");
        assert_eq!(built_in.terminated, own.terminated);
        for (a, b) in built_in.rewards.iter().zip(&own.rewards) {
            assert!((a - b).abs() < 2e-6, "{a} and {b}");
        }
    }
}

#[test]
fn the_task_s_reward_is_a_field_in_every_task() {
    for entry in task::registry() {
        let options = format!("\"task\": \"{}\", {EFFECTS}", entry.name);
        let mut built_in = Flight::new(20, &options);
        let mut own = Flight::new(20, &format!("{options}, \"reward\": \"task_reward\""));
        let mut half = Flight::new(20, &format!("{options}, \"reward\": \"0.5 * task_reward\""));
        for step in 0..150 {
            for flight in [&mut built_in, &mut own, &mut half] {
                flight.step();
            }
            for (i, reward) in built_in.rewards.iter().enumerate() {
                assert_eq!(reward.to_bits(), own.rewards[i].to_bits(), "{} step {step} row {i}", entry.name);
                assert_eq!(0.5 * reward, half.rewards[i], "{} step {step} row {i}", entry.name);
            }
        }
    }
}

#[test]
fn an_end_of_one_s_own_ends_flights() {
    for name in ["hover", "takeoff", "swap"] {
        let options =
            format!("\"task\": \"{name}\", \"autoreset\": \"disabled\", \"termination\": \"time_s > 0.15\"");
        let mut flight = Flight::new(20, &options);
        for step in 1..=8 {
            assert!(
                flight.terminated.iter().all(|ended| !ended),
                "{name}: nothing has ended before step {step}"
            );
            flight.step();
        }
        assert!(flight.terminated.iter().all(|ended| *ended), "{name}: 0.16 s have gone by");
    }
}

#[test]
fn values_are_the_same_for_every_batch_thread_and_instruction_set() {
    let own = r#"exp(-4*dist**2) - 0.01*rate2 + tanh(speed*0.3) * sin(vel_mps[0]*2)", "termination": "tilt > 0.4 or log(dist*3) > 1""#;
    for (task, others) in
        [("hover", ""), ("swap", "0.1*nearest_m + 0.2*min_separation_m - 0.3*norm(others_mean_m) + ")]
    {
        let text = |more: &str| format!("\"task\": \"{task}\", {EFFECTS}, \"reward\": \"{others}{own}{more}");
        let mut large = Flight::new(70, &text(r#", "isa": "baseline""#));
        let mut small = Flight::new(3, &text(""));
        let mut others: Vec<Flight> = Level::available()
            .into_iter()
            .map(|level| Flight::new(70, &text(&format!(", \"threads\": 2, \"isa\": \"{}\"", level.name()))))
            .collect();
        for _ in 0..120 {
            large.step();
            small.step();
            let bits = |flight: &Flight, rows| -> Vec<u32> {
                flight.rewards[..rows].iter().map(|reward| reward.to_bits()).collect()
            };
            let rows = small.rewards.len();
            assert_eq!(bits(&large, rows), bits(&small, rows));
            assert_eq!(large.terminated[..rows], small.terminated);
            for other in &mut others {
                other.step();
                assert_eq!(bits(&large, large.rewards.len()), bits(other, large.rewards.len()));
                assert_eq!(large.terminated, other.terminated);
            }
        }
    }
}

#[test]
fn watched_numbers_are_of_the_end_of_a_step_before_any_reset() {
    for (task, autoreset) in [("hover", "same_step"), ("swap", "next_step")] {
        let options = format!(
            "\"task\": \"{task}\", {EFFECTS}, \"autoreset\": \"{autoreset}\", \"max_episode_steps\": 30, \"watch\": [\"pos_m\", \"dist\", \"time_s\", \"task_reward\"]"
        );
        let mut flight = Flight::new(20, &options);
        let width = flight.env.watched_width();
        assert_eq!(width, 6);
        let drones = flight.env.num_drones();
        let (mut rows, mut states) = (vec![0.0; 20 * drones * width], vec![0.0; 20 * drones * STATE]);
        for step in 1..=30 {
            flight.step();
            flight.env.watched(&mut rows).unwrap();
            flight.env.states(&mut states).unwrap();
            for (row, numbers) in rows.chunks(width).enumerate() {
                let env = row / drones;
                let last = flight.env.last_of_episode(env).filter(|_| flight.truncated[row]);
                let state = last.map_or(&states[row * STATE..], |(_, state)| state);
                if flight.terminated[row]
                    || (flight.flying.get(row) == Some(&false) && !flight.truncated[row])
                {
                    continue;
                }
                assert_eq!(numbers[..3], state[..3], "{task} step {step} row {row}");
                assert!((numbers[4] - 0.02 * step as f32).abs() < 1e-4);
                assert_eq!(numbers[5], flight.rewards[row]);
            }
        }
    }
}

#[test]
fn what_is_no_number_is_an_error_that_names_the_place() {
    let mut flight = Flight::new(40, r#""reward": "log(0.05 - 1*time_s)", "threads": 2"#);
    flight.try_step().unwrap();
    flight.try_step().unwrap();
    let error = flight.try_step().unwrap_err().to_string();
    for words in ["reward \"log(0.05 - 1*time_s)\" is NaN", "environment 0", "step 3 of its episode"] {
        assert!(error.contains(words), "{error}");
    }
    let mut flight =
        Flight::new(40, r#""task": "swap", "termination": "sqrt(0.03 - 1*time_s) > 0.9", "threads": 2"#);
    flight.try_step().unwrap();
    let error = flight.try_step().unwrap_err().to_string();
    assert!(error.contains("termination") && error.contains("drone 0, at step 2"), "{error}");
}

#[test]
fn mistakes_are_found_where_options_are_read() {
    for (options, words) in [
        (r#"{"reward": "exp(-dst)"}"#, "did you mean \"dist\""),
        (r#"{"termination": "dist"}"#, "expected a condition"),
        (r#"{"watch": ["dst"]}"#, "did you mean \"dist\""),
        (r#"{"reward": 3}"#, "string"),
    ] {
        let error = Options::parse(options).unwrap_err().to_string();
        assert!(error.contains(words), "{options} gave: {error}");
    }
    for field in expression_fields() {
        Options::parse(&format!("{{\"watch\": [\"{}\"]}}", field.name)).unwrap();
        Options::parse(&format!("{{\"reward\": \"norm({})\"}}", field.name)).map(drop).unwrap_or_else(|e| {
            assert!(e.to_string().contains("several units"), "{}: {e}", field.name);
        });
    }
    let plain = serde_json::to_string(&Options::default()).unwrap();
    for key in ["reward", "termination", "cost", "watch"] {
        assert!(!plain.contains(key), "what was not asked for changes no hash");
    }
}

/// Numbers that are kept of the last step.
fn watched(flight: &mut Flight) -> Vec<f32> {
    let mut rows = vec![0.0; flight.rewards.len() * flight.env.watched_width()];
    flight.env.watched(&mut rows).unwrap();
    rows
}

#[test]
fn a_cost_of_one_s_own_is_kept_and_changes_no_flight() {
    for name in ["hover", "swap"] {
        let task = format!("\"task\": \"{name}\", {EFFECTS}");
        let mut plain = Flight::new(20, &task);
        let mut costly =
            Flight::new(20, &format!("{task}, \"watch\": [\"dist\"], \"cost\": \"2 * dist + 1\""));
        for step in 0..60 {
            plain.step();
            costly.step();
            assert_eq!(plain.bits(20), costly.bits(20), "{name} step {step}");
            // the cost of a drone that no longer flies is 0
            for row in watched(&mut costly).chunks_exact(2).filter(|row| row[1] != 0.0) {
                assert!((row[1] - (2.0 * row[0] + 1.0)).abs() < 1e-6, "{name} step {step}: {row:?}");
            }
            assert!(watched(&mut costly)[1] >= 1.0, "{name} step {step}");
        }
    }
    // a step that only resets costs nothing
    let mut flight = Flight::new(20, "\"termination\": \"time_s > 0.05\", \"cost\": \"1\"");
    let costs: Vec<f32> = (0..8)
        .map(|_| {
            flight.step();
            watched(&mut flight)[7]
        })
        .collect();
    assert_eq!(costs, [1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0]);
    for (cost, words) in [("dits", "did you mean \"dist\""), ("dist > 1", "cost")] {
        let error = Options::parse(&format!("{{\"cost\": \"{cost}\"}}")).unwrap_err().to_string();
        assert!(error.contains(words), "{cost} gave: {error}");
    }
}
