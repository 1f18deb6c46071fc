//! The module of an environment.

use std::fmt::Write as _;

use crazyflie_env::config::{Distribution, Number};
use crazyflie_env::error::Result;
use crazyflie_env::recording::{Input, Program, Recording, StateField};
use crazyflie_env::symbol::{Call, Id, elementary_body};
use crazyflie_env::task;

use crate::code::{call_name, write_lines, write_program};
use crate::starts::write_starts;

const CALLS: [Call; 6] = [Call::Sin, Call::Cos, Call::SinQuarter, Call::CosQuarter, Call::Exp, Call::Ln];

/// Writes the module of a recorded environment.
///
/// # Errors
/// [`crazyflie_env::Error::Unknown`] for a task that is not in the registry.
pub fn write_module(recording: &Recording) -> Result<String> {
    let mut text = head(recording)?;
    text.push_str(include_str!("operations.py"));
    for call in CALLS {
        text.push_str(&elementary(call)?);
    }
    text.push_str(&parameter_classes(recording));
    text.push_str(&state_class(recording));
    text.push_str(&constants(recording)?);
    text.push_str(&begin(recording));
    text.push_str(&tick(recording));
    text.push_str(&fork(recording));
    text.push_str("\n\n");
    text.push_str(include_str!("runtime.py"));
    text.push_str(include_str!("kernel.py"));
    Ok(text)
}

fn head(recording: &Recording) -> Result<String> {
    let entry = task::find(&recording.options.task)?;
    let effects: Vec<&str> = recording.parameters.iter().map(|group| group.name.as_str()).collect();
    let effects = if effects.is_empty() { "none".to_owned() } else { effects.join(", ") };
    Ok(format!(
        "\"\"\"{}: {}.

Written by `crazyflie export --jax` from the simulator's own formulas; it needs JAX and NumPy alone.
Reward: {}.
Effects: {effects}. A tick lasts {} s.

    env = Environment()
    observation, state = env.reset(jax.random.key(0))
    observation, state, reward, done, info = env.step(jax.random.key(1), state, action)
\"\"\"

import functools
import operator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np


",
        entry.id, entry.about, entry.reward, recording.tick_s
    ))
}

/// A function of `x`, as every number type computes it.
fn elementary(call: Call) -> Result<String> {
    let (id, graph) = elementary_body(call)?;
    let (lines, value) = write_lines(&graph, &graph.live([id]), &[id], |_| "x".into());
    Ok(format!("\n\ndef {}(x):\n{lines}    return {}\n", call_name(call), value.join(", ")))
}

fn parameter_classes(recording: &Recording) -> String {
    let mut text = String::new();
    for group in &recording.parameters {
        let class = class_name(&group.name);
        write!(text, "\n\nclass {class}(NamedTuple):\n    \"\"\"{}.\"\"\"\n\n", group.about)
            .unwrap_or_default();
        for p in group.parameters.iter().filter(|p| !p.counts) {
            let [low, high] = p.range;
            writeln!(text, "    # {}; {low} to {high} {}", p.about, p.unit).unwrap_or_default();
            writeln!(text, "    {}: float = {:?}", p.name, p.value()).unwrap_or_default();
        }
    }
    text.push_str("\n\nclass Params(NamedTuple):\n    \"\"\"Parameters of the effects.\"\"\"\n\n");
    for group in &recording.parameters {
        let class = class_name(&group.name);
        writeln!(text, "    {}: {class} = {class}()", group.name).unwrap_or_default();
    }
    text
}

/// `motor_lag` as `MotorLag`.
fn class_name(name: &str) -> String {
    let capital = |word: &str| {
        let mut letters = word.chars();
        letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
    };
    name.split('_').map(capital).collect()
}

fn state_class(recording: &Recording) -> String {
    let mut text = String::from(
        "\n\nclass State(NamedTuple):\n    \"\"\"What a flight goes on from: a number or a tuple of them for each \
         field.\"\"\"\n\n    # low and high word of each drone's key of the episode, then the number of the tick\n    \
         noise: tuple\n",
    );
    for field in &recording.state {
        let kind = if field.length == 1 { "jax.Array".into() } else { format!("tuple  # {}", field.length) };
        writeln!(text, "    {}: {kind}", field.name).unwrap_or_default();
    }
    text
}

