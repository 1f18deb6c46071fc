//! An account of a log: channels, gaps, clocks, signs, and for which command it suffices.

mod channels;
mod excitation;
mod findings;
mod needs;
mod signs;

use std::ops::Range;

use serde::Serialize;

use crate::signal::{gap_steps, usual_step};
use crate::{FlightLog, Note, Provenance, skew};

pub use channels::ChannelSummary;
pub use excitation::{CommandExcitation, Motion};
pub use findings::{Finding, Grade};
pub use needs::CommandRequirement;
pub(crate) use signs::is_angle_ratio;
pub use signs::{SignCheck, SignVerdict};

/// The analysis of a log without a model.
#[derive(Debug, Clone, Serialize)]
pub struct Inspection {
    /// The format in words.
    pub format: &'static str,
    /// Instruments behind the channels.
    pub provenance: Provenance,
    /// Number of rows.
    pub rows: usize,
    /// Time from the first row to the last.
    pub duration_s: f64,
    /// Usual number of rows per second.
    pub rate_hz: f64,
    /// Gaps between rows.
    pub gaps: Gaps,
    /// First and last second of the flight, on the log's clock; `None` if it never flies.
    pub airborne_s: Option<[f64; 2]>,
    /// Height of the vehicle at rest, see [`FlightLog::resting_height_m`].
    pub resting_height_m: Option<f64>,
    /// Delays between sets of channels.
    pub clocks: Clocks,
    /// Every channel of the log.
    pub channels: Vec<ChannelSummary>,
    /// Checks of signs; empty where the flight is too short.
    pub signs: Vec<SignCheck>,
    /// Size and speed of every command and motor in flight.
    pub commands: Vec<CommandExcitation>,
    /// Extent of the motion; `None` if the vehicle never flies.
    pub motion: Option<Motion>,
    /// Commands of the program, with what each lacks in this log.
    pub needs: Vec<CommandRequirement>,
    /// Problems and other findings, the gravest first.
    pub findings: Vec<Finding>,
}

/// Steps between rows that are longer than usual.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Gaps {
    /// Number of steps longer than 1.5 of the usual step.
    pub count: usize,
    /// Longest of them; 0 if there is none.
    pub longest_s: f64,
}

/// Clocks against each other: how much later one set of channels appears than another. `None` where nothing
/// moves enough.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Clocks {
    /// Gyro against the measured attitude: median, lowest and highest of the thirds of the flight.
    pub gyro_late_s: Option<[f64; 3]>,
    /// Position against the attitude, and its standard error.
    pub position_late_s: Option<[f64; 2]>,
}

impl Inspection {
    /// Looks at a log.
    pub fn from_log(log: &FlightLog) -> Self {
        let usual_s = usual_step(&log.t_s);
        let (count, longest_s) = gap_steps(&log.t_s);
        let findings = log.findings();
        Self {
            format: log.provenance.title(),
            provenance: log.provenance,
            rows: log.len(),
            duration_s: log.t_s.last().zip(log.t_s.first()).map_or(0.0, |(last, first)| last - first),
            rate_hz: if usual_s > 0.0 { 1.0 / usual_s } else { 0.0 },
            gaps: Gaps { count, longest_s },
            airborne_s: airborne_s(log),
            resting_height_m: log.resting_height_m(),
            clocks: clocks(log),
            channels: channels::summaries(log),
            signs: signs::checks(log),
            commands: excitation::commands(log),
            motion: excitation::motion(log),
            needs: needs::needs(log, &findings),
            findings,
        }
    }
}

/// First and last second of the flight; `None` if the vehicle never flies.
fn airborne_s(log: &FlightLog) -> Option<[f64; 2]> {
    let Range { start, end } = log.airborne;
    (start < end).then(|| [log.t_s[start], log.t_s[end - 1]])
}

fn clocks(log: &FlightLog) -> Clocks {
    let skew = |note: &Note| match note {
        Note::ClockSkew { median_s, lowest_s, highest_s } => Some([*median_s, *lowest_s, *highest_s]),
        _ => None,
    };
    let gyro_late_s = log.notes.iter().find_map(skew).or_else(|| {
        let [x, y, _] = log.gyro_radps.as_ref()?;
        let rates =
            skew::Rates { t_s: &log.t_s, angles_rad: [&log.roll_rad, &log.pitch_rad], gyro_radps: [x, y] };
        skew(&skew::estimate(&rates, &log.airborne))
    });
    let lag = log.position_lag();
    Clocks { gyro_late_s, position_late_s: lag.map(|lag| [lag.lag_s, lag.sigma_s]) }
}
