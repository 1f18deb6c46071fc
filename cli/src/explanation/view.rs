//! Contents of the page, as texts and lengths of bars; the template only places them.

use crazyflie_env::effects::{Entry, Param, Role, find};
use crazyflie_identify::explain::verdict::{
    EffectParameterEstimate, Explanation, Finding, NumberEstimate, RankedCandidate, Step,
};
use crazyflie_identify::fit::filter::GaussMarkov;
use crazyflie_identify::fit::flight::Flight;
use minijinja::value::Serde;
use minijinja::{Value, context};
use serde::Serialize;

use super::bars::LogScale;
use super::figures::WhitenessFigure;
use super::series::{Whiteness, channel};
use super::words::{confusable, interval, join_words, significant, unit, with_error};
use super::{FlightSource, Run};
use crate::text::number;

/// Candidates shown per step of the search.
const MAX_BARS: usize = 10;
/// A gain below this is no bar.
const LEAST_BAR: f64 = 0.5;

/// A number as it is shown, and as the object for machines has it, with its place there.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Cell {
    text: String,
    value: Option<String>,
    pointer: String,
}

impl Cell {
    pub(crate) fn text(&self) -> &str {
        &self.text
    }

    pub(super) fn new(text: String, value: f64, pointer: String) -> Self {
        // in full: what is read again is the same number
        Cell { text, value: value.is_finite().then(|| value.to_string()), pointer }
    }
}

impl From<Cell> for Value {
    fn from(cell: Cell) -> Self {
        Serde(cell).into()
    }
}

/// The registry's entry of an effect.
fn entry(name: &str) -> Option<&'static Entry> {
    find(name).ok().map(|(_, entry)| entry)
}

/// Numbers of the model as they were declared and as they were fitted.
pub(super) fn numbers(all: &[NumberEstimate]) -> Vec<Value> {
    let row = |(i, n): (usize, &NumberEstimate)| {
        let cell =
            |name: &str, value| Cell::new(significant(value, 4), value, format!("/numbers/{i}/{name}"));
        let (declared, fitted) = (cell("declared", n.declared), cell("value", n.value));
        context!(path => n.path.as_str(), declared, fitted, unit => unit(&n.unit))
    };
    all.iter().enumerate().map(row).collect()
}

/// Returns the effects of one of the lists for machines, each with those that belong to it.
pub(super) fn effects(list: &'static str, effects: &[Finding]) -> Vec<Value> {
    let effect_row = |effect: &Finding, pointer: String| {
        context! {
            name => effect.name,
            about => entry(effect.name).map_or("", |e| e.about),
            params => params(effect, &pointer),
            worth_fit => number(effect.worth_fit, 0),
            worth_test => number(effect.worth_test, 0),
            confusable => confusable(effect),
            manoeuvre => effect.manoeuvre.as_str(),
        }
    };
    let group = |(i, effect): (usize, &Finding)| {
        let first = effect_row(effect, format!("/{list}/{i}"));
        let with = effect.with.iter().enumerate();
        let others = with.map(|(j, other)| effect_row(other, format!("/{list}/{i}/with/{j}")));
        std::iter::once(first).chain(others).collect::<Vec<_>>()
    };
    effects.iter().enumerate().flat_map(group).collect()
}

fn params(effect: &Finding, pointer: &str) -> Vec<Value> {
    let Some(entry) = entry(effect.name) else { return Vec::new() };
    let value_row = |e: &EffectParameterEstimate| {
        let param = entry.params.iter().find(|p| p.name == e.name)?;
        let place = format!("{pointer}/params/{}/value", e.name);
        Some(context! {
            effect => effect.name,
            name => e.name,
            about => param.about,
            value => Cell::new(with_error(e.value, e.stderr), e.value, place),
            interval => interval(e),
            unit => unit(e.unit).trim(),
            range => range(param, e.value),
            source => entry.source,
        })
    };
    effect.params.iter().filter_map(value_row).collect()
}

/// The range of a parameter, and whether the estimate was stopped by it.
fn range(param: &Param, value: f64) -> String {
    let room = 1e-3 * (param.high - param.low);
    let stopped = value < param.low + room || value > param.high - room;
    format!("{} to {}{}", param.low, param.high, if stopped { ": at its end" } else { "" })
}

