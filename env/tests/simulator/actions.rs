//! What an action sets: levels above the attitude.

use crazyflie_env::action::{ActionLevel, Entry, registry};
use crazyflie_env::config::Options;
use crazyflie_env::effects::Scope;
use crazyflie_env::isa::Level;
use crazyflie_env::model::Model;
use crazyflie_env::observation::{ACTION, Interface, index};
use crazyflie_env::task;
use crazyflie_env::vector::{STATE, StepBuffers, VectorEnv, state_index};

struct Flight {
    env: VectorEnv,
    observations: Vec<f32>,
    rewards: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
    flying: Vec<bool>,
    metrics: Vec<f32>,
}

impl Flight {
    fn new(envs: usize, options: &str) -> Self {
        let options = Options::parse(&format!("{{{options}}}")).unwrap();
        let mut env = VectorEnv::new(&[Model::thesis()], &options, envs).unwrap();
        let rows = envs * env.num_drones();
        let mut observations = vec![0.0; rows * env.width()];
        let seeds: Vec<u64> = (0..envs as u64).collect();
        env.reset(Some(&seeds), None, &mut observations).unwrap();
        let (flying, metrics) =
            if env.num_metrics() == 0 { (0, 0) } else { (rows, envs * env.num_metrics()) };
        Flight {
            env,
            observations,
            rewards: vec![0.0; rows],
            terminated: vec![false; rows],
            truncated: vec![false; rows],
            flying: vec![true; flying],
            metrics: vec![0.0; metrics],
        }
    }

    fn step(&mut self, actions: &[f32]) {
        let out = StepBuffers {
            observations: &mut self.observations,
            rewards: &mut self.rewards,
            terminated: &mut self.terminated,
            truncated: &mut self.truncated,
            flying: &mut self.flying,
            metrics: &mut self.metrics,
        };
        self.env.step(actions, out).unwrap();
    }

    /// Actions that depend on the environment and the step alone.
    fn wander(&mut self, step: u64) {
        let per_env = self.env.num_drones() * ACTION;
        let action = |i: usize| {
            let seed = (i / per_env) as u64 * 7919 + step * 64 + (i % per_env) as u64;
            0.6 * ((crazyflie_env::noise::scramble(seed) >> 40) as f32 / 8_388_608.0 - 1.0)
        };
        let actions: Vec<f32> = (0..self.rewards.len() * ACTION).map(action).collect();
        self.step(&actions);
    }

    /// One drone's set-point held for so long; its true state after each step.
    fn hold(&mut self, set_point: [f64; ACTION], seconds: f64) -> Vec<[f32; STATE]> {
        let action = self.env.interfaces()[0].action_of(&set_point).map(|number| number as f32);
        let steps = (seconds / self.env.tick_s()).round() as usize;
        (0..steps)
            .map(|_| {
                self.step(&action);
                let mut x = [0.0; STATE];
                self.env.states(&mut x).unwrap();
                x
            })
            .collect()
    }

    fn bits(&self, envs: usize) -> Vec<u32> {
        let rows = envs * self.env.num_drones();
        self.observations[..rows * self.env.width()].iter().map(|number| number.to_bits()).collect()
    }
}

/// A single drone that starts where it is to be, 70 cm over the marker, and flies on.
fn alone(level: &str, vertical: &str, more: &str) -> Flight {
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
                    .map(|step| {
                        flight.wander(step);
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
                flight.wander(step);
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
            let flown = alone("velocity", vertical, "").hold(set_point, seconds);
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
    let turned = flight.hold([0.0, 0.0, 0.0, 1.0], 1.5);
    let yaw_rad = turned.last().unwrap()[state_index::YAW];
    assert!((yaw_rad - 1.5).abs() < 0.05, "right-handed, and as fast as asked: {yaw_rad}");
    let last = *flight.hold([0.4, 0.0, 0.0, 0.0], 3.0).last().unwrap();
    let [vx, vy] = [last[state_index::VEL], last[state_index::VEL + 1]];
    assert!((vx - 0.4).abs() < 0.02 && vy.abs() < 0.02, "{vx} {vy}");
}

#[test]
fn a_place_and_a_heading_are_reached_without_swinging() {
    for vertical in VERTICALS {
        let mut flight = alone("position", vertical, "");
        let flown = flight.hold([0.8, -0.6, 1.0, 0.7], 8.0);
        let last = flown.last().unwrap();
        for (i, wanted) in [0.8, -0.6, 1.0].into_iter().enumerate() {
            // 5.3 rests 1.4 % above what it is told
            assert!((last[i] - wanted).abs() < 0.03, "{vertical}: axis {i} rests at {}", last[i]);
        }
        assert!((last[state_index::YAW] - 0.7).abs() < 0.02, "{vertical}: {}", last[state_index::YAW]);
        // braking from full speed takes more tilt than the thesis allows; a small step stays within it
        let flown = alone("position", vertical, "").hold([0.2, 0.0, 0.7, 0.0], 4.0);
        let farthest = flown.iter().map(|x| x[0]).fold(0.0_f32, f32::max);
        assert!(farthest < 0.2 * 1.1, "{vertical}: overshoots to {farthest} m");
    }
}

/// The form that a level is tried on.
fn form_of(entry: &Entry) -> &'static str {
    if entry.level.is_below_attitude() { "motors" } else { "height" }
}

/// Where the true state shows what a channel sets; a motor's PWM shows nowhere.
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
    let at = shown(entry.channels[axis].name)?;
    let mut flight = alone(entry.name, form, "");
    let action: [f32; ACTION] = std::array::from_fn(|i| flight.observations[index::LAST_ACTION + i]);
    let mut set_point = flight.env.interfaces()[0].set_point(&action.map(f64::from));
    let rest =
        *flight.hold(set_point, if entry.level.is_below_attitude() { 0.02 } else { 3.0 }).last().unwrap();
    let [low, high] = flight.env.interfaces()[0].ranges()[axis];
    set_point[axis] += share * (high - low);
    let flown = flight.hold(set_point, seconds);
    let column: Vec<f32> = std::iter::once(&rest).chain(&flown).map(|x| x[at]).collect();
    let gain = f64::from(column[column.len() - 1] - column[0]) / (share * (high - low));
    // what is there within a tick has no time
    let time_s = response_s(&column, flight.env.tick_s()).max(0.02 * 0.632);
    Some([if (column[1] - column[column.len() - 1]).abs() < 1e-3 { 0.02 } else { time_s }, gain])
}

