//! The last stage: a verdict, and the explanation that carries it.

use super::completion::Completion;
use super::errors::{Errors, LEAST_STRETCHES};
use super::finding;
use super::residual::Residual;
use super::search::FilteredHypothesis;
use super::signals::{self, Evidence, SignalEvidence, SignalState, SignalVerdict};
use super::verdict::{Explanation, Finding, Step, Verdict};
use crate::fit::hypothesis::Term;

/// The verdict by the signals, what is named, and whether the question stays open otherwise.
pub(super) fn verdict(signals: &[SignalVerdict], effects: &[Finding], open: bool) -> Verdict {
    let any = |states: [SignalState; 2]| signals.iter().any(|s| states.contains(&s.state));
    let is_left = any([SignalState::PartlyExplained, SignalState::Unexplained]);
    match (is_left, effects.is_empty()) {
        // the exact geometry is a form of the model, and no cause of what is left beside it
        (true, _) if effects.iter().all(finding::is_model_form) => Verdict::Unexplained,
        (true, _) => Verdict::PartlyExplained,
        (false, false) => Verdict::Explained,
        (false, true) if open || any([SignalState::NotTested; 2]) => Verdict::NotDecidable,
        (false, true) => Verdict::NothingMissing,
    }
}

/// The explanation; `steps` are those of the search, `seconds` what it took.
pub fn conclude(
    declared: &FilteredHypothesis,
    (completed, undecided): (Completion, bool),
    residual: Residual,
    steps: Vec<Step>,
    seconds: f64,
) -> Explanation {
    let evidence = SignalEvidence {
        kind: Evidence::Likelihood,
        errors: &completed.errors,
        refitted: None,
        disturbances: &completed.disturbances,
        leftover: &residual.leftover,
    };
    let is_named = |signal| completed.effects.iter().any(|e| signals::main_signal(e) == signal);
    let signals = evidence.verdicts(is_named, |_| false);
    let explanation = Explanation {
        verdict: verdict(&signals, &completed.effects, undecided),
        completed: completed.with_random_effects(),
        signals,
        effects: completed.effects,
        confirmed: Vec::new(),
        needless: Vec::new(),
        withdrawn: Vec::new(),
        numbers: Vec::new(),
        foreign: false,
        partial: completed.partial,
        corrections: completed.corrections,
        learned: completed.hypothesis.terms.iter().any(Term::is_description),
        disturbances: [declared.disturbances, completed.disturbances],
        declared: declared.hypothesis.clone(),
        not_excited: finding::not_excited(&steps),
        path: steps,
        leftover: residual.leftover,
        errors: completed.errors,
        seconds,
    };
    explanation.into_reported()
}

impl Explanation {
    /// Returns the explanation without tests of too few stretches, and with the values of the completed model, which
    /// a term that was learned later may have moved.
    pub(super) fn into_reported(mut self) -> Self {
        let Errors { quantities, axes, .. } = &mut self.errors;
        let rows = quantities.p_value.iter_mut().zip(&quantities.stretches);
        let rows = rows.chain(axes.p_value.iter_mut().zip(&axes.stretches));
        let cells = rows.flat_map(|(p_values, stretches)| p_values.iter_mut().zip(stretches));
        cells.filter(|(_, stretches)| **stretches < LEAST_STRETCHES).for_each(|(p, _)| *p = f64::NAN);
        let effects = self.effects.iter_mut().chain(&mut self.partial).chain(&mut self.corrections);
        effects.for_each(|effect| take_values(effect, &self.completed.terms));
        self
    }
}

fn take_values(effect: &mut Finding, terms: &[Term]) {
    effect.with.iter_mut().for_each(|other| take_values(other, terms));
    let Some(term) = terms.iter().find(|term| term.entry.name == effect.name) else { return };
    for estimate in &mut effect.params {
        let place = term.entry.params.iter().position(|param| param.name == estimate.name);
        estimate.value = place.map_or(estimate.value, |place| term.values[place]);
    }
}

#[cfg(test)]
mod tests {
    use crazyflie_env::effects::find;

    use super::super::verdict::EffectParameterEstimate;
    use super::*;

    #[test]
    fn an_effect_is_reported_as_the_completed_model_has_it() {
        let estimate =
            |name, value| EffectParameterEstimate { name, value, stderr: 0.01, unit: "1", declared: 0.0 };
        let finding = |name, params, with| Finding {
            name,
            params,
            confusable_with: Vec::new(),
            manoeuvre: String::new(),
            worth_fit: 20.0,
            worth_test: 20.0,
            worth_by_signal: [20.0, 0.0, 0.0, 0.0],
            with,
        };
        let term = |name: &str, value| {
            let mut term = Term::off(find(name).unwrap().1);
            term.values[0] = value;
            term
        };
        let terms = [term("drag_linear", 0.5), term("attitude_gain", 0.9)];
        let gain = finding("attitude_gain", vec![estimate("gain", 0.8)], Vec::new());
        let mut effect = finding("drag_linear", vec![estimate("rate_ps", 0.4)], vec![gain]);
        take_values(&mut effect, &terms);
        assert_eq!([effect.params[0].value, effect.with[0].params[0].value], [0.5, 0.9]);
        // a random effect may have no term
        take_values(&mut effect, &[]);
        assert!((effect.params[0].value - 0.5).abs() < f64::EPSILON);
    }
}
