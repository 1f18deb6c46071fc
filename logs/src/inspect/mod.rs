//! An account of a log: channels, gaps, clocks, signs, and for which command it suffices.

mod channels;
mod excitation;
mod needs;
mod signs;

use serde::Serialize;

use crate::signal::{gap_steps, usual_step};
use crate::{FlightLog, Note, Provenance, skew};

pub use channels::ChannelSummary;
pub use excitation::{CommandExcitation, Motion};
pub use needs::CommandRequirement;
pub use signs::{SignCheck, SignVerdict};

/// Everything that can be said of a log without a model.
#[derive(Debug, Clone, Serialize)]
pub struct Inspection {
    /// The format in words.
    pub format: &'static str,
    pub provenance: Provenance,
    pub rows: usize,
    pub duration_s: f64,
    /// Usual number of rows per second.
    pub rate_hz: f64,
    pub gaps: Gaps,
    /// First and last second of the flight, on the log's clock; `None` if it never flies.
    pub airborne_s: Option<[f64; 2]>,
    pub resting_height_m: Option<f64>,
    pub clocks: Clocks,
    pub channels: Vec<ChannelSummary>,
    pub signs: Vec<SignCheck>,
    pub commands: Vec<CommandExcitation>,
    pub motion: Option<Motion>,
    pub needs: Vec<CommandRequirement>,
    /// The reader's remarks, in words.
    pub notes: Vec<String>,
}

/// Steps between rows that are longer than usual.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Gaps {
    pub count: usize,
    pub longest_s: f64,
}

/// Clocks against each other: how much later one set of channels appears than another. `None` where nothing moves enough.
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
        let ends = [log.airborne.start, log.airborne.end.saturating_sub(1)];
        Self {
            format: log.provenance.title(),
            provenance: log.provenance,
            rows: log.len(),
            duration_s: log.t_s.last().zip(log.t_s.first()).map_or(0.0, |(last, first)| last - first),
            rate_hz: if usual_s > 0.0 { 1.0 / usual_s } else { 0.0 },
            gaps: Gaps { count, longest_s },
            airborne_s: (!log.airborne.is_empty()).then(|| ends.map(|row| log.t_s[row])),
            resting_height_m: log.resting_height_m(),
            clocks: clocks(log),
            channels: channels::summaries(log),
            signs: signs::checks(log),
            commands: excitation::commands(log),
            motion: excitation::motion(log),
            needs: needs::needs(log),
            notes: log.notes.iter().map(ToString::to_string).collect(),
        }
    }
}

fn clocks(log: &FlightLog) -> Clocks {
    let noted = log.notes.iter().find_map(|note| match note {
        Note::ClockSkew { median_s, lowest_s, highest_s } => Some([*median_s, *lowest_s, *highest_s]),
        _ => None,
    });
    let gyro_late_s = noted.or_else(|| {
        let [x, y, _] = log.gyro_radps.as_ref()?;
        let rates = skew::Rates { t_s: &log.t_s, angles_rad: [&log.roll_rad, &log.pitch_rad], gyro_radps: [x, y] };
        match skew::estimate(&rates, &log.airborne) {
            Note::ClockSkew { median_s, lowest_s, highest_s } => Some([median_s, lowest_s, highest_s]),
            _ => None,
        }
    });
    let lag = log.position_lag();
    Clocks { gyro_late_s, position_late_s: lag.map(|lag| [lag.lag_s, lag.sigma_s]) }
}
