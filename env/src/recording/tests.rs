//! A recorded program computes what the simulator computes, bit for bit.

use std::collections::HashMap;

use super::*;
use crate::config::Options;
use crate::effects::registry;
use crate::scalar::{Scalar, Word};
use crate::symbol::{Binary, Id, Kind, Node, Unary};
use crate::task;
use crate::vector::STATE;

/// A node's value: numbers and flags and words.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Value {
    Number(f64),
    Flag(bool),
    Word(u32),
}

impl Value {
    fn number(self) -> f64 {
        if let Value::Number(number) = self { number } else { panic!("{self:?} is no number") }
    }
    fn flag(self) -> bool {
        if let Value::Flag(flag) = self { flag } else { panic!("{self:?} is no flag") }
    }
    fn word(self) -> u32 {
        if let Value::Word(word) = self { word } else { panic!("{self:?} is no word") }
    }
}

/// Runs a program on `f64`.
fn evaluate(program: &Program, inputs: &HashMap<Input, Value>) -> Vec<Option<Value>> {
    let live = program.live_nodes();
    let mut values: Vec<Option<Value>> = Vec::new();
    for (node, live) in program.graph.nodes().iter().zip(live) {
        let value = live.then(|| {
            let of = |id: Id| values[id as usize].unwrap();
            let (x, w, f) = (|id| of(id).number(), |id| of(id).word(), |id| of(id).flag());
            match *node {
                Node::Input(kind, place) => {
                    let value = inputs[&program.inputs[place]];
                    assert_eq!(kind == Kind::Word, matches!(value, Value::Word(_)));
                    value
                }
                Node::Number(bits) => Value::Number(f64::from_bits(bits)),
                Node::Flag(on) => Value::Flag(on),
                Node::Word(word) => Value::Word(word),
                Node::Shift(a, bits) => Value::Word(Word::shr(w(a), bits)),
                Node::Select(mask, yes, no) => {
                    if f(mask) {
                        of(yes)
                    } else {
                        of(no)
                    }
                }
                Node::Call(call, a) => Value::Number(call.value(x(a))),
                Node::Unary(Unary::Not, a) => Value::Flag(!f(a)),
                Node::Unary(Unary::Unit, a) => Value::Number(f64::unit(w(a))),
                Node::Unary(operation, a) => Value::Number(match operation {
                    Unary::Neg => -x(a),
                    Unary::Sqrt => Scalar::sqrt(x(a)),
                    Unary::Abs => Scalar::abs(x(a)),
                    Unary::Round => Scalar::round(x(a)),
                    Unary::Mantissa => x(a).split_exponent().0,
                    _ => x(a).split_exponent().1,
                }),
                Node::Binary(operation, a, b) => match operation {
                    Binary::Less => Value::Flag(x(a) < x(b)),
                    Binary::AtMost => Value::Flag(x(a) <= x(b)),
                    Binary::BitAnd => Value::Flag(f(a) & f(b)),
                    Binary::BitOr => Value::Flag(f(a) | f(b)),
                    Binary::BitXor => Value::Word(w(a) ^ w(b)),
                    Binary::WordAdd => Value::Word(Word::add(w(a), w(b))),
                    Binary::WordMul => Value::Word(Word::mul(w(a), w(b))),
                    Binary::Add => Value::Number(x(a) + x(b)),
                    Binary::Sub => Value::Number(x(a) - x(b)),
                    Binary::Mul => Value::Number(x(a) * x(b)),
                    Binary::Div => Value::Number(x(a) / x(b)),
                    Binary::Min => Value::Number(Scalar::min(x(a), x(b))),
                    Binary::Max => Value::Number(Scalar::max(x(a), x(b))),
                    Binary::ScaleExponent => Value::Number(x(a).scale_exponent(x(b))),
                },
            }
        });
        values.push(value);
    }
    values
}

