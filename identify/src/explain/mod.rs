//! From the residual of a model to its cause. The stages go one way: model form, forward search, elimination,
//! residual tests, verdict.

mod calibration;
pub(crate) mod candidates;
mod completion;
pub mod errors;
mod finding;
pub mod learn;
pub mod leftover;
pub mod noise;
mod place;
pub mod recorded;
pub mod refine;
mod residual;
pub mod search;
mod selection;
pub mod shape;
pub mod signals;
mod validation;
pub mod verdict;

use std::time::Instant;

use crazyflie_env::model::Model;

use crate::fit::flight::Flight;
use crate::fit::hypothesis::Hypothesis;
use calibration::verdict::{ALIKE, MOST_RIVALS, UNDECIDED, WORTH_FIT, WORTH_TEST};
use completion::Completion;
use search::Search;
use validation::Split;
use verdict::{Explanation, Finding, Verdict};

/// Explains what a model lacks: fitted on `fit`, judged on `test`. `progress` is told what is being done. Of
/// many flights to fit, a part chooses what is kept, and the flights of the test are looked at once.
///
/// Returns `None` if the declared model cannot be run on the flights.
pub fn explain(
    model: &Model,
    fit: &[Flight],
    test: &[Flight],
    progress: &dyn Fn(&str),
) -> Option<Explanation> {
    let began = Instant::now();
    let split = Split::new(fit, test);
    let (fit, choosing) = (&split.fitted[..], &split.choosing[..]);
    let (search, judge) = (Search::new(fit), Search::new(choosing));
    progress("disturbances of the declared model");
    let declared = search.judge_declared(&Hypothesis::from_model(model))?;
    progress("the exact form of the model");
    let form = selection::model_form(&search, search.judge_roughly(&declared)?);
    let (path, steps) = selection::select_forward(&search, &form, progress);
    let selection = selection::eliminate(&search, &judge, path, progress)?;
    progress("what is left");
    let (selection, residual) = residual::rescue(&search, &judge, selection, choosing);
    let last = &selection.ablation.full;
    let settled = last.at_posterior();
    let found = finding::findings(&judge, &selection)?;
    let (mut effects, corrections): (Vec<Finding>, Vec<Finding>) =
        found.into_iter().partition(|e| settled.is_cause(e.name));
    let mut disturbances = last.disturbances;
    if let Some(gust) = residual
        .gust
        .as_ref()
        .filter(|_| !signals::is_structured(&residual.leftover, signals::Signal::Sideways))
    {
        effects.extend(finding::gust_finding(&search, &judge, last, gust));
        disturbances = gust.disturbances;
    }
    let is_vague = |e: &Finding| e.confusable_with.len() > MOST_RIVALS;
    let dropped = selection.dropped && effects.is_empty();
    let undecided = selection.ablation.unclear_worth > UNDECIDED || effects.iter().any(is_vague) || dropped;
    effects.retain(|e| !is_vague(e));
    let completed = Completion::new(
        &declared,
        last,
        [finding::group_model_form(effects), corrections],
        disturbances,
        choosing,
    );
    let completed = completed.withdraw(&declared, &residual.leftover, choosing);
    let names_before = completed.effects.len();
    let completed = completed.without_harm(&declared, choosing);
    // an effect that earned its place and yet makes predictions worse leaves the question open
    let undecided = undecided || completed.effects.len() < names_before;
    let structured = residual.is_structured();
    let completed = if structured && completed.effects.iter().all(finding::is_model_form) {
        progress("a term learned from the residual");
        completed.with_learned_term(&search, &judge, last, &declared, choosing)
    } else {
        completed
    };
    let completed = if split.spares_test { completed.evaluate_on(&declared, test) } else { completed };
    // the exact geometry is a form of the model, and no cause of what is left beside it
    let verdict = match (structured, completed.effects.is_empty(), undecided) {
        (true, ..) if completed.effects.iter().all(finding::is_model_form) => Verdict::Unexplained,
        (true, ..) => Verdict::PartlyExplained,
        (false, false, _) => Verdict::Explained,
        (false, true, true) => Verdict::NotDecidable,
        (false, true, false) => Verdict::NothingMissing,
    };
    Some(Explanation {
        verdict,
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
        declared: declared.hypothesis,
        not_excited: finding::not_excited(&steps),
        path: steps,
        leftover: residual.leftover,
        errors: completed.errors,
        seconds: began.elapsed().as_secs_f64(),
    })
}

/// How badly a model predicts flights as it is: the negative log-likelihood, with what is random about them.
/// `None` if it cannot be run on them.
pub fn declared_loss(model: &Model, flights: &[Flight]) -> Option<f64> {
    Some(Search::new(flights).judge_declared(&Hypothesis::from_model(model))?.loss)
}
