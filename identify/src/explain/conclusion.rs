//! The last stage: a verdict, and the explanation that carries it.

use super::completion::Completion;
use super::finding;
use super::residual::Residual;
use super::search::FilteredHypothesis;
use super::signals;
use super::verdict::{Explanation, Finding, Step, Verdict};

/// The verdict by what is left, what is named, and whether the question stays open.
fn verdict(structured: bool, effects: &[Finding], undecided: bool) -> Verdict {
    // the exact geometry is a form of the model, and no cause of what is left beside it
    match (structured, effects.is_empty(), undecided) {
        (true, ..) if effects.iter().all(finding::is_model_form) => Verdict::Unexplained,
        (true, ..) => Verdict::PartlyExplained,
        (false, false, _) => Verdict::Explained,
        (false, true, true) => Verdict::NotDecidable,
        (false, true, false) => Verdict::NothingMissing,
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
    Explanation {
        verdict: verdict(residual.is_structured(), &completed.effects, undecided),
        completed: completed.with_random_effects(),
        signals: signals::signal_verdicts(
            |signal| completed.effects.iter().any(|e| signals::main_signal(e) == signal),
            |signal| signals::is_structured(&residual.leftover, signal),
            &completed.errors,
            &completed.disturbances,
        ),
        effects: completed.effects,
        confirmed: Vec::new(),
        needless: Vec::new(),
        withdrawn: Vec::new(),
        numbers: Vec::new(),
        foreign: false,
        partial: completed.partial,
        corrections: completed.corrections,
        learned: completed.learned,
        disturbances: [declared.disturbances, completed.disturbances],
        declared: declared.hypothesis.clone(),
        not_excited: finding::not_excited(&steps),
        path: steps,
        leftover: residual.leftover,
        errors: completed.errors,
        seconds,
    }
}