fn read(values: &[Option<Value>], ids: &[Id]) -> Vec<f64> {
    ids.iter().map(|id| values[*id as usize].unwrap().number()).collect()
}

/// Lively commands: numbers from -1 to 1 for each drone.
fn actions(drones: usize, ticks: usize) -> Vec<f64> {
    let action = |tick: usize, drone: usize| {
        let (t, shift) = (0.02 * tick as f64, 0.7 * drone as f64);
        let sin = |rate: f64, size: f64| size * libm::sin(rate * t + shift);
        [sin(3.1, 0.5), sin(2.3, 0.6), sin(0.9, 0.2), 0.311 + sin(1.7, 0.03)]
    };
    (0..ticks).flat_map(|tick| (0..drones).flat_map(move |drone| action(tick, drone))).collect()
}

/// Flies an episode by the recorded programs and in double precision; the two agree to the last bit.
fn check(options: &Options, ticks: usize) {
    let models = [Model::thesis()];
    let recording = record_environment(&models, options, (3, 4)).unwrap();
    let (n, start) = (recording.drones, &recording.starts[0]);
    let actions = actions(n, ticks);
    let double = fly_double(&models, options, 3, &actions).unwrap();
    let mut inputs = HashMap::new();
    for (i, group) in recording.parameters.iter().enumerate() {
        for (j, parameter) in group.parameters.iter().enumerate() {
            inputs.insert(Input::Parameter(i, j), Value::Number(parameter.value()));
        }
    }
    for (drone, key) in start.keys.iter().enumerate() {
        for (i, word) in [*key as u32, (*key >> 32) as u32].into_iter().enumerate() {
            inputs.insert(Input::Word(drone, i), Value::Word(word));
        }
    }
    start.numbers.iter().enumerate().for_each(|(i, number)| {
        inputs.insert(Input::Start(i), Value::Number(*number));
    });
    let values = evaluate(&recording.begin, &inputs);
    let mut observations: Vec<f64> =
        recording.begin.observations.iter().flat_map(|row| read(&values, row)).collect();
    let mut state = read(&values, &recording.begin.state);
    let (mut rewards, mut ends) = (Vec::new(), Vec::new());
    for (tick, row) in actions.chunks_exact(4 * n).enumerate() {
        state.iter().enumerate().for_each(|(i, x)| {
            inputs.insert(Input::State(i), Value::Number(*x));
        });
        for (i, number) in row.iter().enumerate() {
            inputs.insert(Input::Action(i / 4, i % 4), Value::Number(*number));
        }
        inputs.insert(Input::Tick, Value::Word(tick as u32));
        inputs.insert(Input::Count, Value::Number(tick as f64));
        let values = evaluate(&recording.tick, &inputs);
        observations.extend(recording.tick.observations.iter().flat_map(|row| read(&values, row)));
        for verdict in &recording.tick.verdicts {
            rewards.push(values[verdict.reward as usize].unwrap().number());
            ends.push(values[verdict.terminated as usize].unwrap().flag());
        }
        assert_eq!(values[recording.tick.words[0] as usize].unwrap().word(), tick as u32 + 1);
        state = read(&values, &recording.tick.state);
    }
    let context = serde_json::to_string(options).unwrap();
    assert_eq!(double.states.len(), ticks * n * STATE);
    // -0 and 0 are the same number
    let first = observations.iter().zip(&double.observations).position(|(a, b)| a != b);
    assert_eq!(first, None, "{context}: of {} numbers", observations.len());
    assert_eq!((rewards, ends), (double.rewards, double.terminated), "{context}");
}

/// Parameters that are felt, and moderate.
fn lively(entry: &crate::effects::Entry) -> String {
    let value = |p: &crate::effects::Param| {
        let far = if p.high > p.off { p.high } else { p.low };
        if p.counts { 2.0 } else { p.off + 0.2 * (far - p.off) }
    };
    let params: Vec<String> = entry.params.iter().map(|p| format!("\"{}\": {}", p.name, value(p))).collect();
    format!("\"{}\": {{{}}}", entry.name, params.join(", "))
}

