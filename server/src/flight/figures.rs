//! The figures of a flight: how fast, how far over, how exact, with how much effort.

use crazyflie_control::Mode;
use crazyflie_env::vector::state_index;
use crazyflie_statistics::rms;
use serde::{Serialize, Serializer};
use serde_json::json;

use super::{AIRBORNE_M, FlightEnd, Phase, Trace, TraceRow, touch_down_mps};

/// Settled within this of the set-point, for positions and for the heading.
const BAND_M: f64 = 0.05;
const BAND_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;
/// The final error is the mean of the last second.
const FINAL_S: f64 = 1.0;
/// The floor at over 1.5 m/s is a crash, as in the tasks.
const CRASH_MPS: f64 = 1.5;

/// One controlled axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisSpec {
    /// Symbol of the axis: x, y, z or yaw.
    pub name: &'static str,
    /// Unit for people of errors, and how many make one SI unit.
    pub unit: &'static str,
    /// Factor from metres or radians to `unit`.
    pub per_si: f64,
    state: usize,
    setpoint: usize,
    band: f64,
}

const DEG: f64 = 180.0 / std::f64::consts::PI;

/// Controlled axes, in the order of [`PhaseFigures::axes`].
pub const AXES: [AxisSpec; 4] = [
    AxisSpec { name: "x", unit: "cm", per_si: 100.0, state: 0, setpoint: 16, band: BAND_M },
    AxisSpec { name: "y", unit: "cm", per_si: 100.0, state: 1, setpoint: 17, band: BAND_M },
    AxisSpec { name: "z", unit: "cm", per_si: 100.0, state: 2, setpoint: 18, band: BAND_M },
    AxisSpec { name: "yaw", unit: "deg", per_si: DEG, state: 8, setpoint: 19, band: BAND_RAD },
];

/// One axis over one phase, SI and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisFigures {
    /// Time from the start of the phase until the error stays within the band; `None` where it does not, or the
    /// set-point moves.
    pub settled_s: Option<f64>,
    /// Beyond the set-point, seen from the start; from a start at the set-point the largest deviation. `None` where
    /// the set-point moves.
    pub overshoot: Option<f64>,
    /// Root mean square of the error.
    pub rmse: f64,
    /// Mean magnitude of the error over the last second.
    pub final_error: f64,
    /// Root mean square of the command that controls the axis: degrees of pitch for x, of roll for y, percent of the
    /// hover PWM about it (or cm about the set-point) for z, deg/s for yaw. If actions are set-points, that of the
    /// axis itself.
    pub effort: f64,
    /// Travel of that command per second.
    pub travel_per_s: f64,
}

/// Figures of one phase.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PhaseFigures {
    /// Title of the phase, as planned.
    pub name: String,
    /// Time of its first row in the air, from the start of the flight.
    pub from_s: f64,
    /// Time of its last row, from the start of the flight.
    pub to_s: f64,
    /// Figures of x, y, z and yaw.
    #[serde(serialize_with = "by_axis")]
    pub axes: [AxisFigures; 4],
}

/// A touch-down.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TouchDown {
    /// Time from the start of the flight.
    pub t_s: f64,
    /// Sinking speed.
    pub mps: f64,
}

/// Figures of one flight.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Phases that the flight reached, in order.
    pub phases: Vec<PhaseFigures>,
    /// Reason that the flight ended.
    #[serde(skip)]
    pub end: FlightEnd,
    /// Cause of a crash or of leaving the room, if any.
    pub crash: Option<String>,
    /// Sum of the rewards.
    pub reward: f64,
    /// Time of the last row.
    pub end_s: f64,
    /// Number of times that the marker was lost, and the time without it in all.
    pub marker_losses: usize,
    /// Time without the marker, over all losses.
    pub marker_lost_s: f64,
    /// The height at the end of a flight that was to land and did not.
    pub not_landed_m: Option<f64>,
    /// Time and sinking speed of the last touch-down after flying.
    pub touch_down: Option<TouchDown>,
}

/// Returns the cause of a crash or of leaving the room.
fn crash(end: FlightEnd) -> Option<String> {
    match end {
        FlightEnd::LeftRoom => Some("left the room".into()),
        FlightEnd::Floor { impact_mps } if impact_mps > CRASH_MPS => {
            Some(format!("hit the floor at {impact_mps:.1} m/s"))
        }
        _ => None,
    }
}

/// By name, in the units that people read.
fn by_axis<S: Serializer>(all: &[AxisFigures; 4], serializer: S) -> Result<S::Ok, S::Error> {
    let shown = |(axis, f): (&AxisSpec, &AxisFigures)| {
        let [rmse, final_error] = [f.rmse, f.final_error].map(|si| si * axis.per_si);
        let overshoot = f.overshoot.map(|si| si * axis.per_si);
        let told = json!({"unit": axis.unit, "settled_s": f.settled_s, "overshoot": overshoot, "rmse": rmse,
            "final_error": final_error, "effort_rms": f.effort, "travel_per_s": f.travel_per_s});
        (axis.name, told)
    };
    serializer.collect_map(AXES.iter().zip(all).map(shown))
}

