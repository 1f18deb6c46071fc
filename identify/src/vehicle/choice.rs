//! The numbers of a model that logs determine, and putting them back with their source.

use crazyflie_env::model::{Model, VerticalInput};

use super::{FitOptions, HEAVE};
use crate::estimate::{Clusters, ParameterEstimate, at_bound};
use crate::fit::hypothesis::Hypothesis;
use crate::fit::solve::Prior;
use crate::lift::{read_lift, read_tilt, varies};
use crate::{Error, FlightLog, NamedLog, Result};

/// A part of the model, and the input that must move for its numbers to show.
struct ModelPart {
    prefix: String,
    input: &'static str,
    moves: bool,
}

fn parts(model: &Model, logs: &[NamedLog], input: VerticalInput) -> Vec<ModelPart> {
    let moves = |command: &dyn Fn(&FlightLog) -> Option<bool>| {
        logs.iter().any(|(_, log)| command(log).unwrap_or(false))
    };
    let tilts = |axis: usize| {
        moves(&|log| Some(changes_in_flight(log, read_tilt(log, model.command.tilt).ok()?[axis])))
    };
    let [roll, pitch] = [tilts(0), tilts(1)];
    let yaw = moves(&|log| Some(changes_in_flight(log, log.cmd_yaw_rate_radps.as_ref()?)));
    let lift = moves(&|log| Some(changes_in_flight(log, &read_lift(log, model, input).ok()?)));
    let (form, lift_name) = vertical_form(input);
    let part = |prefix: &str, input, moves| ModelPart { prefix: prefix.to_owned(), input, moves };
    vec![
        part("roll.", "roll command", roll),
        part("pitch.", "pitch command", pitch),
        part("yaw.", "yaw-rate command", yaw),
        part("lateral.", "roll and pitch commands", roll || pitch),
        part(&format!("vertical.{form}."), lift_name, lift),
    ]
}

fn vertical_form(input: VerticalInput) -> (&'static str, &'static str) {
    match input {
        VerticalInput::Height => ("height", "height command"),
        VerticalInput::Pwm => ("pwm", "thrust command"),
        VerticalInput::Thrust => ("thrust", "thrust command"),
        VerticalInput::Motors => ("motors", "thrust command"),
    }
}

/// Returns whether a command changes in flight.
fn changes_in_flight(log: &FlightLog, values: &[f64]) -> bool {
    varies(values.get(log.airborne.clone()).unwrap_or_default())
}

/// Returns whether a log of commands and poses determines a number: gravity is known, a hover PWM beside an offset
/// and the damping of pushes do nothing in flight.
fn is_observable(path: &str) -> bool {
    let idle = path.ends_with(".push_damping")
        || (path.ends_with(".hover") && !path.starts_with("vertical.thrust."));
    path != "lateral.gravity" && !idle
}

/// The numbers that are fitted unless others are named: those of the equations of motion whose input moves.
pub fn visible(model: &Model, logs: &[NamedLog], input: VerticalInput) -> Vec<String> {
    let parts = parts(model, logs, input);
    let shows = |path: &String| {
        // nothing pulls back an angle whose rate or moment is commanded
        let is_zero = path.ends_with(".stiffness") && model.parameter(path) == Ok(0.0);
        let moves = parts.iter().any(|part| part.moves && path.starts_with(&part.prefix));
        is_observable(path) && !is_zero && moves
    };
    model.parameters().into_iter().map(|(path, ..)| path).filter(shows).collect()
}

/// Returns the paths to fit: the requested ones, if they can be determined at all.
pub(super) fn check(
    model: &Model,
    logs: &[NamedLog],
    input: VerticalInput,
    asked: Option<&[String]>,
) -> Result<Vec<String>> {
    let Some(asked) = asked else {
        let all = visible(model, logs, input);
        let none = || Error::no_excitation("command", "any number of the model");
        return if all.is_empty() { Err(none()) } else { Ok(all) };
    };
    let parts = parts(model, logs, input);
    let mut paths: Vec<String> = Vec::new();
    for path in asked {
        model.parameter(path)?;
        let part = parts.iter().find(|part| path.starts_with(&part.prefix));
        match part {
            None if path.starts_with("vertical.") => {
                let driven = format!("the logs drive the vertical form {}", vertical_form(input).0);
                return Err(Error::singular(path, &format!("{driven}; choose another form, or its numbers")));
            }
            None => return Err(Error::singular(path, "it is no part of the equations of motion")),
            Some(part) if !part.moves => return Err(Error::no_excitation(part.input, path)),
            Some(_) if !paths.contains(path) => paths.push(path.clone()),
            Some(_) => {}
        }
    }
    Ok(paths)
}

