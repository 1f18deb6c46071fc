//! The declared model completed with the findings, and its errors on the test flights.

use crazyflie_env::effects::{Entry, Observability, registry};

use super::calibration::completion::{CHANCE, HELPS, MATTERS, MOST, OUTWEIGHS, WORSE, WORSE_UNTESTED};
use super::errors::{ErrorTable, Errors, LEAST_STRETCHES, PredictionSetup, compare_errors};
use super::finding::NamedEffects;
use super::search::FilteredHypothesis;
use super::signals::{self, HORIZONS};
use super::verdict::{Finding, Leftover};
use crate::fit::filter::Disturbances;
use crate::fit::flight::Flight;
use crate::fit::hypothesis::{Hypothesis, Term};

/// Rows of the errors by axis that nothing may make worse: velocity sideways and up, and tilt.
const JUDGED_AXES: [usize; 3] = [2, 3, 4];

/// A model with effects, their disturbances, and errors before and after.
pub struct Completion {
    pub effects: Vec<Finding>,
    pub partial: Vec<Finding>,
    /// No causes of their own, see [`Hypothesis::is_cause`].
    pub corrections: Vec<Finding>,
    pub hypothesis: Hypothesis,
    pub disturbances: Disturbances,
    pub errors: Errors,
}

impl Completion {
    /// Withdraws the names whose own signal still has structure, unless they explain most of its error or far
    /// outweigh the rest. Effects that lower the errors stay in the model, as a description and not as a cause.
    pub fn withdraw(mut self, declared: &FilteredHypothesis, leftover: &[Leftover], test: &[Flight]) -> Self {
        let stands = |effect: &Finding| {
            let signal = signals::main_signal(effect);
            let share = signals::explained_share(&self.errors, signal).into_iter().fold(0.0, f64::max);
            let outweighs = |structure: f64| effect.worth_test > OUTWEIGHS.get() * structure;
            signals::structure_worth(leftover, signal).is_none_or(outweighs) || share > MOST.get()
        };
        let (kept, withdrawn): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.effects).into_iter().partition(stands);
        if withdrawn.is_empty() {
            return Completion { effects: kept, ..self };
        }
        let (all, h) = (&self.errors.quantities, HORIZONS[1]);
        if (0..2).any(|q| all.after[q][h] < (1.0 - HELPS.get()) * all.before[q][h]) {
            return Completion { effects: kept, partial: withdrawn, ..self };
        }
        self.hypothesis.terms.retain(|t| has(&kept, t) || has(&self.corrections, t) || t.is_description());
        self.errors = errors_beside(declared, (&self.hypothesis, &self.disturbances, test));
        Completion { effects: kept, ..self }
    }

    /// Without what makes any axis worse, one effect at a time: first the one without which the worst axis is
    /// best.
    pub fn without_harm(mut self, declared: &FilteredHypothesis, test: &[Flight]) -> Self {
        while worst_harm(&self.errors.axes, MATTERS.get()) > 0.0 {
            let names: Vec<&'static str> = self.hypothesis.terms.iter().map(|t| t.entry.name).collect();
            let without = |name: &&str| {
                let less = self.hypothesis.without(name);
                let errors = errors_beside(declared, (&less, &self.disturbances, test));
                (worst_harm(&errors.axes, MATTERS.get()), less, errors)
            };
            let Some((_, hypothesis, errors)) = names.iter().map(without).min_by(|a, b| a.0.total_cmp(&b.0))
            else {
                break;
            };
            let stays = |e: &Finding| e.all().all(|e| hypothesis.has(e.name) || !names.contains(&e.name));
            [&mut self.effects, &mut self.partial, &mut self.corrections]
                .into_iter()
                .for_each(|list| list.retain(stays));
            (self.hypothesis, self.errors) = (hypothesis, errors);
        }
        if self.hypothesis.terms.is_empty() && self.effects.is_empty() {
            // nothing was found: other disturbances alone would change where predictions start
            self.disturbances = declared.disturbances;
            self.errors = errors_beside(declared, (&self.hypothesis, &self.disturbances, test));
        }
        self
    }

    /// The same with its errors on other flights.
    pub fn evaluate_on(self, declared: &FilteredHypothesis, test: &[Flight]) -> Self {
        Completion { errors: errors_beside(declared, (&self.hypothesis, &self.disturbances, test)), ..self }
    }

    /// The model to fly: effects that were named but are random, and so no part of what was fitted, belong to
    /// it too.
    pub fn with_random_effects(&self) -> Hypothesis {
        let mut all = self.hypothesis.clone();
        let is_random = |e: &&Entry| matches!(e.observability, Observability::GaussMarkov(_));
        for entry in registry().iter().filter(is_random) {
            let Some(effect) = self.effects.iter().find(|effect| effect.name == entry.name) else { continue };
            let mut term = Term::without_free(entry);
            term.values.iter_mut().zip(&effect.params).for_each(|(value, estimate)| *value = estimate.value);
            all = all.with(term);
        }
        all
    }
}

