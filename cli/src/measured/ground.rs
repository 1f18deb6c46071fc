//! Seconds near the floor: does the thrust grow there?

use crazyflie_env::effects;
use crazyflie_identify::fit::flight::{Flight, Window};
use crazyflie_identify::fit::hypothesis::{Hypothesis, Term};
use crazyflie_identify::fit::output_error::OutputErrorProblem;
use crazyflie_identify::fit::solve::{ENOUGH, Solution, solve_within};

use super::ladder::FittedValue;

/// The vehicle flies lower than this in the first and the last seconds only.
const LOW_M: f64 = 0.3;
const WINDOW_S: f64 = 0.5;
const STEPS: usize = 15;
/// A standing vehicle is 29 mm high (Bitcraze's data sheet, with feet), its rotors on top; the marker frame
/// then is at 55 mm in these files.
pub(super) const ROTORS_FROM_MARKER_M: f64 = 0.029 - 0.055;
/// Effects of the floor, and effects that look like them.
const CANDIDATES: [&str; 4] = ["ground_effect", "ground_effect_exp", "tilt_loss", "drag_linear"];

pub(super) struct GroundCandidate {
    pub(super) effect: &'static str,
    pub(super) value: FittedValue,
    /// The value at which it does nothing.
    pub(super) off: f64,
    /// Share of the loss that it saves on the low windows of the fit and of the test flights.
    pub(super) gain_fit: f64,
    pub(super) gain_test: f64,
}

pub(super) struct GroundStudy {
    pub(super) windows: [usize; 2],
    pub(super) candidates: Vec<GroundCandidate>,
}

/// Each rival beside the completed model, whose thrust may differ there.
pub(super) fn ground(completed: &Hypothesis, fit: &[Flight], test: &[Flight]) -> Option<GroundStudy> {
    let (low, low_test) = (low_windows(fit), low_windows(test));
    let mut base = Hypothesis {
        free: vec!["vertical.thrust.hover".into(), "vertical.thrust.heave".into()],
        ..completed.without_free()
    };
    if let Some(slope) = base.terms.iter_mut().find(|t| t.entry.name == "thrust_slope") {
        slope.free = vec![0];
    }
    let calm = solve(&base, fit, &low);
    let settled = base.with_values(&calm.shared).without_free();
    let calm_test = solve(&settled, test, &low_test).loss;
    let mut candidates = Vec::new();
    for effect in CANDIDATES.iter().filter(|e| !completed.has(e)) {
        let (_, entry) = effects::find(effect).ok()?;
        let mut term = Term::off(entry);
        term.free.truncate(1);
        if let Some(at) = entry.params.iter().position(|p| p.name == "rotor_height_m") {
            term.values[at] = ROTORS_FROM_MARKER_M;
        }
        let with = base.with(term);
        let solution = solve(&with, fit, &low);
        let flight_of: Vec<usize> = low.iter().map(|w| w.flight).collect();
        let covariance = solution.covariance(&flight_of);
        let i = with.place(effect).start;
        let [least, max] = with.bounds()[i];
        let value = FittedValue {
            name: format!("{effect}.{}", entry.params[0].name),
            unit: entry.params[0].unit.to_owned(),
            value: solution.shared[i],
            stderr: covariance.map_or(f64::INFINITY, |c| c[(i, i)].max(0.0).sqrt()),
            at_bound: solution.shared[i] <= least || solution.shared[i] >= max,
        };
        let gain_test =
            1.0 - solve(&with.with_values(&solution.shared).without_free(), test, &low_test).loss / calm_test;
        candidates.push(GroundCandidate {
            effect,
            value,
            off: entry.params[0].off,
            gain_fit: 1.0 - solution.loss / calm.loss,
            gain_test,
        });
    }
    Some(GroundStudy { windows: [low.len(), low_test.len()], candidates })
}

fn solve(at: &Hypothesis, flights: &[Flight], windows: &[Window]) -> Solution {
    let prediction = OutputErrorProblem { flights, windows, hypothesis: at, inflation: 1.0 };
    solve_within(&prediction, prediction.measured_starts(), at.free_values(), STEPS, ENOUGH)
}

/// Windows that begin or end near the floor.
fn low_windows(flights: &[Flight]) -> Vec<Window> {
    let windows_near_floor = |(i, flight): (usize, &Flight)| {
        let low = |tick: usize| flight.measured_state(tick).pos_m[2] < LOW_M;
        let near = move |w: &Window| low(w.ticks.start) || low(w.ticks.end - 1);
        flight.windows(i, WINDOW_S).into_iter().filter(near).collect::<Vec<_>>()
    };
    flights.iter().enumerate().flat_map(windows_near_floor).collect()
}