#[test]
fn the_bandwidths_of_the_table_are_those_of_small_steps() {
    let mut wrong = String::new();
    for entry in registry() {
        let seconds = if entry.level.is_below_attitude() { 0.4 } else { 3.0 };
        for (axis, channel) in entry.channels.iter().enumerate() {
            let told = entry.bandwidth_radps[axis];
            let found = match step_response(entry, form_of(entry), axis, 0.05, seconds) {
                Some([time_s, _]) => 1.0 / time_s,
                None => 1.0 / Model::thesis().parameter("vertical.motors.lag").unwrap(),
            };
            if !(0.9..1.1).contains(&(found / told)) {
                wrong +=
                    &format!("{} {}: {found:.2} rad/s, the table says {told}\n", entry.name, channel.name);
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
    let page = include_str!("../../../docs/actions.md");
    for (name, form) in [("identified (5.1)", "height"), ("motor-level", "motors")] {
        let line = format!("| {name} | {} |", row(form));
        assert!(page.contains(&line), "docs/actions.md should say: {line}");
    }
}

#[test]
fn wind_is_held_against() {
    for vertical in VERTICALS {
        let wind = r#", "effects": {"wind": {"x_mps2": 0.3}, "mass_change": 0.001}"#;
        let last = *alone("velocity", vertical, wind).hold([0.0; ACTION], 40.0).last().unwrap();
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
            (0..25).for_each(|step| flown.wander(step));
            let bytes = flown.env.snapshot();
            let mut other = Flight::new(18, &options);
            other.env.restore(&bytes).unwrap();
            for step in 25..60 {
                flown.wander(step);
                other.wander(step);
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
        let last = *flight.hold(set_point, 1.0).last().unwrap();
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

/// The page of action levels, between its head and its foot.
fn table() -> String {
    let model = Model::thesis();
    let mut text = String::from(
        "| level | number | unit | from | to | bandwidth, rad/s | about |\n|---|---|---|---|---|---|---|\n",
    );
    for entry in registry() {
        let input = entry.level.input(&model, None).unwrap();
        let interface = Interface::at_level(&model, input, entry.level).unwrap();
        for (i, channel) in entry.channels.iter().enumerate() {
            let [low, high] = interface.ranges()[i];
            text += &format!(
                "| `{}` | `{}` | {} | {} | {} | {} | {} |\n",
                entry.name,
                channel.name,
                channel.unit,
                rounded(low),
                rounded(high),
                entry.bandwidth_radps[i],
                channel.about
            );
        }
    }
    text += "\n";
    for entry in registry() {
        text += &format!(
            "- `{}`: {}. Validity: {}. Source: {}.\n",
            entry.name, entry.about, entry.validity, entry.source
        );
    }
    text
}

fn rounded(number: f64) -> f64 {
    (number * 1000.0).round() / 1000.0
}

#[test]
fn the_page_holds_the_table_of_the_registry() {
    let page = include_str!("../../../docs/actions.md");
    assert!(page.contains(&table()), "docs/actions.md is stale: it should hold\n{}", table());
}

#[test]
fn four_motors_turn_the_vehicle_the_way_they_stand() {
    let turned = |pwm: [f64; ACTION]| {
        let mut flight = alone("motors", "motors", "");
        let hover = flight.env.interfaces()[0].hover_lift;
        *flight.hold(pwm.map(|more| hover + more), 0.1).last().unwrap()
    };
    let still = turned([0.0; ACTION]);
    assert!(
        still[STATE - 3..].iter().all(|rate| rate.abs() < 1e-3) && (still[2] - 0.7).abs() < 1e-3,
        "{still:?}"
    );
    // left: to the right; back: nose down; 2 and 4: counter-clockwise
    for (axis, pwm) in [(0, [-2e3, -2e3, 2e3, 2e3]), (1, [-2e3, 2e3, 2e3, -2e3]), (2, [-2e3, 2e3, -2e3, 2e3])]
    {
        let x = turned(pwm);
        for i in 0..3 {
            let rate = x[STATE - 3 + i];
            assert!(if i == axis { rate > 0.1 } else { rate.abs() < 0.02 }, "axis {axis}: {x:?}");
        }
    }
}

#[test]
fn full_thrust_climbs_as_the_curve_says_and_none_falls() {
    let mut flight = alone("motors", "motors", "");
    let model = Model::thesis();
    let value = |name: &str| model.parameter(&format!("vertical.motors.{name}")).unwrap();
    let (share, linear) = (value("hover") / 65535.0, value("linear_share"));
    let ratio = 1.0 / (share * (linear + (1.0 - linear) * share));
    let flown = flight.hold([65535.0; ACTION], 0.4);
    let gained = f64::from(flown[19][5] - flown[18][5]) / 0.02;
    assert!((gained - 9.81 * (ratio - 1.0)).abs() < 0.2, "{gained} m/s^2, thrust over weight {ratio}");
    let flown = alone("motors", "motors", "").hold([0.0; ACTION], 0.3);
    let lost = f64::from(flown[14][5] - flown[13][5]) / 0.02;
    assert!((-9.81..-8.5).contains(&lost), "{lost} m/s^2");
}

#[test]
fn a_vehicle_that_tumbles_loses_no_number() {
    let mut flight = alone("body_rates", "motors", "");
    let hover = flight.env.interfaces()[0].hover_lift;
    for rates in [[6.0, 0.0, 0.0], [0.0, 6.0, 0.0], [4.0, 5.0, 3.0]] {
        let mut flight = alone("body_rates", "motors", r#", "effects": {"gust": 0.5}"#);
        let action =
            flight.env.interfaces()[0].action_of(&[rates[0], rates[1], rates[2], hover]).map(|a| a as f32);
        for _ in 0..60 {
            if flight.terminated[0] {
                break;
            }
            flight.step(&action);
            assert!(flight.observations.iter().all(|number| number.is_finite()), "{rates:?}");
        }
    }
    // asked for and given
    let x = *flight.hold([2.0, 0.0, 0.0, hover], 0.3).last().unwrap();
    assert!((x[STATE - 3] - 2.0).abs() < 0.3, "{x:?}");
}

#[test]
fn every_effect_fits_the_motor_form_or_is_refused() {
    for entry in crazyflie_env::effects::registry() {
        let param = entry.params[0];
        let toward = if param.high > param.off { param.high } else { param.low };
        let value = param.off + 0.2 * (toward - param.off);
        for level in ["attitude", "body_rates", "motors"] {
            let text = format!(
                r#"{{"action": {level:?}, "vertical": "motors", "effects": {{{:?}: {value}}}}}"#,
                entry.name
            );
            match VectorEnv::new(&[Model::thesis()], &Options::parse(&text).unwrap(), 2) {
                Err(error) => {
                    assert!(entry.scope != Scope::Any, "{}: {error}", entry.name);
                    assert!(error.to_string().contains(entry.name), "{error}");
                }
                Ok(_) => {
                    assert!(entry.scope != Scope::IdentifiedLoops, "{}", entry.name);
                    let text = &text[1..text.len() - 1];
                    let mut flight = Flight::new(2, text);
                    for step in 0..20 {
                        flight.wander(step);
                        assert!(
                            flight.observations.iter().all(|number| number.is_finite()),
                            "{}",
                            entry.name
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn levels_below_the_attitude_want_the_motor_form() {
    let error = |options: &str, model: &Model| {
        VectorEnv::new(std::slice::from_ref(model), &Options::parse(options).unwrap(), 1)
            .err()
            .unwrap()
            .to_string()
    };
    let told = error(r#"{"action": "motors", "vertical": "height"}"#, &Model::thesis());
    assert!(told.contains("\"motors\"") && told.contains("\"height\""), "{told}");
    let mut bare = Model::thesis();
    bare.vertical.motors = None;
    let told = error(r#"{"action": "body_rates"}"#, &bare);
    assert!(told.contains("vertical form of this model") && told.contains("motors"), "{told}");
}