/// Completes the model, by its predictions of the flights that choose: names are withdrawn whose signal has
/// structure, then effects that make an axis worse. Also whether the question stays open.
pub fn complete(
    declared: &FilteredHypothesis,
    last: &FilteredHypothesis,
    leftover: &[Leftover],
    named: NamedEffects,
    choosing: &[Flight],
) -> (Completion, bool) {
    let NamedEffects { effects, corrections, disturbances, undecided } = named;
    let mut hypothesis = last.at_posterior();
    hypothesis.terms.retain(|t| has(&effects, t) || has(&corrections, t) || t.is_description());
    let errors = errors_beside(declared, (&hypothesis, &disturbances, choosing));
    let completed =
        Completion { effects, partial: Vec::new(), corrections, hypothesis, disturbances, errors };
    let completed = completed.withdraw(declared, leftover, choosing);
    let names_before = completed.effects.len();
    let completed = completed.without_harm(declared, choosing);
    // an effect that earned its place and yet makes predictions worse leaves the question open
    let undecided = undecided || completed.effects.len() < names_before;
    (completed, undecided)
}

/// Returns whether a term is one of the findings.
fn has(findings: &[Finding], term: &Term) -> bool {
    findings.iter().flat_map(Finding::all).any(|e| e.name == term.entry.name)
}

/// Returns the growth of the error of the worst axis, as a share of that error. 0 if none grew beyond chance, or by
/// more than `matters`: a share of the error of a constant state.
pub fn worst_harm(axes: &ErrorTable<6>, matters: f64) -> f64 {
    let counts = |(row, h): &(usize, usize)| {
        axes.after[*row][*h] - axes.before[*row][*h] > matters * axes.naive[*row][*h]
    };
    let cells = JUDGED_AXES.iter().flat_map(|row| HORIZONS.iter().map(|h| (*row, *h))).filter(counts);
    let grown = cells.filter_map(|(row, h)| {
        let share = axes.after[row][h] / axes.before[row][h] - 1.0;
        // a declared model that errs more than none at all has nothing there to lose but by a lot
        let predicts = axes.before[row][h] < axes.naive[row][h];
        let is_tested = predicts && axes.stretches[row][h] >= LEAST_STRETCHES;
        let is_worse =
            if is_tested { axes.p_value[row][h] < CHANCE && share > WORSE } else { share > WORSE_UNTESTED };
        is_worse.then_some(share)
    });
    grown.fold(0.0, f64::max)
}

fn errors_beside(declared: &FilteredHypothesis, after: PredictionSetup) -> Errors {
    compare_errors((&declared.hypothesis, &declared.disturbances, after.2), after)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_that_no_model_predicts_better_forbids_an_effect_only_by_a_fifth() {
        let harm = |after: f64, naive: f64| {
            let [before, after, naive, p_value] = [1.0, after, naive, 1e-6].map(|error| [[error; 5]; 6]);
            worst_harm(&ErrorTable { before, after, naive, p_value, stretches: [[28; 5]; 6] }, 0.005)
        };
        assert!((harm(1.03, 2.0) - 0.03).abs() < 1e-12);
        assert_eq!(harm(1.03, 0.5), 0.0);
        assert!((harm(1.3, 0.5) - 0.3).abs() < 1e-12);
    }
}
