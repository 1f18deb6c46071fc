//! The verdict on each signal as people read it: how much is explained, what is left by axis, what to do
//! next.

use crazyflie_identify::explain::errors::{COMPONENTS, HORIZONS, STRETCH_S};
use crazyflie_identify::explain::signals::{
    HORIZONS as JUDGED, Signal, SignalState, SignalVerdict, is_negligible, main_signal,
};
use crazyflie_identify::explain::verdict::{Explanation, Finding, Leftover};
use crazyflie_identify::fit::filter::GaussMarkov;
use serde::Serialize;

use super::Run;
use super::error_view::p_value;
use super::json::component_key;
use super::next::next_of_signal;
use super::view::Cell;
use super::words::{join_words, percent, significant, with_unit};

/// The verdict on a signal, in words.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct SignalRow {
    pub name: &'static str,
    pub state: &'static str,
    /// The same for style sheets.
    class: SignalState,
    /// Effects that are named in it.
    pub effects: String,
    /// Effects that lower its error and account for nothing.
    pub lowered_by: String,
    /// Share of the error explained, 0.5 s and 2 s ahead.
    pub explained: [Cell; 2],
    /// p values of these.
    pub sure: [String; 2],
    /// Power of the test, in words.
    pub test: String,
    /// Nothing was to be explained: the errors are negligible, before and after.
    pub is_negligible: bool,
    /// Errors that are left, one per axis.
    left: Vec<RemainingError>,
    /// Disturbances that still push or turn the vehicle, whatever the commands.
    pub shaken: String,
    /// Structure that is left: the strongest finding of each axis.
    pub structure: Vec<String>,
    pub next: Option<String>,
}

/// The error that is left in one axis.
#[derive(Debug, Clone, Serialize)]
struct RemainingError {
    axis: &'static str,
    size: Cell,
    unit: &'static str,
    ahead: &'static str,
}

impl SignalRow {
    /// Remaining errors by axis and size, in one phrase.
    pub(crate) fn left_line(&self) -> String {
        let phrase = |l: &RemainingError| format!("{} ±{} {}", l.axis, l.size.text(), l.unit);
        let axes = self.left.iter().map(phrase).collect::<Vec<_>>().join(", ");
        let ahead = self.left.first().map_or("", |l| l.ahead);
        format!("{axes} {ahead} ahead; {}", self.shaken)
    }
}

/// All signals.
pub(crate) fn signal_rows(run: &Run) -> Vec<SignalRow> {
    let signal_row = |(i, verdict): (usize, &SignalVerdict)| {
        let errors = &run.found.errors.axes;
        let row = verdict.signal.error_row();
        let names = |effects: &[Finding]| {
            let own = effects.iter().filter(|e| main_signal(e) == verdict.signal).flat_map(Finding::all);
            join_words(&own.map(|e| e.name).collect::<Vec<_>>(), "and")
        };
        SignalRow {
            name: name(verdict.signal),
            state: state(verdict.state),
            class: verdict.state,
            effects: names(&run.found.effects),
            lowered_by: names(&run.found.partial),
            explained: [0, 1].map(|h| {
                let share = verdict.explained_share[h];
                Cell::new(percent(share), share, format!("/signals/{i}/explained_share/{h}"))
            }),
            sure: JUDGED.map(|h| p_value(errors.p_value[row][h], errors.stretches[row][h])),
            test: test_line(verdict),
            is_negligible: is_negligible(&run.found.errors, verdict.signal),
            left: axes_left(&run.found, i, verdict.signal),
            shaken: shaken(&run.found, verdict.signal),
            structure: structure(&run.found, verdict.signal),
            next: next_of_signal(run, verdict),
        }
    };
    run.found.signals.iter().enumerate().map(signal_row).collect()
}

fn name(signal: Signal) -> &'static str {
    match signal {
        Signal::Sideways => "sideways (x, y)",
        Signal::Vertical => "vertical (z)",
        Signal::Tilt => "tilt (roll, pitch)",
        Signal::Yaw => "yaw",
    }
}

