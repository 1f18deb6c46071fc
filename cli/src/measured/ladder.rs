//! The thesis model, its numbers fitted again, and effects one after the other.

use crazyflie_env::effects;
use crazyflie_env::model::Model;
use crazyflie_identify::explain::errors::{self, Errors};
use crazyflie_identify::fit::filter::Disturbances;
use crazyflie_identify::fit::flight::{Flight, Window};
use crazyflie_identify::fit::hypothesis::{Hypothesis, Term};
use crazyflie_identify::fit::output_error::OutputErrorProblem;
use crazyflie_identify::fit::solve::{ENOUGH, Solution, solve_within};

use super::force;

/// The numbers of the thesis model that the commands of these flights show.
const FREE: [&str; 9] = [
    "roll.gain",
    "roll.damping",
    "roll.stiffness",
    "pitch.gain",
    "pitch.damping",
    "pitch.stiffness",
    "vertical.thrust.hover",
    "vertical.thrust.heave",
    "lateral.drag",
];
/// Effects in the order in which they are tried: thrust, trim, then the others.
const EFFECTS: [&str; 7] =
    ["thrust_slope", "tilt_loss", "marker_tilt", "com_offset", "battery_sag", "drag_quadratic", "wind"];
const STEPS: usize = 40;
const STEPS_MORE: usize = 12;
/// A fall of the velocity error on the test flights that chance brings about less often is one.
const SIGNIFICANT: f64 = 0.05;
/// Standard errors that an effect must be from none on the flights of the fit.
const CLEAR: f64 = 2.0;

/// A fitted number.
pub(super) struct FittedValue {
    pub(super) name: String,
    pub(super) unit: String,
    pub(super) value: f64,
    /// Clustered by flight.
    pub(super) stderr: f64,
    pub(super) at_bound: bool,
}

/// One effect tried.
pub(super) struct EffectTrial {
    pub(super) effect: &'static str,
    pub(super) values: Vec<FittedValue>,
    /// On the test flights, without it and with it.
    pub(super) errors: Errors,
    pub(super) force_mps2: [f64; 2],
    pub(super) kept: bool,
}

pub(super) struct FitResult {
    pub(super) hypothesis: Hypothesis,
    pub(super) values: Vec<FittedValue>,
    own: Vec<Vec<f64>>,
}

/// Flights and windows of a fit.
pub(super) struct FitProblem<'a> {
    pub(super) flights: &'a [Flight],
    windows: Vec<Window>,
}

impl<'a> FitProblem<'a> {
    pub(super) fn new(flights: &'a [Flight], window_s: f64) -> Self {
        FitProblem {
            flights,
            windows: flights.iter().enumerate().flat_map(|(i, f)| f.windows(i, window_s)).collect(),
        }
    }

    /// Fits the numbers of the model again.
    pub(super) fn reidentify(&self, model: &Model, hover_pwm: f64) -> FitResult {
        let free = FREE.iter().map(|s| (*s).to_owned()).collect();
        let near = model.with_parameter("vertical.thrust.hover", hover_pwm).unwrap_or_else(|_| model.clone());
        self.solve(&Hypothesis { free, ..Hypothesis::from_model(&near) }, None, STEPS)
    }

    fn solve(&self, at: &Hypothesis, own: Option<&[Vec<f64>]>, steps: usize) -> FitResult {
        let prediction = OutputErrorProblem {
            flights: self.flights,
            windows: &self.windows,
            hypothesis: at,
            inflation: 1.0,
        };
        let own = own.map_or_else(|| prediction.measured_starts(), <[_]>::to_vec);
        let solution = solve_within(&prediction, own, at.free_values(), steps, ENOUGH);
        let values = self.values(at, &solution);
        FitResult { hypothesis: at.with_values(&solution.shared), values, own: solution.own }
    }

    fn values(&self, at: &Hypothesis, solution: &Solution) -> Vec<FittedValue> {
        let flight_of: Vec<usize> = self.windows.iter().map(|w| w.flight).collect();
        let covariance = solution.covariance(&flight_of);
        let known = at.model.parameters();
        let unit = |path: &String| known.iter().find(|(p, ..)| p == path).map_or("", |(_, _, unit)| *unit);
        let of_model = at.free.iter().map(|path| (path.clone(), unit(path).to_owned()));
        let of_terms = at.terms.iter().flat_map(|t| {
            t.free.iter().map(|i| {
                (format!("{}.{}", t.entry.name, t.entry.params[*i].name), t.entry.params[*i].unit.to_owned())
            })
        });
        let bounds = at.bounds();
        let value = |(i, (name, unit)): (usize, (String, String))| {
            let value = solution.shared[i];
            let stderr = covariance.as_ref().map_or(f64::INFINITY, |c| c[(i, i)].max(0.0).sqrt());
            let near = 1e-6 * (bounds[i][1] - bounds[i][0]);
            // "nothing" is where a drag or a share begins, and no failure to converge
            let at_bound =
                (value - bounds[i][1]).abs() < near || ((value - bounds[i][0]).abs() < near && value != 0.0);
            FittedValue { name, unit, value, stderr, at_bound }
        };
        of_model.chain(of_terms).enumerate().map(value).collect()
    }

    /// Tries every effect in turn. The test flights decide whether it is kept.
    pub(super) fn try_effects(
        &self,
        from: FitResult,
        test: &[Flight],
        d: &Disturbances,
        progress: &dyn Fn(&str),
    ) -> (FitResult, Vec<EffectTrial>) {
        let (mut now, mut effect_trials) = (from, Vec::new());
        for effect in EFFECTS {
            progress(&format!("with {effect}"));
            let Ok((_, entry)) = effects::find(effect) else { continue };
            let more = self.solve(&now.hypothesis.with(Term::off(entry)), Some(&now.own), STEPS_MORE);
            let errors = errors::compare_errors((&now.hypothesis, d, test), (&more.hypothesis, d, test));
            let force_mps2 = [&now, &more].map(|f| force::error(test, &f.hypothesis));
            let own = |v: &&FittedValue| v.name.starts_with(&format!("{effect}."));
            let values: Vec<FittedValue> = more.values.iter().filter(own).map(FittedValue::copy).collect();
            let off = |v: &FittedValue| {
                entry.params.iter().find(|p| v.name.ends_with(p.name)).map_or(0.0, |p| p.off)
            };
            let clear = values.iter().any(|v| (v.value - off(v)).abs() > CLEAR * v.stderr);
            let kept = clear && helps(&errors);
            effect_trials.push(EffectTrial { effect, values, errors, force_mps2, kept });
            if kept {
                now = more;
            }
        }
        (now, effect_trials)
    }
}

/// Whether the velocity errors 0.5 s and 2 s ahead fall, at least one of them by more than chance, and
/// neither rises.
fn helps(errors: &Errors) -> bool {
    let by_chance = |h: usize| errors.p_value[1][h] >= 0.5 * SIGNIFICANT;
    let falls = |h: usize| errors.after[1][h] < errors.before[1][h];
    let improves = |h: usize| falls(h) && !by_chance(h);
    let worse = |h: usize| !falls(h) && !by_chance(h);
    (improves(2) || improves(3)) && !worse(2) && !worse(3)
}

impl FittedValue {
    pub(super) fn copy(&self) -> FittedValue {
        FittedValue { name: self.name.clone(), unit: self.unit.clone(), ..*self }
    }
}