/// The steps of the search. The effect that a step chose is in the next one.
pub(super) fn rounds(path: &[Step]) -> Vec<Value> {
    let round = |(i, step): (usize, &Step)| {
        let next = path.get(i + 1);
        let chosen = next.and_then(|n| n.effects.iter().find(|e| !step.effects.contains(e))).copied();
        let log = LogScale::spanning(
            step.ranking.iter().map(|r| r.gain).chain([LEAST_BAR]).filter(|g| *g >= LEAST_BAR),
        );
        let bar = |r: &RankedCandidate| {
            let length = if r.gain > LEAST_BAR { log.length(r.gain) } else { 0.0 };
            context!(name => r.name, gain => significant(r.gain, 3), length, chosen => chosen == Some(r.name))
        };
        let shown = step.ranking.iter().enumerate().filter(|(i, r)| *i < MAX_BARS || chosen == Some(r.name));
        context! {
            with => if step.effects.is_empty() { "the declared model".into() } else { step.effects.join(", ") },
            chosen => chosen.unwrap_or_default(),
            gained => next.filter(|_| chosen.is_some()).map_or_else(String::new, |n| number(n.gain, 0)),
            bars => shown.map(|(_, r)| bar(r)).collect::<Vec<_>>(),
        }
    };
    path.iter().enumerate().map(round).collect()
}

pub(super) fn disturbances(found: &Explanation) -> Vec<Value> {
    let [b, a] = &found.disturbances;
    let row = |what: &str, unit: &str, before: GaussMarkov, after: GaussMarkov| {
        let text = |w: GaussMarkov| match w.sigma {
            0.0 => "none".to_owned(),
            sigma => format!("{} {unit} for {} s", significant(sigma, 2), significant(w.tau_s, 2)),
        };
        context!(what, before => text(before), after => text(after))
    };
    vec![
        row("horizontal force", "m/s²", b.force, a.force),
        row("vertical force", "m/s²", b.lift, a.lift),
        row("torque on roll and pitch", "rad/s²", b.torque, a.torque),
        row("torque on yaw", "rad/s²", b.turn, a.turn),
        row("marker position", "m", b.marker, a.marker),
    ]
}

/// Returns the effects that the flights could not have shown, by the filter's slopes.
pub(super) fn hidden(found: &Explanation) -> Vec<Value> {
    let undetectable = |(name, stderr): (&'static str, f64)| {
        let (entry, param) = estimated_param(name)?;
        let range = format!("{} to {}{}", param.low, param.high, unit(param.unit));
        let stderr = format!("{}{}", significant(stderr, 2), unit(param.unit));
        Some(context!(name, about => entry.about, param => param.name, stderr, range))
    };
    not_excited(found).filter(|(_, stderr)| stderr.is_finite()).filter_map(undetectable).collect()
}

/// Effects without a slope at "off", such as a delay: only trial fits spoke for or against them.
pub(super) fn sloped_nowhere(found: &Explanation) -> String {
    let names: Vec<&str> =
        not_excited(found).filter(|(_, stderr)| !stderr.is_finite()).map(|(name, _)| name).collect();
    join_words(&names, "and")
}

/// Effects that the flights did not excite. Named effects are left out, whatever the first step of the search
/// found.
pub(super) fn not_excited(found: &Explanation) -> impl Iterator<Item = (&'static str, f64)> {
    let is_named = |name: &str| found.effects.iter().flat_map(Finding::all).any(|e| e.name == name);
    found.not_excited.iter().copied().filter(move |(name, _)| !is_named(name))
}

/// The parameter that a standard error is of: the first that is estimated.
pub(super) fn estimated_param(name: &str) -> Option<(&'static Entry, &'static Param)> {
    let entry = entry(name)?;
    Some((entry, entry.params.iter().find(|p| p.role == Role::Free)?))
}

pub(super) fn logs(run: &Run) -> Vec<Value> {
    let recording = |role: &'static str| {
        move |(source, flight): (&FlightSource, &Flight)| {
            context! {
                file => flight.name.as_str(),
                role,
                format => source.log.provenance.title(),
                duration => format!("{} s", number(flight.ticks as f64 * flight.tick_s, 1)),
                noise => noise(flight),
                notes => source.log.notes.iter().map(ToString::to_string).collect::<Vec<_>>(),
            }
        }
    };
    let fit = run.fit.with_sources().map(recording("fit"));
    fit.chain(run.test.with_sources().map(recording("test"))).collect()
}

fn noise(flight: &Flight) -> String {
    let three = |values: [f64; 3], one: f64| values.map(|v| significant(v / one, 2)).join(", ");
    let angles = three(flight.noise.att_rad, 1.0_f64.to_radians());
    format!("x, y, z {} mm; roll, pitch, yaw {angles} deg", three(flight.noise.pos_m, 1e-3))
}

pub(super) fn whiteness(white: &WhitenessFigure) -> Vec<Value> {
    let row = |(at, before, after): &(usize, Whiteness, Whiteness)| {
        context! {
            channel => channel(*at).0,
            before => number(before.beyond_percent, 0),
            after => number(after.beyond_percent, 0),
            size_before => number(before.size, 2),
            size_after => number(after.size, 2),
        }
    };
    white.rows.iter().map(row).collect()
}
