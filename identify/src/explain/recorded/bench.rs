//! Recorded flights as a bench for hypotheses. The fit runs in windows that start where the flight was
//! measured, with the nuisance parameters of each flight. Predictions of stretches that were left out of the
//! fit judge it.

use std::ops::Range;

use rayon::prelude::*;

use super::gain::Gain;
use crate::axis_errors::{AxisErrors, HORIZONS_S, stretch_errors};
use crate::explain::calibration::recorded::{
    FLIGHTS_TO_LEAVE_OUT, FLIGHTS_TO_TEST, FOLDS, STEPS, STEPS_TO_CONVERGE, STEPS_TO_PROPOSE,
    STEPS_WITHOUT_A_FOLD, STRETCH_WINDOWS, WINDOWS_TO_PROPOSE,
};
use crate::fit::flight::{Flight, WINDOW_S, Window};
use crate::fit::hypothesis::{Hypothesis, Term};
use crate::fit::output_error::OutputErrorProblem;
use crate::fit::solve::{ENOUGH, Solution, solve_within};
use crate::vehicle::{self, SETTLE_S};

/// A stretch of a flight that is predicted by a fit that has not seen it.
struct HeldOutStretch {
    flight: usize,
    ticks: Range<usize>,
    fold: usize,
}

/// A hypothesis fitted to windows.
#[derive(Clone)]
pub struct FittedHypothesis {
    /// At the numbers that all flights share.
    pub hypothesis: Hypothesis,
    /// All free numbers as each flight has them.
    pub each: Vec<Vec<f64>>,
    pub solution: Solution,
}

/// Flights of a fit, their windows, and what is left out of them in turn.
pub struct Bench {
    pub flights: Vec<Flight>,
    pub windows: Vec<Window>,
    /// Fold of each window.
    folds: Vec<usize>,
    stretches: Vec<HeldOutStretch>,
    /// Whole flights are left out, so what each has of its own is found anew from its start.
    by_flight: bool,
}

impl Bench {
    pub fn new(flights: Vec<Flight>) -> Self {
        let by_flight = flights.len() >= FLIGHTS_TO_LEAVE_OUT;
        let (mut windows, mut folds, mut stretches) = (Vec::new(), Vec::new(), Vec::new());
        for (i, flight) in flights.iter().enumerate() {
            let own = flight.windows(i, WINDOW_S);
            let settled = (SETTLE_S / flight.tick_s).round() as usize;
            // few flights are too few for a test over flights: their stretches take their place
            let length = if flights.len() < FLIGHTS_TO_TEST { STRETCH_WINDOWS } else { own.len() };
            for (k, part) in own.chunks(length).enumerate() {
                let fold = if by_flight { i } else { k } % FOLDS;
                folds.extend(part.iter().map(|_| fold));
                let first = part[0].ticks.start.max(if by_flight { settled } else { 0 });
                let end = part[part.len() - 1].ticks.end;
                stretches.push(HeldOutStretch { flight: i, ticks: first.min(end)..end, fold });
            }
            windows.extend(own);
        }
        // a prediction has to end within its stretch
        let long_enough =
            |s: &HeldOutStretch| s.ticks.len() as f64 * flights[s.flight].tick_s > HORIZONS_S[1] + WINDOW_S;
        stretches.retain(long_enough);
        Bench { flights, windows, folds, stretches, by_flight }
    }

    /// The hypothesis at a solution over all windows.
    pub fn apply_solution(&self, hypothesis: &Hypothesis, solution: Solution) -> FittedHypothesis {
        let problem = OutputErrorProblem::new(&self.flights, &self.windows, hypothesis);
        let each = problem.each_flight(&solution.shared);
        let hypothesis =
            each.first().map_or_else(|| hypothesis.clone(), |numbers| hypothesis.with_values(numbers));
        FittedHypothesis { hypothesis, each, solution }
    }

    /// A hypothesis fitted to all windows, from the numbers of another that shares some of them.
    pub fn fit(&self, hypothesis: &Hypothesis, from: &FittedHypothesis) -> FittedHypothesis {
        self.fit_windows(hypothesis, from, &|_| true, STEPS)
    }

    /// And until no step gains enough.
    pub fn converge(&self, fitted: &FittedHypothesis) -> FittedHypothesis {
        self.fit_windows(&fitted.hypothesis, fitted, &|_| true, STEPS_TO_CONVERGE)
    }

    /// And so roughly that it only proposes: few steps on some of the windows.
    pub fn propose(&self, hypothesis: &Hypothesis, from: &FittedHypothesis) -> FittedHypothesis {
        let every = self.windows.len().div_ceil(WINDOWS_TO_PROPOSE).max(1);
        self.fit_windows(hypothesis, from, &|w| w % every == 0, STEPS_TO_PROPOSE)
    }

