//! Action levels above the attitude.

use crate::flight::Flight;
use crazyflie_env::action::{ACTION, ActionLevel, Entry, registry};
use crazyflie_env::config::Options;
use crazyflie_env::isa::Level;
use crazyflie_env::model::Model;
use crazyflie_env::observation::index;
use crazyflie_env::task;
use crazyflie_env::vector::{STATE, state_index};

/// A step with actions to all sides.
pub(crate) fn wander(flight: &mut Flight) {
    let actions = flight.actions(|_, share| 0.6 * share);
    flight.step_with(&actions).unwrap();
}

/// Flies one drone's set-point for so long; returns its true state after each step.
pub(crate) fn hold(flight: &mut Flight, set_point: [f64; ACTION], seconds: f64) -> Vec<[f32; STATE]> {
    let action = flight.env.interfaces()[0].action_of(&set_point).map(|number| number as f32);
    let steps = (seconds / flight.env.tick_s()).round() as usize;
    (0..steps)
        .map(|_| {
            flight.step_with(&action).unwrap();
            let mut x = [0.0; STATE];
            flight.env.states(&mut x).unwrap();
            x
        })
        .collect()
}

/// A single drone that starts where it is to be, 70 cm over the marker, and flies on.
pub(crate) fn alone(level: &str, vertical: &str, more: &str) -> Flight {
    Flight::new(
        1,
        &format!(
            r#""action": {level:?}, "vertical": {vertical:?}, "autoreset": "disabled", "task_options": {{"start_radius_m": 0}} {more}"#
        ),
    )
}

const VERTICALS: [&str; 4] = ["height", "pwm", "thrust", "motors"];