fn constants(recording: &Recording) -> Result<String> {
    let entry = task::find(&recording.options.task)?;
    let mut text = format!(
        "\n\nID = {:?}\nDRONES = {}\nTICK_S = {:?}\nMAX_EPISODE_STEPS = {}\n",
        entry.id, recording.drones, recording.tick_s, recording.options.max_episode_steps
    );
    text.push_str("TRUE = (\"pos_m\", \"vel_mps\", \"att_rad\", \"rate_radps\")\n");
    text.push_str("# name, numbers, unit, lowest, highest\nFIELDS = (\n");
    for field in &recording.observation {
        let (unit, low, high) = (field.unit, field.low, field.high);
        writeln!(text, "    ({:?}, {}, {unit:?}, {low:?}, {high:?}),", field.name, field.length)
            .unwrap_or_default();
    }
    text.push_str(")\n# effect, parameter, kind, numbers, lowest, highest\nDISTRIBUTIONS = (\n");
    for group in &recording.parameters {
        for p in &group.parameters {
            if let (Number::Distribution(distribution), false) = (&p.number, p.counts) {
                let (kind, numbers) = distribution_words(distribution);
                let [low, high] = p.range;
                let names = format!("{:?}, {:?}, {kind:?}", group.name, p.name);
                writeln!(text, "    ({names}, {numbers:?}, {low:?}, {high:?}),").unwrap_or_default();
            }
        }
    }
    text.push_str(")\n");
    text.push_str(&write_starts(recording));
    Ok(text)
}

fn distribution_words(distribution: &Distribution) -> (&'static str, Vec<f64>) {
    match distribution {
        Distribution::Uniform(ends) => ("uniform", ends.to_vec()),
        Distribution::LogUniform(ends) => ("log_uniform", ends.to_vec()),
        Distribution::Normal(moments) => ("normal", moments.to_vec()),
        Distribution::Choice(values) => ("choice", values.clone()),
    }
}

/// Returns the name of a program's input.
fn input_name(recording: &Recording, input: Input) -> String {
    match input {
        Input::State(number) => state_name(&recording.state, number),
        Input::Word(drone, 0) => format!("key_low_{drone}"),
        Input::Word(drone, _) => format!("key_high_{drone}"),
        Input::Tick => "tick".to_owned(),
        Input::Count => "tick.astype(real)".to_owned(),
        Input::Action(drone, i) => format!("action_{drone}_{i}"),
        Input::Parameter(group, i) => {
            let group = &recording.parameters[group];
            format!("params.{}.{}", group.name, group.parameters[i].name)
        }
        Input::Start(i) => format!("start[{i}]"),
    }
}

fn state_name(fields: &[StateField], number: usize) -> String {
    let mut left = number;
    for field in fields {
        if left < field.length {
            return if field.length == 1 { field.name.clone() } else { format!("{}_{left}", field.name) };
        }
        left -= field.length;
    }
    // no live node has it
    "unused".into()
}

/// Lines that give the numbers of the state their names.
fn unpack(recording: &Recording) -> String {
    let mut text = String::new();
    let mut first = 0;
    for field in &recording.state {
        let names: Vec<String> =
            (first..first + field.length).map(|i| state_name(&recording.state, i)).collect();
        first += field.length;
        writeln!(text, "    {} = state.{}", names.join(", "), field.name).unwrap_or_default();
    }
    text
}

/// An expression for the state after a program.
fn state_expression(recording: &Recording, words: &[String], numbers: &[String]) -> String {
    let mut text = format!("State(\n        noise=({},),\n", words.join(", "));
    let mut first = 0;
    for field in &recording.state {
        let own: Vec<String> =
            numbers[first..first + field.length].iter().map(|n| format!("_real({n}, shape, real)")).collect();
        first += field.length;
        let value = if field.length == 1 { own.join("") } else { format!("({})", own.join(", ")) };
        writeln!(text, "        {}={value},", field.name).unwrap_or_default();
    }
    text.push_str("    )");
    text
}