/// Measures a flight, phase by phase as `planned`.
pub fn figures(planned: &[Phase], trace: &Trace) -> Figures {
    let rows = &trace.rows;
    let valid: Vec<bool> = rows.iter().map(TraceRow::sees_marker).collect();
    let lost = valid.iter().filter(|valid| !**valid).count();
    let touched = (1..rows.len())
        .rev()
        .find(|&i| rows[i].state[state_index::HEIGHT] <= 0.0 && rows[i - 1].state[state_index::HEIGHT] > 0.0);
    let starts: Vec<usize> = planned.iter().map(|p| (p.from_s / trace.tick_s).round() as usize).collect();
    let mut phases = Vec::new();
    for (i, phase) in planned.iter().enumerate() {
        let end = starts.get(i + 1).copied().unwrap_or(rows.len()).min(rows.len());
        let first = lift_off(&rows[..end], starts[i]);
        if first < end {
            let axes = AXES.map(|axis| axis_figures(trace, &axis, first, end));
            phases.push(PhaseFigures {
                name: phase.name.to_string(),
                from_s: trace.t_s(first),
                to_s: trace.t_s(end - 1),
                axes,
            });
        }
    }
    Figures {
        phases,
        end: trace.end,
        crash: crash(trace.end),
        reward: trace.reward,
        end_s: trace.t_s(rows.len().saturating_sub(1)),
        marker_losses: valid.windows(2).filter(|pair| pair[0] && !pair[1]).count(),
        marker_lost_s: lost as f64 * trace.tick_s,
        not_landed_m: height_if_not_landed(planned, trace),
        touch_down: touched.map(|i| TouchDown { t_s: trace.t_s(i), mps: touch_down_mps(rows, i) }),
    }
}

/// The height of a vehicle that is still in the air though the last phase is a landing.
fn height_if_not_landed(planned: &[Phase], trace: &Trace) -> Option<f64> {
    let landing = planned.last().is_some_and(|phase| phase.mode == Mode::Landing);
    let height = trace.rows.last().map(|row| f64::from(row.state[state_index::HEIGHT]));
    height.filter(|z| landing && trace.end == FlightEnd::Time && *z > 0.0)
}

/// The first row from `start` on in which the vehicle is in the air, from where time counts; `start` if it
/// never is.
fn lift_off(rows: &[TraceRow], start: usize) -> usize {
    (start..rows.len()).find(|&i| rows[i].state[state_index::HEIGHT] > AIRBORNE_M).unwrap_or(start)
}

fn axis_figures(trace: &Trace, axis: &AxisSpec, first: usize, end: usize) -> AxisFigures {
    let rows = &trace.rows[first..end];
    let setpoint = |row: &TraceRow| f64::from(row.observation[axis.setpoint]);
    let errors: Vec<f64> =
        rows.iter().map(|row| wrap(axis, f64::from(row.state[axis.state]) - setpoint(row))).collect();
    let moving = rows.iter().any(|row| (setpoint(row) - setpoint(&rows[0])).abs() > 1e-6);
    let last = (FINAL_S / trace.tick_s).round() as usize;
    let tail = &errors[errors.len().saturating_sub(last.max(1))..];
    let commands: Vec<f64> = (first..end).map(|row| effort(trace, axis, row)).collect();
    let travel: f64 = commands.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum();
    AxisFigures {
        settled_s: (!moving).then(|| settled_s(&errors, axis.band, trace.tick_s)).flatten(),
        overshoot: (!moving).then(|| overshoot(&errors, axis.band)),
        rmse: rms(&errors).unwrap_or(0.0),
        final_error: tail.iter().map(|e| e.abs()).sum::<f64>() / tail.len() as f64,
        effort: rms(&commands).unwrap_or(0.0),
        travel_per_s: travel / ((end - first) as f64 * trace.tick_s),
    }
}

/// A heading error is the short way round.
fn wrap(axis: &AxisSpec, error: f64) -> f64 {
    if axis.state == 8 { error.sin().atan2(error.cos()) } else { error }
}

fn settled_s(errors: &[f64], band: f64, tick_s: f64) -> Option<f64> {
    match errors.iter().rposition(|e| e.abs() > band) {
        None => Some(0.0),
        Some(last) if last + 1 == errors.len() => None,
        Some(last) => Some((last + 1) as f64 * tick_s),
    }
}

fn overshoot(errors: &[f64], band: f64) -> f64 {
    let start = errors[0];
    let beyond = |e: &f64| if start.abs() > band { -e * start.signum() } else { e.abs() };
    errors.iter().map(beyond).fold(0.0, f64::max)
}

/// The command that serves an axis, see [`AxisFigures::effort`].
fn effort(trace: &Trace, axis: &AxisSpec, row: usize) -> f64 {
    let Some(u) = trace.command(row) else {
        // set-points are in the order of the axes
        let set_point = trace.interface.set_point(&trace.rows[row].action.map(f64::from));
        return AXES.iter().position(|known| known == axis).map_or(0.0, |i| set_point[i]);
    };
    let hover = trace.interface.hover_lift;
    match axis.name {
        "x" => u.pitch_rad.to_degrees(),
        "y" => u.roll_rad.to_degrees(),
        "z" if hover > 0.0 => 100.0 * (u.lift / hover - 1.0),
        "z" => 100.0 * (u.lift - f64::from(trace.rows[row].observation[axis.setpoint])),
        _ => u.yaw_rate_radps.to_degrees(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settling_is_the_last_time_outside() {
        let errors = [1.0, 0.5, -0.2, 0.04, -0.06, 0.01, 0.0];
        assert_eq!(settled_s(&errors, 0.05, 0.5), Some(2.5));
        assert_eq!(settled_s(&errors[..2], 0.05, 0.5), None);
        assert_eq!(settled_s(&[0.0, 0.01], 0.05, 0.5), Some(0.0));
    }

    #[test]
    fn overshoot_is_beyond_the_set_point_seen_from_the_start() {
        assert_eq!(overshoot(&[-1.0, -0.5, 0.2, -0.1], 0.05), 0.2);
        assert_eq!(overshoot(&[1.0, 0.5, 0.2], 0.05), 0.0);
        assert_eq!(overshoot(&[0.0, 0.1, -0.3], 0.05), 0.3);
    }
}
