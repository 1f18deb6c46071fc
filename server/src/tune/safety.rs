//! Decides whether gains may be written: with the required margins, and through a take-off, on every vertical form of
//! the model.

use std::collections::BTreeMap;

use crate::flight::{FlightEnd, FlightScenario, Trace, TraceRow, fly};
use crazyflie_control::loop_analysis::{LoopAxis, Margins};
use crazyflie_control::pid::Gains;
use crazyflie_env::Error;
use crazyflie_env::model::{Model, Vertical, VerticalInput};
use crazyflie_env::observation::index;
use crazyflie_env::vector::state_index;

use super::TuningSetup;

/// Within this of its height a take-off is over: the thesis's band of 5 cm, and as much again for the noise of the
/// lab's camera, which all 16 flights have to tolerate.
const BAND_M: f64 = 0.1;
/// It has to stay there for this long at the end of the flight.
const HELD_S: f64 = 3.0;
/// Cost of a metre that the end of a take-off is off its height by, in seconds of error.
const UNSETTLED_S_PER_M: f64 = 100.0;
/// Cost of an overshoot as high as the climb.
const OVERSHOOT_S: f64 = 4.0;
/// Cost of a flight that ended early.
const CRASH_S: f64 = 50.0;

/// Figures of the take-offs on one form: the worst over the seeds.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Takeoff {
    /// Time until every flight stays within 10 cm of its height.
    pub settling_s: Option<f64>,
    /// Height above the set-point, the largest.
    pub overshoot_m: f64,
    /// Distance from the height in the last three seconds, the largest.
    pub final_error_m: f64,
    /// Flights that crashed or left the room.
    pub crashed: usize,
    /// Flights in all.
    pub flights: usize,
    /// Time integral of the absolute error, the mean over the flights.
    pub mean_error_m_s: f64,
}

impl Takeoff {
    /// Returns the cost, in seconds of error of a climb to 70 cm.
    pub(super) fn error_s(&self) -> f64 {
        let unsettled = (self.final_error_m - 0.5 * BAND_M).clamp(0.0, 1.0);
        self.mean_error_m_s / CLIMB_M
            + UNSETTLED_S_PER_M * unsettled
            + OVERSHOOT_S * self.overshoot_m.min(1.0) / CLIMB_M
            + CRASH_S * self.crashed as f64 / self.flights.max(1) as f64
    }
}

/// Height of the take-off.
const CLIMB_M: f64 = 0.7;

/// Gains on one vertical form.
#[derive(Debug, Clone, serde::Serialize)]
pub struct FormCheck {
    /// The form.
    pub vertical: VerticalInput,
    /// Margins of the loops that fly on it.
    pub margins: BTreeMap<LoopAxis, Margins>,
    /// Its take-offs.
    pub takeoff: Takeoff,
    /// Reasons not to fly these gains; none if they pass.
    pub problems: Vec<String>,
}

/// Judges gains on every vertical form of the model.
///
/// # Errors
/// Those of the flights.
pub fn check_forms(tuning: &TuningSetup<'_>, gains: &Gains) -> Result<Vec<FormCheck>, Error> {
    let mut forms = tuning.model.inputs();
    if !forms.contains(&tuning.vertical) {
        forms.push(tuning.vertical);
    }
    forms.into_iter().map(|vertical| check(&tuning.on_form(vertical), gains)).collect()
}

