//! Next step: the flight or the log channel that would settle what these flights leave open.

use crazyflie_identify::FlightLog;
use crazyflie_identify::explain::errors::{LEAST_STRETCHES, STRETCH_S};
use crazyflie_identify::explain::signals::{HORIZONS, Signal, SignalState, SignalVerdict, main_signal};
use crazyflie_identify::explain::verdict::{Finding, Verdict};
use crazyflie_logs::inspect::Inspection;
use serde::Serialize;

use super::words::{join_words, with_unit};
use super::{Run, confusable, foreign_sentence};

/// One thing to do, and the commands for it, where there are any.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct NextStep {
    /// The signal that it is about.
    pub signal: Option<Signal>,
    pub text: String,
    pub commands: Vec<String>,
}

impl NextStep {
    fn new(signal: Option<Signal>, text: String) -> Self {
        NextStep { signal, text, commands: Vec::new() }
    }
}

/// Everything to do, the most urgent first.
pub(crate) fn next_steps(run: &Run) -> Vec<NextStep> {
    let mut steps = Vec::new();
    if let Some(foreign) = run.foreign_model() {
        let text = foreign_sentence(run, &foreign);
        steps.push(NextStep { commands: foreign.commands.to_vec(), ..NextStep::new(None, text) });
    }
    let of_signal = |verdict: &SignalVerdict| {
        next_of_signal(run, verdict).map(|text| NextStep::new(Some(verdict.signal), text))
    };
    steps.extend(run.found.signals.iter().filter_map(of_signal));
    steps.extend(more_test_flight(run).map(|text| NextStep::new(None, text)));
    if run.found.verdict == Verdict::NotDecidable {
        let text = "Fly each of the four signals harder, one after the other: these flights do not identify the missing effect.";
        steps.push(NextStep::new(None, text.into()));
    }
    if steps.is_empty() {
        let text = "Nothing is open on these flights. Test the model on a flight of another kind: faster, higher, or in other air.";
        steps.push(NextStep::new(None, text.into()));
    }
    steps
}

/// Names of the channels of all logs.
pub(super) fn channels<'a>(logs: impl Iterator<Item = &'a FlightLog>) -> Vec<&'static str> {
    logs.flat_map(|log| Inspection::from_log(log).channels).map(|channel| channel.name).collect()
}

/// The next manoeuvre or log channel for a signal; `None` where nothing is open.
pub(super) fn next_of_signal(run: &Run, verdict: &SignalVerdict) -> Option<String> {
    let signal = verdict.signal;
    let rivals = run.found.effects.iter().flat_map(Finding::all);
    let rivals = rivals.filter(|e| main_signal(e) == signal && !e.confusable_with.is_empty());
    let mut all: Vec<String> =
        rivals.map(|e| format!("To tell {} from {}: {}.", e.name, confusable(e), e.manoeuvre)).collect();
    if matches!(verdict.state, SignalState::PartlyExplained | SignalState::Unexplained) {
        all.push(format!("Fly {}.", manoeuvre(signal)));
        all.extend(missing_channels(&run.channels, signal));
    } else if verdict.state == SignalState::NotTested {
        all.push(test_needed(verdict));
    }
    (!all.is_empty()).then(|| all.join(" "))
}

/// The flight that shows most of what can be missing in a signal.
fn manoeuvre(signal: Signal) -> &'static str {
    match signal {
        Signal::Sideways => {
            "straight legs of 2 m along x and along y at 0.5 and at 1.5 m/s, at two headings 90 degrees apart, then the same legs half a metre aside"
        }
        Signal::Vertical => {
            "climbs and descents of 1 m at 0.3 and at 1 m/s, with 5 s of hover between, on a full and on a nearly empty battery"
        }
        Signal::Tilt => "doublets of 2 and of 8 degrees on roll, then on pitch, with 2 s of hover between",
        Signal::Yaw => "yaw-rate steps of 30 and of 90 deg/s to both sides in hover, one full turn each",
    }
}

/// A channel by the reader's name, the firmware's variables, and its use.
type Channel = (&'static str, &'static str, &'static str);

const MOTORS: Channel = ("motor_1", "motor.m1 to motor.m4", "what the motors were asked for");
const ROTORS: Channel = ("rotor_1", "rpm.m1 to rpm.m4", "whether motors or air make the difference");
const GYRO: Channel = ("gyro_x", "gyro.x, gyro.y and gyro.z", "body rates, which differences of angles blur");
const FORCE: Channel =
    ("acc_x", "acc.x, acc.y and acc.z", "a push on the body, apart from an error of the attitude");
const VOLTAGE: Channel = ("vbat", "pm.vbat", "a sagging battery, which looks like lost thrust");
const TURN_COMMAND: Channel = ("cmd_yaw_rate", "the yaw-rate command", "what the yaw was asked for");

/// Returns channels that would show more of a signal and that no log has.
fn missing_channels(logged: &[&str], signal: Signal) -> Option<String> {
    let wanted: &[Channel] = match signal {
        Signal::Sideways => &[FORCE, MOTORS],
        Signal::Vertical => &[VOLTAGE, ROTORS, FORCE],
        Signal::Tilt => &[GYRO, MOTORS, ROTORS],
        Signal::Yaw => &[TURN_COMMAND, GYRO, MOTORS],
    };
    let lacks = wanted.iter().filter(|(name, ..)| !logged.contains(name));
    let named: Vec<String> = lacks.map(|(_, variables, tells)| format!("{variables} ({tells})")).collect();
    (!named.is_empty()).then(|| format!("Log {}.", join_words(&named, "and")))
}

/// The flight that would test a signal in which nothing was found: one that moves, or a longer one.
fn test_needed(verdict: &SignalVerdict) -> String {
    let signal = verdict.signal;
    if verdict.no_model[1] < signal.least_motion() {
        let size = with_unit(verdict.no_model[1], verdict.unit);
        return format!("It changed by {size} within 2 s in the test flights: fly {}.", manoeuvre(signal));
    }
    let stretches = LEAST_STRETCHES.max(verdict.stretches + 1);
    format!("Test on {stretches} stretches of {STRETCH_S} s or more, with {}.", manoeuvre(signal))
}

/// That the test flights are too short to test the longer predictions.
fn more_test_flight(run: &Run) -> Option<String> {
    let stretches = &run.found.errors.axes.stretches;
    let fewest = stretches.iter().flat_map(|row| HORIZONS.map(|h| row[h])).min()?;
    let lacking = LEAST_STRETCHES.checked_sub(fewest).filter(|lacking| *lacking > 0)?;
    Some(format!(
        "Fly at least {} s more for --test: predictions 2 s ahead are compared on {fewest} stretches of {STRETCH_S} s, and a test needs {LEAST_STRETCHES}.",
        lacking as f64 * STRETCH_S
    ))
}
