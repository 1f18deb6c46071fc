//! From the residual of a model to its cause. The stages go one way: score, propose and judge (`selection`),
//! eliminate, compare with free curves (`curves`), test the rest (`residual`), name (`finding`), validate by
//! predictions (`completion`), and the verdict (`conclusion`). Wording is the command line's.

mod ablation;
pub(crate) mod calibration;
pub(crate) mod candidates;
mod completion;
mod conclusion;
mod curves;
pub mod errors;
mod finding;
pub mod foreign;
mod higher_order;
pub mod leftover;
pub mod logs;
mod lost_commands;
pub mod noise;
mod place;
pub mod recorded;
pub mod refine;
mod residual;
pub mod scores;
pub mod search;
mod selection;
pub mod shape;
pub mod signals;
mod starts;
#[cfg(test)]
mod tests;
pub mod threshold;
mod unmask;
mod validation;
pub mod verdict;

use std::time::Instant;

use crazyflie_env::model::Model;

use crate::fit::flight::Flight;
use crate::fit::hypothesis::Hypothesis;
use calibration::verdict::{ALIKE, WORTH_BOTH, WORTH_FIT, WORTH_TEST};
use search::{Search, SearchPair};
use validation::Split;
use verdict::Explanation;

/// Explains what a model lacks: fitted on `fit`, judged on `test`. `progress` gets each step. With many flights to
/// fit, a part of them chooses the effects, and the flights of the test are used once.
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
    let (search, judge) = (Search::new(&split.fitted), Search::new(&split.choosing));
    let searches = SearchPair { search, judge, progress };
    let search = &searches.search;
    progress("disturbances of the declared model");
    let declared = search.judge_declared(&Hypothesis::from_model(model))?;
    progress("the exact form of the model");
    let form = selection::model_form(search, search.judge_roughly(&declared)?);
    // score, propose and judge, one effect at a time
    let (path, steps) = selection::select_forward(&searches, &form);
    let selection = selection::eliminate(&searches, path)?;
    let selection = selection::select_in_still_air(&searches, selection);
    let selection = curves::hold_against_curves(&searches, selection);
    progress("what is left");
    let (selection, residual) = residual::rescue(&searches, selection, &split.choosing);
    let named = finding::name_effects(&searches, &selection, &residual)?;
    let (last, left) = (&selection.ablation.full, &residual.leftover);
    let (completed, undecided) = completion::complete(&declared, last, left, named, &split.choosing);
    let completed = if split.spares_test { completed.evaluate_on(&declared, test) } else { completed };
    let seconds = began.elapsed().as_secs_f64();
    Some(conclusion::conclude(&declared, (completed, undecided), residual, steps, seconds))
}

/// Computes the error of a model's predictions of flights, unchanged: the negative log-likelihood, with its random
/// disturbances. Returns `None` if it cannot be run on them.
pub fn declared_loss(model: &Model, flights: &[Flight]) -> Option<f64> {
    Some(Search::new(flights).judge_declared(&Hypothesis::from_model(model))?.loss)
}