fn check(tuning: &TuningSetup<'_>, gains: &Gains) -> Result<FormCheck, Error> {
    let (vertical, requirements) = (tuning.vertical, &tuning.requirements);
    let loops = LoopAxis::ALL.into_iter().filter(|axis| vertical.is_pwm() || *axis != LoopAxis::Z);
    let margins: BTreeMap<LoopAxis, Margins> =
        loops.map(|axis| Ok((axis, tuning.margins(gains, axis)?))).collect::<Result<_, Error>>()?;
    let takeoff = tuning.takeoff(gains)?;
    let mut problems: Vec<String> = margins
        .iter()
        .filter(|(_, m)| requirements.missing(m) != [0.0; 2])
        .map(|(axis, m)| {
            format!(
                "the loop {} has {:.1} degrees of phase margin and {:.1} dB of gain margin, expected {} and {} at least",
                axis.name(),
                m.phase_deg,
                m.gain_db,
                requirements.phase_deg,
                requirements.gain_db
            )
        })
        .collect();
    if takeoff.crashed > 0 {
        problems.push(format!("{} of {} take-offs crash", takeoff.crashed, takeoff.flights));
    } else if takeoff.settling_s.is_none() {
        problems.push(format!(
            "a take-off does not settle: {:.0} cm off its height in the last {HELD_S:.0} s",
            100.0 * takeoff.final_error_m
        ));
    }
    Ok(FormCheck { vertical, margins, takeoff, problems })
}

impl TuningSetup<'_> {
    /// Take-offs to 70 cm, one for each seed.
    ///
    /// # Errors
    /// Those of the flight.
    pub(super) fn takeoff(&self, gains: &Gains) -> Result<Takeoff, Error> {
        let setup = self.setup(gains, FlightScenario::find("takeoff-70cm")?)?;
        Ok(figures(&fly(&setup, &self.seeds)?, setup.seconds))
    }
}

fn figures(traces: &[Trace], seconds: f64) -> Takeoff {
    let mut worst = Takeoff {
        settling_s: Some(0.0),
        overshoot_m: 0.0,
        final_error_m: 0.0,
        crashed: 0,
        flights: traces.len(),
        mean_error_m_s: 0.0,
    };
    for trace in traces {
        let error_m = |row: &TraceRow| row.state[state_index::HEIGHT] - row.observation[index::SETPOINT_Z];
        let errors: Vec<f64> = trace.rows.iter().map(|row| f64::from(error_m(row))).collect();
        let last = errors.last().copied().unwrap_or(0.0).abs();
        let flown_s = errors.len() as f64 * trace.tick_s;
        worst.mean_error_m_s += (errors.iter().map(|e| e.abs()).sum::<f64>() * trace.tick_s
            + last * (seconds - flown_s).max(0.0))
            / traces.len() as f64;
        worst.overshoot_m = errors.iter().copied().fold(worst.overshoot_m, f64::max);
        let tail = errors.len().saturating_sub((HELD_S / trace.tick_s).round() as usize);
        worst.final_error_m = errors[tail..].iter().map(|e| e.abs()).fold(worst.final_error_m, f64::max);
        worst.crashed += usize::from(trace.end != FlightEnd::Time);
        let settled = errors.iter().rposition(|e| e.abs() > BAND_M).map_or(0, |row| row + 1);
        let held = trace.end == FlightEnd::Time && settled <= tail;
        let at_s = held.then(|| trace.t_s(settled));
        worst.settling_s = worst.settling_s.zip(at_s).map(|(a, b)| a.max(b));
    }
    worst
}

/// Returns warnings about what the model's forms cannot show.
pub fn warnings(model: &Model) -> Vec<String> {
    let forms: Vec<VerticalInput> = model.inputs().into_iter().filter(|input| input.is_pwm()).collect();
    if forms.is_empty() {
        return vec![
            "the model has no form that a thrust commands: the gains of z are table 7.1's, and no flight tests them"
                .into(),
        ];
    }
    let has_inertia =
        |input: &VerticalInput| !matches!(model.vertical(*input), Ok(Vertical::FirstOrder { .. }));
    if forms.iter().any(has_inertia) {
        return Vec::new();
    }
    let names: Vec<String> = forms.iter().map(|input| format!("vertical.{}", input.name())).collect();
    vec![format!(
        "{} is of first order: without inertia hardly any height gain is too high for it. Give the model a thrust form, \
         so that the height loop is judged on a body with inertia",
        names.join(" and ")
    )]
}