    fn fit_windows(
        &self,
        hypothesis: &Hypothesis,
        from: &FittedHypothesis,
        takes: &dyn Fn(usize) -> bool,
        steps: usize,
    ) -> FittedHypothesis {
        let taken = (0..self.windows.len()).filter(|w| takes(*w));
        let windows: Vec<Window> = taken.map(|w| self.windows[w].clone()).collect();
        let problem = OutputErrorProblem::new(&self.flights, &windows, hypothesis);
        let each: Vec<Vec<f64>> =
            from.each.iter().map(|numbers| carry_over(&from.hypothesis, numbers, hypothesis)).collect();
        let starts = problem.measured_starts();
        let known = from.solution.own.iter().enumerate().filter(|(w, _)| takes(*w)).map(|(_, own)| own);
        // starts of the same hypothesis without one of its lags have another length
        let same = from.solution.own.len() == self.windows.len()
            && from.solution.own.first().map(Vec::len) == starts.first().map(Vec::len);
        let own = if same { known.cloned().collect() } else { starts };
        let solution = solve_within(&problem, own, problem.join_flights(&each), steps, ENOUGH);
        self.apply_solution(hypothesis, solution)
    }

    /// Errors on every stretch, predicted by a fit of all that is not in its fold. `None` where the
    /// hypothesis cannot be simulated.
    pub fn held_out_errors(&self, fitted: &FittedHypothesis) -> Option<Vec<AxisErrors>> {
        let without = |fold: usize| {
            self.fit_windows(&fitted.hypothesis, fitted, &|w| self.folds[w] != fold, STEPS_WITHOUT_A_FOLD)
        };
        self.errors_by_fold(&(0..FOLDS).into_par_iter().map(without).collect::<Vec<_>>())
    }

    /// Errors on every stretch by a fit of all.
    pub fn errors_as_fitted(&self, fitted: &FittedHypothesis) -> Option<Vec<AxisErrors>> {
        self.errors_by_fold(&vec![fitted.clone(); FOLDS])
    }

    fn errors_by_fold(&self, folds: &[FittedHypothesis]) -> Option<Vec<AxisErrors>> {
        let errors = |stretch: &HeldOutStretch| {
            let (fold_fit, flight) = (&folds[stretch.fold], &self.flights[stretch.flight]);
            let own = if self.by_flight && fold_fit.hypothesis.per_flight().iter().any(Option::is_some) {
                vehicle::fit_on_start(&vehicle::open_per_flight(&fold_fit.hypothesis), flight)
            } else {
                fold_fit.hypothesis.with_values(&fold_fit.each[stretch.flight]).without_free()
            };
            stretch_errors(&own, flight, stretch.ticks.clone())
        };
        self.stretches.par_iter().map(errors).collect()
    }

    /// Gain of a hypothesis over the errors of another.
    pub fn gain(&self, fitted: &FittedHypothesis, before: &[AxisErrors]) -> Option<Gain> {
        Some(Gain::new(before, &self.held_out_errors(fitted)?))
    }

    /// Standard errors of the free numbers that all flights share, by how much flights, or windows of few
    /// flights, contradict each other.
    pub fn standard_errors(&self, fitted: &FittedHypothesis) -> Vec<f64> {
        let cluster = |(i, window): (usize, &Window)| if self.by_flight { window.flight } else { i };
        let clusters: Vec<usize> = self.windows.iter().enumerate().map(cluster).collect();
        let Some(covariance) = fitted.solution.covariance(&clusters) else { return Vec::new() };
        (0..covariance.nrows()).map(|i| covariance[(i, i)].max(0.0).sqrt()).collect()
    }
}

/// The free numbers of one flight under a hypothesis, put in the places of another; what is new there stays
/// as the other has it.
fn carry_over(from: &Hypothesis, numbers: &[f64], to: &Hypothesis) -> Vec<f64> {
    let mut all = to.free_values();
    for (slot, path) in all.iter_mut().zip(&to.free) {
        if let Some(i) = from.free.iter().position(|known| known == path) {
            *slot = numbers[i];
        }
    }
    let known =
        |term: &Term| from.terms.iter().any(|t| t.entry.name == term.entry.name && t.free == term.free);
    for term in to.terms.iter().filter(|term| known(term)) {
        let (source, target) = (from.place(term.entry.name), to.place(term.entry.name));
        all[target].copy_from_slice(&numbers[source]);
    }
    all
}

/// Places of the free parameters of an effect among the shared numbers.
pub fn shared_range(hypothesis: &Hypothesis, effect: &str) -> Range<usize> {
    let before = hypothesis.terms.iter().take_while(|t| t.entry.name != effect);
    let before: usize = before.filter(|t| t.per_flight.is_none()).map(|t| t.free.len()).sum();
    let own = hypothesis.term(effect).map_or(0, |t| t.free.len());
    let first = hypothesis.free.len() + before;
    first..first + own
}
