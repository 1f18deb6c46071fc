//! The declared model completed with what was found, and what that is worth on the test flights.

use crazyflie_env::effects::{Trace, registry};

use super::errors::{self, Errors};
use super::learn;
use super::search::{Judged, Search};
use super::signals::{self, HORIZONS};
use super::verdict::{Finding, Leftover};
use crate::fit::filter::Disturbances;
use crate::fit::flight::Flight;
use crate::fit::hypothesis::{Hypothesis, Term};

/// Effects that do not account for the structure are kept beside it if they lower the 2 s errors of position or velocity on the test flights by this share.
const HELPS: f64 = 0.05;
/// Beside structure in its own signal, an effect stays named if the named effects explain this share of the signal's error.
const MOST: f64 = 0.5;

/// A model with effects, their disturbances, and errors before and after.
pub struct Completion {
    pub effects: Vec<Finding>,
    pub partial: Vec<Finding>,
    pub learned: bool,
    pub hypothesis: Hypothesis,
    pub disturbances: Disturbances,
    pub errors: Errors,
}

impl Completion {
    pub fn new(declared: &Judged, last: &Judged, effects: Vec<Finding>, disturbances: Disturbances, test: &[Flight]) -> Self {
        let mut hypothesis = last.settled();
        hypothesis.terms.retain(|t| effects.iter().flat_map(Finding::all).any(|e| e.name == t.entry.name));
        let errors = errors_beside(declared, &hypothesis, &disturbances, test);
        Completion { effects, partial: Vec::new(), learned: false, hypothesis, disturbances, errors }
    }

    /// Without the names whose own signal still holds structure, unless they explain most of its error. What lowers the errors stays in the model, as a
    /// description and not as a cause.
    pub fn withdraw(mut self, declared: &Judged, leftover: &[Leftover], test: &[Flight]) -> Self {
        let stands = |effect: &Finding| {
            let signal = signals::main_signal(effect);
            let share = signals::explained_share(&self.errors, signal).into_iter().fold(0.0, f64::max);
            !signals::is_structured(leftover, signal) || share > MOST
        };
        let (kept, withdrawn): (Vec<Finding>, Vec<Finding>) = std::mem::take(&mut self.effects).into_iter().partition(stands);
        if withdrawn.is_empty() {
            return Completion { effects: kept, ..self };
        }
        if (0..2).any(|q| self.errors.after[q][HORIZONS[1]] < (1.0 - HELPS) * self.errors.before[q][HORIZONS[1]]) {
            return Completion { effects: kept, partial: withdrawn, ..self };
        }
        self.hypothesis.terms.retain(|t| kept.iter().flat_map(Finding::all).any(|e| e.name == t.entry.name));
        self.errors = errors_beside(declared, &self.hypothesis, &self.disturbances, test);
        Completion { effects: kept, ..self }
    }

    /// With a term learned from the residual, if it lowers the 2 s errors on the test flights.
    pub fn learned(self, search: &Search, judge: &Search, last: &Judged, declared: &Judged, test: &[Flight]) -> Self {
        let described = search.refit(&self.hypothesis, &last.disturbances).and_then(|named| learn::learn(search, judge, &named));
        let Some(described) = described else { return self };
        let (hypothesis, disturbances) = (described.settled(), described.disturbances);
        let errors = errors_beside(declared, &hypothesis, &disturbances, test);
        let better = errors.after[0][3] < (1.0 - HELPS) * self.errors.after[0][3] && errors.after[1][3] < self.errors.after[1][3];
        if better { Completion { learned: true, hypothesis, disturbances, errors, ..self } } else { self }
    }

    /// The model to fly: effects that were named but are random, and so no part of what was fitted, belong to it too.
    pub fn with_random(&self) -> Hypothesis {
        let mut all = self.hypothesis.clone();
        for effect in &self.effects {
            let Some(entry) = registry().iter().find(|e| e.name == effect.name && matches!(e.trace, Trace::Wander(_))) else { continue };
            let mut term = Term::off(entry);
            for (slot, estimate) in term.values.iter_mut().zip(&effect.params) {
                *slot = estimate.value;
            }
            term.free.clear();
            all = all.with(term);
        }
        all
    }
}

fn errors_beside(declared: &Judged, hypothesis: &Hypothesis, disturbances: &Disturbances, test: &[Flight]) -> Errors {
    errors::compare((&declared.hypothesis, &declared.disturbances), (hypothesis, disturbances), test)
}
