//! Findings: what is wrong with a log or worth knowing of it, by weight, with the cure.

use std::fmt;

use serde::Serialize;

use super::signs::{self, SignVerdict, is_angle_ratio};
use super::{Inspection, SignCheck};
use crate::flight::LONGEST_GAP_S;
use crate::names::is_in;
use crate::quantity::DEG_RAD;
use crate::scale::CHANNELS;
use crate::signal::{gaps, usual_step};
use crate::{AttitudeSource, FlightLog, Note};

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Grade {
    /// Results would be wrong: commands refuse the log.
    Grave,
    /// Results may suffer.
    Warning,
    /// Good to know.
    Remark,
}

/// One finding.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Its weight.
    pub grade: Grade,
    /// The problem, and its place.
    pub text: String,
    /// Remedy; none if there is nothing to do.
    pub cure: Option<String>,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.cure {
            Some(cure) => write!(f, "{}; {cure}", self.text),
            None => f.write_str(&self.text),
        }
    }
}

/// Correlations below this contradict a sign beyond doubt; between this and "seen" another cause may move the
/// vehicle.
const CONTRADICTED: f64 = -0.5;
/// A response may seem to precede its command by rounding and interpolation.
const EARLY_S: f64 = -0.02;
/// Shares of rows that are lost.
const SOME_LOST: f64 = 0.01;
const MANY_LOST: f64 = 0.3;
/// A hole in a flight this long is worth its place.
const LONG_GAP_S: f64 = 0.3;
/// Rows beyond 90 degrees for a shorter time are outliers of a camera.
const SHORTEST_TURN_S: f64 = 0.1;
/// Share of the stamps that are out of order.
const MANY_STAMPS: f64 = 0.05;

impl FlightLog {
    /// Returns the problems of the log and other findings, the gravest first.
    pub fn findings(&self) -> Vec<Finding> {
        let mut all: Vec<Finding> = Vec::new();
        let over = turned_over(self);
        // beside a tumble every slope seems too steep
        let is_trusted =
            |check: &&SignCheck| over.is_none() || !check.unit_ratio().is_some_and(is_angle_ratio);
        for finding in signs::checks(self).iter().filter(is_trusted).filter_map(of_sign) {
            // roll and pitch in a wrong unit have one cure
            if finding.cure.is_none() || all.iter().all(|known| known.cure != finding.cure) {
                all.push(finding);
            }
        }
        all.extend(command_lag(self));
        all.extend(over);
        all.extend(lost_rows(self));
        all.extend(self.notes.iter().map(|note| of_note(note, self.len())));
        all.sort_by_key(|finding| finding.grade);
        all
    }
}

impl Inspection {
    /// The grave findings, for which commands refuse the log.
    pub fn grave(&self) -> impl Iterator<Item = &Finding> {
        self.findings.iter().filter(|finding| finding.grade == Grade::Grave)
    }
}

fn scale(channels: &[&str], factor: f64) -> String {
    let lines: Vec<String> = channels.iter().map(|name| format!("{name} = {factor}")).collect();
    format!("if so, mend it in a mapping file beside the log: [scale] {}", lines.join(", "))
}

/// A wrong sign or a wrong unit.
fn of_sign(check: &SignCheck) -> Option<Finding> {
    let SignCheck { expectation, channel, correlation, .. } = check;
    if check.verdict == SignVerdict::Contradicts {
        // A sagging battery and a tilted vehicle ask for thrust that lifts nothing.
        let (is_sure, suspect) = if *channel == "cmd_thrust" {
            (false, "its sign may be turned")
        } else {
            (*correlation < CONTRADICTED, "its sign is turned, or the axes are")
        };
        let grade = if is_sure { Grade::Grave } else { Grade::Warning };
        let text = format!(
            "{channel} contradicts the motion: \"{expectation}\" has the correlation {correlation:.2}; {suspect}"
        );
        let cure = is_in(CHANNELS, channel).then(|| scale(&[channel], -1.0));
        return Some(Finding { grade, text, cure });
    }
    let ratio = check.unit_ratio()?;
    let family: &[&str] = match *channel {
        "roll" | "pitch" => &["roll", "pitch", "yaw"],
        "cmd_roll" | "cmd_pitch" => &["cmd_roll", "cmd_pitch"],
        "gyro_x" | "gyro_y" | "gyro_z" => &["gyro_x", "gyro_y", "gyro_z"],
        other => &[other],
    };
    let (is_large, factor) = match ratio {
        _ if is_angle_ratio(ratio) => (false, 1.0 / DEG_RAD),
        _ if is_angle_ratio(1.0 / ratio) => (true, DEG_RAD),
        _ => return None,
    };
    let (size, mixed) =
        if is_large { ("large", "degrees read as radians") } else { ("small", "radians read as degrees") };
    let text = format!(
        "{channel} is about 57 times too {size} for the motion (\"{expectation}\": {ratio:.3} of the usual slope): {mixed}, degrees and radians are mixed"
    );
    Some(Finding { grade: Grade::Grave, text, cure: Some(scale(family, factor)) })
}