#[test]
fn the_same_bits_for_any_batch_threads_and_instruction_set() {
    for entry in registry() {
        for (task, effects) in
            [("hover", ""), ("hover", r#", "effects": {"gust": 0.3, "cmd_delay": 0.04}"#), ("swap", "")]
        {
            let flown = |envs: usize, threads: usize, isa: &str| -> Vec<Vec<u32>> {
                let mut flight = Flight::new(
                    envs,
                    &format!(
                        r#""action": {:?}, "task": {task:?}, "max_episode_steps": 30, "threads": {threads}, "isa": {isa:?}{effects}"#,
                        entry.name
                    ),
                );
                (0..80)
                    .map(|_| {
                        wander(&mut flight);
                        flight.bits(3)
                    })
                    .collect()
            };
            let reference = flown(3, 1, "baseline");
            for level in Level::available() {
                for (envs, threads) in [(3, 1), (16, 1), (37, 3)] {
                    assert!(
                        flown(envs, threads, level.name()) == reference,
                        "{}, {task}{effects}: {envs} environments, {threads} threads, {} differ",
                        entry.name,
                        level.name()
                    );
                }
            }
        }
    }
}

#[test]
fn every_level_flies_every_task_and_no_number_is_lost() {
    for entry in registry() {
        for task in task::registry() {
            let mut flight =
                Flight::new(2, &format!(r#""action": {:?}, "task": {:?}"#, entry.name, task.name));
            for step in 0..100 {
                wander(&mut flight);
                let numbers = flight.observations.iter().chain(&flight.rewards);
                assert!(numbers.copied().all(f32::is_finite), "{} {} step {step}", entry.name, task.name);
            }
        }
    }
}

#[test]
fn a_velocity_is_reached_in_every_direction_and_form() {
    for vertical in VERTICALS {
        for (axis, speed_mps) in [(0, 0.5), (1, -0.4), (2, 0.3)] {
            let mut set_point = [0.0; ACTION];
            set_point[axis] = speed_mps;
            let seconds = if axis == 2 { 2.0 } else { 3.0 };
            let flown = hold(&mut alone("velocity", vertical, ""), set_point, seconds);
            let last = flown.last().unwrap();
            for i in 0..3 {
                let off = f64::from(last[state_index::VEL + i]) - set_point[i];
                assert!(off.abs() < 0.03, "{vertical}, axis {axis}: {i} is off by {off} m/s");
            }
        }
    }
}

#[test]
fn a_velocity_is_along_the_room_whatever_the_heading() {
    let mut flight = alone("velocity", "height", "");
    let turned = hold(&mut flight, [0.0, 0.0, 0.0, 1.0], 1.5);
    let yaw_rad = turned.last().unwrap()[state_index::YAW];
    assert!((yaw_rad - 1.5).abs() < 0.05, "right-handed, and as fast as asked: {yaw_rad}");
    let last = *hold(&mut flight, [0.4, 0.0, 0.0, 0.0], 3.0).last().unwrap();
    let [vx, vy] = [last[state_index::VEL], last[state_index::VEL + 1]];
    assert!((vx - 0.4).abs() < 0.02 && vy.abs() < 0.02, "{vx} {vy}");
}

#[test]
fn a_place_and_a_heading_are_reached_without_swinging() {
    for vertical in VERTICALS {
        let mut flight = alone("position", vertical, "");
        let flown = hold(&mut flight, [0.8, -0.6, 1.0, 0.7], 8.0);
        let last = flown.last().unwrap();
        for (i, wanted) in [0.8, -0.6, 1.0].into_iter().enumerate() {
            // 5.3 rests 1.4 % above what it is told
            assert!((last[i] - wanted).abs() < 0.03, "{vertical}: axis {i} rests at {}", last[i]);
        }
        assert!((last[state_index::YAW] - 0.7).abs() < 0.02, "{vertical}: {}", last[state_index::YAW]);
        // braking from full speed takes more tilt than the thesis allows; a small step stays within it
        let flown = hold(&mut alone("position", vertical, ""), [0.2, 0.0, 0.7, 0.0], 4.0);
        let farthest = flown.iter().map(|x| x[0]).fold(0.0_f32, f32::max);
        // the firmware's loops alone overshoot by an eighth
        let most = if vertical == "motors" { 1.15 } else { 1.1 };
        assert!(farthest < 0.2 * most, "{vertical}: overshoots to {farthest} m");
    }
}

/// The form that a level is tried on.
fn form_of(entry: &Entry) -> &'static str {
    if entry.level.is_below_attitude() { "motors" } else { "height" }
}

/// Returns the place in the true state at which a channel's value appears; a motor's PWM appears nowhere.
fn shown(name: &str) -> Option<usize> {
    Some(match name {
        "roll_rad" => state_index::ROLL,
        "pitch_rad" => state_index::PITCH,
        "yaw_rad" => state_index::YAW,
        "roll_rate_radps" => STATE - 3,
        "pitch_rate_radps" => STATE - 2,
        "yaw_rate_radps" => STATE - 1,
        "lift" | "z_m" => 2,
        "x_m" => 0,
        "y_m" => 1,
        "x_mps" => state_index::VEL,
        "y_mps" => state_index::VEL + 1,
        "z_mps" => state_index::VEL + 2,
        name => {
            assert!(name.ends_with("_pwm"), "channel {name}: where does it show?");
            return None;
        }
    })
}

/// Time until 63 % of the way from the first number of a column to its last.
fn response_s(column: &[f32], tick_s: f64) -> f64 {
    let (first, last) = (column[0], column[column.len() - 1]);
    let share = |i: usize| f64::from((column[i] - first) / (last - first));
    let after = (0..column.len()).find(|i| share(*i) >= 0.632).unwrap();
    tick_s * (after as f64 - (share(after) - 0.632) / (share(after) - share(after - 1)))
}

/// A step of one channel, in shares of its range; time to 63 %, and the last number over what was set.
fn step_response(entry: &Entry, form: &str, axis: usize, share: f64, seconds: f64) -> Option<[f64; 2]> {
    let index = shown(entry.channels[axis].name)?;
    let mut flight = alone(entry.name, form, "");
    let action: [f32; ACTION] = std::array::from_fn(|i| flight.observations[index::LAST_ACTION + i]);
    let mut set_point = flight.env.interfaces()[0].set_point(&action.map(f64::from));
    let rest = *hold(&mut flight, set_point, if entry.level.is_below_attitude() { 0.02 } else { 3.0 })
        .last()
        .unwrap();
    let [low, high] = flight.env.interfaces()[0].ranges()[axis];
    set_point[axis] += share * (high - low);
    let flown = hold(&mut flight, set_point, seconds);
    let column: Vec<f32> = std::iter::once(&rest).chain(&flown).map(|x| x[index]).collect();
    let gain = f64::from(column[column.len() - 1] - column[0]) / (share * (high - low));
    // a response within a tick counts as one tick
    let tick_s = flight.env.tick_s();
    Some([response_s(&column, tick_s).max(tick_s), gain])
}

#[test]
fn the_bandwidths_of_the_table_are_those_of_small_steps() {
    let mut wrong = String::new();
    for entry in registry() {
        let seconds = if entry.level.is_below_attitude() { 0.4 } else { 3.0 };
        for (axis, channel) in entry.channels.iter().enumerate() {
            let told = entry.bandwidth_radps[axis];
            let bandwidth = match step_response(entry, form_of(entry), axis, 0.05, seconds) {
                Some([time_s, _]) => 1.0 / time_s,
                None => 1.0 / Model::thesis().parameter("vertical.motors.lag").unwrap(),
            };
            if !(0.9..1.1).contains(&(bandwidth / told)) {
                wrong += &format!(
                    "{} {}: {bandwidth:.2} rad/s, the table says {told}\n",
                    entry.name, channel.name
                );
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn the_attitude_steps_of_both_vehicles_are_those_of_the_page() {
    let attitude = ActionLevel::Attitude.entry();
    let row = |form: &str| {
        let [time_s, gain] = step_response(attitude, form, 1, 0.1, 1.5).unwrap();
        format!("{:.2} s | {gain:.2}", time_s)
    };
    let page = include_str!("../../../docs/motors.md");
    let mut lines = Vec::new();
    for (name, form) in [("identified (5.1)", "height"), ("motor-level", "motors")] {
        lines.push(format!("| {name} | {} |", row(form)));
    }
    assert!(page.contains(&lines.join("\n")), "docs/motors.md should say: {lines:?}");
}

#[test]
fn wind_is_held_against() {
    for vertical in VERTICALS {
        let wind = r#", "effects": {"wind": {"x_mps2": 0.3}, "mass_change": 0.001}"#;
        let last = *hold(&mut alone("velocity", vertical, wind), [0.0; ACTION], 40.0).last().unwrap();
        for i in 0..3 {
            let speed_mps = last[state_index::VEL + i];
            assert!(speed_mps.abs() < 0.03, "{vertical}: axis {i} drifts at {speed_mps} m/s");
        }
    }
}

#[test]
fn a_flight_goes_on_from_its_snapshot() {
    for entry in registry() {
        for task in ["hover", "swap"] {
            let options =
                format!(r#""action": {:?}, "task": {task:?}, "effects": {{"gust": 0.3}}"#, entry.name);
            let mut flown = Flight::new(18, &options);
            (0..25).for_each(|_| wander(&mut flown));
            let bytes = flown.env.snapshot();
            let mut other = Flight::new(18, &options);
            other.env.restore(&bytes).unwrap();
            other.step = flown.step;
            for step in 25..60 {
                wander(&mut flown);
                wander(&mut other);
                assert!(flown.bits(18) == other.bits(18), "{} {task}: step {step}", entry.name);
            }
        }
    }
}

#[test]
fn an_episode_begins_with_the_action_that_keeps_it() {
    for entry in registry() {
        let flight = alone(entry.name, form_of(entry), "");
        let action: [f32; ACTION] = std::array::from_fn(|i| flight.observations[index::LAST_ACTION + i]);
        let set_point = flight.env.interfaces()[0].set_point(&action.map(f64::from));
        let mut flight = alone(entry.name, form_of(entry), "");
        let last = *hold(&mut flight, set_point, 1.0).last().unwrap();
        let mut begin = [0.0; STATE];
        alone(entry.name, form_of(entry), "").env.states(&mut begin).unwrap();
        for i in 0..3 {
            assert!((last[i] - begin[i]).abs() < 0.02, "{}: {last:?}", entry.name);
        }
    }
}

#[test]
fn the_default_is_not_written_and_mistakes_are_named() {
    let text = serde_json::to_string(&Options::default()).unwrap();
    assert!(!text.contains("action"), "published configurations would change their hash: {text}");
    let velocity = Options::parse(r#"{"action": "velocity"}"#).unwrap();
    assert_eq!(velocity.action, ActionLevel::Velocity);
    let again = serde_json::to_string(&velocity).unwrap();
    assert_eq!(Options::parse(&again).unwrap(), velocity);
    for (json, words) in [
        (r#"{"action": "velocities"}"#, vec!["velocities", "action level", "did you mean \"velocity\""]),
        (r#"{"action": 3}"#, vec!["expected"]),
    ] {
        let error = Options::parse(json).unwrap_err().to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
}