fn state(state: SignalState) -> &'static str {
    match state {
        SignalState::NothingMissing => "nothing missing",
        SignalState::Explained => "explained",
        SignalState::PartlyExplained => "explained in part",
        SignalState::Unexplained => "unexplained",
        SignalState::NotTested => "not tested",
    }
}

/// Power of the test of a signal, and the errors beside those of no model and of a refit.
fn test_line(verdict: &SignalVerdict) -> String {
    let plural = if verdict.stretches == 1 { "" } else { "es" };
    let stretches = format!("{} stretch{plural} of {STRETCH_S} s", verdict.stretches);
    let size = verdict.detectable.map_or_else(
        || "too few to find anything".to_owned(),
        |size| format!("an effect is found from {} 2 s ahead on", with_unit(size, verdict.unit)),
    );
    let refit = verdict
        .over_refit
        .map(|[_, ratio]| format!("; {} times the error of its numbers fitted anew", significant(ratio, 2)));
    let [error, no_model] = [verdict.error[1], verdict.no_model[1]].map(|size| with_unit(size, verdict.unit));
    let errs = format!("errs by {error} 2 s ahead, without a model {no_model}");
    format!("{stretches}: {size}; {errs}{}", refit.unwrap_or_default())
}

/// Component and horizon of the errors that are left in a signal: as far ahead as the flights go.
pub(super) fn left_cells(found: &Explanation, signal: Signal) -> Vec<(usize, usize)> {
    let after = &found.errors.components.after;
    let farthest =
        |row: usize| JUDGED.into_iter().rev().find(|h| after[row][*h].is_finite()).unwrap_or(JUDGED[1]);
    signal.components().map(|row| (row, farthest(row))).collect()
}

fn axes_left(found: &Explanation, place: usize, signal: Signal) -> Vec<RemainingError> {
    let remaining_error = |(row, h): (usize, usize)| {
        let (name, unit) = COMPONENTS[row];
        let (unit, of_unit) = if unit == "rad" { ("deg", 1.0_f64.to_radians()) } else { (unit, 1.0) };
        let error = found.errors.components.after[row][h];
        let pointer = format!("/signals/{place}/left_by_axis/{}/{}", component_key(row), HORIZONS[h]);
        let ahead = if h == JUDGED[1] { "2 s" } else { "0.5 s" };
        RemainingError {
            axis: name.trim_end_matches(" velocity"),
            size: Cell::new(significant(error / of_unit, 2), error, pointer),
            unit,
            ahead,
        }
    };
    left_cells(found, signal).into_iter().map(remaining_error).collect()
}

fn shaken(found: &Explanation, signal: Signal) -> String {
    let [_, after] = &found.disturbances;
    let say = |does: &str, by: GaussMarkov, unit: &str| match by.sigma {
        0.0 => format!("not {does}"),
        sigma => {
            let [sigma, tau_s] = [sigma, by.tau_s].map(|size| significant(size, 2));
            format!("still {does} by ±{sigma} {unit} for {tau_s} s at a time")
        }
    };
    match signal {
        Signal::Sideways => say("pushed", after.force, "m/s²"),
        Signal::Vertical => say("pushed", after.lift, "m/s²"),
        Signal::Tilt => say("shaken", after.torque, "rad/s²"),
        Signal::Yaw => say("turned", after.turn, "rad/s²"),
    }
}

/// The strongest finding of each axis or disturbance of a signal.
fn structure(found: &Explanation, signal: Signal) -> Vec<String> {
    let mut strongest: Vec<&Leftover> = Vec::new();
    for leftover in found.leftover.iter().filter(|l| l.part == signal && l.is_structure()) {
        match strongest.iter_mut().find(|other| other.signal == leftover.signal) {
            Some(other) if other.size.abs() >= leftover.size.abs() => {}
            Some(other) => *other = leftover,
            None => strongest.push(leftover),
        }
    }
    strongest.into_iter().map(|l| format!("{}: {}", l.signal, l.finding)).collect()
}