fn parsed(json: &str) -> Options {
    Options::parse(json).unwrap()
}

#[test]
fn every_effect_is_recorded_as_it_is_simulated() {
    for entry in registry() {
        check(&parsed(&format!("{{\"effects\": {{{}}}}}", lively(entry))), 120);
    }
}

#[test]
fn all_effects_together_are_recorded_as_they_are_simulated() {
    let all: Vec<String> = registry().iter().map(lively).collect();
    check(&parsed(&format!("{{\"effects\": {{{}}}}}", all.join(", "))), 60);
}

#[test]
fn every_task_is_recorded_as_it_is_simulated() {
    for entry in task::registry() {
        check(&parsed(&format!("{{\"task\": \"{}\", \"max_episode_steps\": 100}}", entry.name)), 150);
    }
}

#[test]
fn action_levels_forms_and_observations_are_recorded() {
    for text in [
        r#"{"action": "velocity", "observation": "estimate", "effects": {"camera": 1, "camera_noise": 0.01}}"#,
        r#"{"action": "position", "observation": "state"}"#,
        r#"{"vertical": "height"}"#,
        r#"{"vertical": "thrust", "observation": ["pos_m", "error_m"]}"#,
        r#"{"reward": "exp(-4*dist**2) - 0.01*rate2", "termination": "tilt > 0.3"}"#,
        r#"{"task": "race", "task_options": {"level": 4}, "observation": ["gate_pos_m", "obstacle_m"]}"#,
        r#"{"task": "track", "task_options": {"shape": "waypoints"}}"#,
        r#"{"task": "swap", "drones": 3, "neighbours": {"by": "range", "range_m": 1}}"#,
        r#"{"task": "swap", "drones": 3, "reward": "nearest_m - min_separation_m + norm(others_mean_m)"}"#,
        r#"{"task": "carry", "reward": "norm(load_pos_m)", "termination": "nearest_m < 0.1"}"#,
        r#"{"task": "own", "drones": 2, "task_options": {"roles": [{"race": {}}, {"beside": 0, "offset_m": [0, 0.5, 0]}]}}"#,
        r#"{"task": "swap", "drones": 2, "effects": {"cmd_delay": 0.03},
            "each": [{"effects": {"drag_linear": 0.4}}, {"effects": {"gust": {"sigma_mps2": 0.5}}}]}"#,
    ] {
        check(&parsed(text), 80);
    }
}

#[test]
fn what_cannot_be_recorded_is_named() {
    for (text, word) in [
        (r#"{"history": 2}"#, "history"),
        (r#"{"task": "swap", "neighbours": {"by": "radio"}}"#, "neighbours by radio"),
        (r#"{"watch": ["dist"]}"#, "watch"),
        (
            r#"{"task": "track", "task_options": {"points": [[0, 0, 0, 0.7], [5, 1, 0, 0.7]]}}"#,
            "not known before the flight",
        ),
    ] {
        let error = record_environment(&[Model::thesis()], &parsed(text), (0, 1)).unwrap_err().to_string();
        assert!(error.contains(word), "{text} gave: {error}");
    }
}

#[test]
fn a_state_holds_only_what_a_flight_goes_on_from() {
    let names = |text: &str| -> Vec<String> {
        let recording = record_environment(&[Model::thesis()], &parsed(text), (0, 1)).unwrap();
        recording.state.into_iter().map(|field| field.name).collect()
    };
    // no camera: no fix of it
    // the tick counts itself, and every flight has the same goal
    let plain = ["pos_m", "vel_mps", "att_rad", "rate_radps", "lag", "last_action"];
    assert_eq!(names("{}"), plain);
    let fixed = names(r#"{"effects": {"camera": 1}}"#);
    assert!(fixed.contains(&"fix_pos_m".to_owned()), "{fixed:?}");
}