/// All of a program's outputs: state, observations, rewards, ends.
struct Outputs {
    lines: String,
    state: Vec<String>,
    words: Vec<String>,
    observations: String,
    verdicts: [String; 3],
}

fn outputs(recording: &Recording, program: &Program) -> Outputs {
    let verdicts = |pick: fn(&crazyflie_env::recording::Verdict) -> Id| program.verdicts.iter().map(pick);
    let mut wanted: Vec<Id> = program.state.clone();
    wanted.extend(&program.words);
    wanted.extend(program.observations.iter().flatten());
    wanted.extend(verdicts(|v| v.reward).chain(verdicts(|v| v.terminated)).chain(verdicts(|v| v.truncated)));
    let (lines, texts) =
        write_program(program, &wanted, |place| input_name(recording, program.inputs[place]));
    let mut rest = texts.into_iter();
    let state = rest.by_ref().take(program.state.len()).collect();
    let words = rest.by_ref().take(program.words.len()).collect();
    let rows: Vec<String> = program
        .observations
        .iter()
        .map(|row| tuple(rest.by_ref().take(row.len()).map(|n| format!("_real({n}, shape, real)"))))
        .collect();
    let drones = program.verdicts.len();
    let rewards = tuple(rest.by_ref().take(drones).map(|n| format!("_real({n}, shape, real)")));
    let mut flags = || tuple(rest.by_ref().take(drones).map(|flag| format!("_real({flag}, shape, bool)")));
    let (ends, late) = (flags(), flags());
    Outputs { lines, state, words, observations: tuple(rows), verdicts: [rewards, ends, late] }
}

fn tuple(words: impl IntoIterator<Item = String>) -> String {
    let words: Vec<String> = words.into_iter().collect();
    format!("({},)", words.join(", "))
}

/// The names of the words of all drones' keys.
fn key_names(recording: &Recording) -> Vec<String> {
    (0..recording.drones).flat_map(|j| [format!("key_low_{j}"), format!("key_high_{j}")]).collect()
}

fn begin(recording: &Recording) -> String {
    let out = outputs(recording, &recording.begin);
    let mut words = key_names(recording);
    let mut text = format!(
        "\n\ndef _real(number, shape, real):\n    return jnp.broadcast_to(jnp.asarray(number, real), shape)\n\n\ndef \
         _begin(words, start, params, real):\n    \"\"\"The first moment of an episode.\"\"\"\n    {} = words\n    shape = \
         key_low_0.shape\n",
        words.join(", ")
    );
    words.push("jnp.zeros_like(key_low_0)".into());
    text.push_str(&out.lines);
    let state = state_expression(recording, &words, &out.state);
    writeln!(text, "    state = {state}\n    return state, {}", out.observations).unwrap_or_default();
    text
}

fn tick(recording: &Recording) -> String {
    let out = outputs(recording, &recording.tick);
    let mut words = key_names(recording);
    let mut text = format!(
        "\n\ndef _tick(state, action, params, real):\n    \"\"\"One control tick.\"\"\"\n    {}, tick = state.noise\n    \
         shape = tick.shape\n",
        words.join(", ")
    );
    for drone in 0..recording.drones {
        let names: Vec<String> = (0..4).map(|i| format!("action_{drone}_{i}")).collect();
        writeln!(text, "    {} = action[{drone}]", names.join(", ")).unwrap_or_default();
    }
    text.push_str(&unpack(recording));
    text.push_str(&out.lines);
    words.extend(out.words);
    let state = state_expression(recording, &words, &out.state);
    let [rewards, ends, late] = out.verdicts;
    writeln!(text, "    state = {state}\n    return state, {}, {rewards}, {ends}, {late}", out.observations)
        .unwrap_or_default();
    text
}

fn fork(recording: &Recording) -> String {
    let program = &recording.fork;
    let name = |place: usize| match program.inputs[place] {
        Input::Word(_, 0) => "low".to_owned(),
        Input::Word(..) => "high".to_owned(),
        _ => "tick".to_owned(),
    };
    let (lines, words) = write_program(program, &program.words, name);
    format!(
        "\n\ndef _fork(low, high, tick):\n    \"\"\"Words of the next episode, and one to pick its start \
         by.\"\"\"\n{lines}    return {}\n",
        words.join(", ")
    )
}