/// The response to the commands.
fn command_lag(log: &FlightLog) -> Option<Finding> {
    let lag = log.command_lag()?;
    let (lag_ms, sigma_ms) = (1e3 * lag.lag_s, 1e3 * lag.sigma_s);
    let is_early = lag.lag_s + 2.0 * lag.sigma_s < EARLY_S;
    let cure = "an answer before its command is two clocks: give the command a time column of its own in a mapping file";
    Some(Finding {
        grade: if is_early { Grade::Grave } else { Grade::Remark },
        text: format!("{}: the answer comes {lag_ms:.0} +- {sigma_ms:.0} ms after the command", lag.by),
        cure: is_early.then(|| cure.to_owned()),
    })
}

/// A vehicle that turns over: no model of small angles follows it.
fn turned_over(log: &FlightLog) -> Option<Finding> {
    if log.provenance.attitude == AttitudeSource::Motion {
        return None;
    }
    let is_over = |row: &usize| log.roll_rad[*row].cos() * log.pitch_rad[*row].cos() < 0.0;
    let over: Vec<usize> = log.airborne.clone().filter(is_over).collect();
    let mut stretches = over.chunk_by(|row, next| *next == row + 1);
    let is_long = |rows: &&[usize]| log.t_s[rows[rows.len() - 1]] - log.t_s[rows[0]] > SHORTEST_TURN_S;
    let rows = stretches.find(is_long)?;
    Some(Finding {
        grade: Grade::Grave,
        text: format!(
            "the vehicle turns over at {:.2} s: a crash or a flip, which no model of small angles follows",
            log.t_s[rows[0]]
        ),
        cure: Some("cut the log before it".to_owned()),
    })
}

/// Rows that are lost, and where.
fn lost_rows(log: &FlightLog) -> Vec<Finding> {
    // on the floor, lost rows harm nobody
    let rows = if log.airborne.is_empty() { 0..log.len() } else { log.airborne.clone() };
    let t_s = &log.t_s[rows];
    let usual_s = usual_step(t_s);
    let (Some(first_s), Some(last_s)) = (t_s.first(), t_s.last()) else { return Vec::new() };
    if usual_s <= 0.0 {
        return Vec::new();
    }
    let expected = (last_s - first_s) / usual_s + 1.0;
    let share = (1.0 - t_s.len() as f64 / expected).max(0.0);
    let mut all = Vec::new();
    if share > SOME_LOST {
        let grade = if share > MANY_LOST { Grade::Grave } else { Grade::Warning };
        let (lost, left) = (100.0 * share, t_s.len());
        let text =
            format!("{lost:.0} % of the rows in flight are lost: {left} of about {expected:.0} are there");
        let cure = (grade == Grade::Grave)
            .then(|| "log fewer variables or more slowly, so that packets arrive".to_owned());
        all.push(Finding { grade, text, cure });
    }
    let ends = [log.airborne.start.checked_sub(1), Some(log.airborne.end)]
        .map(|row| row.and_then(|row| log.t_s.get(row)));
    for (at_s, gap_s) in gaps(&log.t_s).filter(|(_, gap_s)| *gap_s > LONG_GAP_S).take(3) {
        let parts =
            gap_s > LONGEST_GAP_S && ends.iter().flatten().any(|end_s| (at_s..=at_s + gap_s).contains(end_s));
        let what = if parts { "; the flight is split there, and its longest part is used" } else { "" };
        let grade = if parts || (*first_s..*last_s).contains(&at_s) { Grade::Warning } else { Grade::Remark };
        let text = format!("a gap of {gap_s:.2} s in the rows from {at_s:.2} s on{what}");
        all.push(Finding { grade, text, cure: None });
    }
    all
}

/// A remark of the reader, by its weight.
fn of_note(note: &Note, rows: usize) -> Finding {
    let grade = match note {
        Note::StampsOutOfOrder { count, .. } if *count as f64 > MANY_STAMPS * rows as f64 => Grade::Warning,
        Note::CutShort { .. }
        | Note::DamagedDatabase { .. }
        | Note::WrongChecksum
        | Note::TruncatedGzip
        | Note::RaggedRows { .. }
        | Note::Flights { .. }
        | Note::NeverAirborne { .. }
        | Note::NoPosition
        | Note::CaptureDrift { .. }
        | Note::UpsideDown { .. } => Grade::Warning,
        _ => Grade::Remark,
    };
    Finding { grade, text: note.to_string(), cure: None }
}