/// Leaves out of a fit the common numbers that ran to a bound, and effects whose first parameter, their strength,
/// did. Returns their names. Numbers of the model stay if they were requested (`asked`), and the damping of climb
/// stays at zero.
pub(super) fn leave_out(hypothesis: &mut Hypothesis, shared: &[f64], asked: bool) -> Vec<String> {
    let (bounds, per_flight) = (hypothesis.bounds(), hypothesis.per_flight());
    let mut common = shared.iter();
    // the common numbers come first, in the order of all
    let ran = |(bounds, own): (&[f64; 2], &Option<Prior>)| {
        own.is_none() && common.next().is_some_and(|value| at_bound(*value, *bounds))
    };
    let mut ran = bounds.iter().zip(&per_flight).map(ran).collect::<Vec<bool>>().into_iter();
    let numbers = hypothesis.free.iter().zip(ran.by_ref().take(hypothesis.free.len())).zip(shared);
    let left_out =
        numbers.filter(|((path, ran), value)| *ran && !asked && !(*path == HEAVE && **value == 0.0));
    let mut names: Vec<String> = left_out.map(|((path, _), _)| path.clone()).collect();
    hypothesis.free.retain(|path| !names.contains(path));
    let mut gone = Vec::new();
    for term in &mut hypothesis.terms {
        let of_term = term.free.iter().zip(ran.by_ref().take(term.free.len()));
        let ran: Vec<usize> = of_term.filter(|(_, ran)| *ran).map(|(i, _)| *i).collect();
        if ran.contains(&0) {
            gone.push(term.entry.name);
            continue;
        }
        for i in ran {
            names.push(format!("{}.{}", term.entry.name, term.entry.params[i].name));
            term.values[i] = term.entry.params[i].off;
            term.free.retain(|free| *free != i);
        }
    }
    names.extend(gone.iter().map(|name| (*name).to_owned()));
    hypothesis.terms.retain(|term| !gone.contains(&term.entry.name));
    names
}

/// Returns the model found, under its own name: its numbers and effects name their sources, and its vertical form is
/// the one that flew. Numbers of single flights are left out.
pub(super) fn model_with_sources(
    found: &Hypothesis,
    plan: &FitOptions,
    input: VerticalInput,
    estimates: &[ParameterEstimate],
    logs: &[&str],
    clusters: Clusters,
) -> Result<Model> {
    let all = logs.join(", ");
    // beside every number, a long list would be all that one sees of a file
    let logs = if logs.len() > 3 { format!("{} flights", logs.len()) } else { all.clone() };
    let mut own = found.clone();
    own.terms.retain(|term| term.per_flight.is_none());
    let mut model = own.to_model(&format!("as in the fit of {logs}"));
    if let Some(name) = &plan.name {
        model.description = format!("identified from {all}, starting from the model {}", model.name);
        model.name.clone_from(name);
    }
    model.vertical.default = Some(input);
    // a data sheet's, and of the vehicle from which the fit began
    model.vertical.motors = None;
    let bad = |why: serde_json::Error| Error::about(&format!("model {}", found.model.name), why);
    let mut tree = serde_json::to_value(&model).map_err(bad)?;
    for estimate in estimates {
        let at_bound = if estimate.at_bound { ", at its bound" } else { "" };
        let error = estimate.standard_error;
        let text = format!("identified from {logs}: standard error {error:.3e}, {clusters}{at_bound}");
        let path = format!("/{}", estimate.name.replace('.', "/"));
        let pointer = if tree.pointer(&path).is_some() { path } else { format!("/effects{path}") };
        if let Some(slot) = tree.pointer_mut(&pointer) {
            slot["source"] = text.into();
        }
    }
    if plan.mass_kg.is_some() {
        tree["vehicle"]["mass"]["source"] = "given to the identification".into();
    }
    Ok(Model::parse(&tree.to_string())?)
}

/// The model with another source for one of its numbers. It stays as it is if it has no such number.
pub(crate) fn with_source(model: &Model, path: &str, source: &str) -> Model {
    let changed = || {
        let mut tree = serde_json::to_value(model).ok()?;
        tree.pointer_mut(&format!("/{}", path.replace('.', "/")))?["source"] = source.into();
        Model::parse(&tree.to_string()).ok()
    };
    changed().unwrap_or_else(|| model.clone())
}
