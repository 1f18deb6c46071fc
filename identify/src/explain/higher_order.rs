//! Dynamics of a higher order than declared, distinguished from a delay. A fit of second order to a loop of higher
//! order takes some of the loop's delay for inertia. Beside a delay that is missing, the fit of an explanation takes
//! that share back: less inertia, and a delay that is too long by it.

use crazyflie_env::effects::{Entry, Observability, registry};

use super::WORTH_BOTH;
use super::calibration::search::STEPS;
use super::search::{FilteredHypothesis, Proposal, Search};
use crate::fit::hypothesis::Term;

/// Returns the same hypothesis with an effect of higher order in place of numbers that contain a delay, if it is not
/// much less likely: a priori, such numbers are as unlikely as an effect.
pub(super) fn restate(search: &Search, judged: &FilteredHypothesis) -> Option<FilteredHypothesis> {
    let settled = judged.at_posterior();
    let holder = settled.delay_holder()?;
    let missing = |e: &&Entry| e.observability == Observability::HigherOrder && !settled.has(e.name);
    let entry = registry().iter().find(missing)?;
    let hypothesis = settled.without(holder.entry.name).with(Term::at_start(entry));
    let fitted = Proposal::from_fit(&hypothesis, &search.fit(&hypothesis, None, STEPS));
    let restated = search.judge(&fitted, &judged.disturbances)?;
    let restated = search.retune(&restated)?;
    (restated.loss < judged.loss + WORTH_BOTH.get()).then_some(restated)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explain::noise::FLOOR;
    use crate::explain::tests::CommittedCase;
    use crazyflie_env::effects::find;

    #[test]
    fn what_declared_numbers_hold_of_a_delay_is_not_told_as_one() {
        // rotorpy's vehicle, with commands late by 30 ms: beside less inertia the delay came out at 37 ms
        let case = CommittedCase::read("d14");
        let flights = case.flights(&case.fit);
        let search = Search::new(&flights);
        let term = |name: &str, values: &[f64]| {
            let mut term = Term::off(find(name).unwrap().1);
            term.values[..values.len()].copy_from_slice(values);
            term
        };
        let found = [
            term("cmd_delay", &[0.037]),
            term("inertia_scale", &[0.9]),
            term("motor_lag", &[0.06, 0.008]),
            term("drag_linear", &[0.24]),
        ];
        let hypothesis = found.into_iter().fold(case.declared, |h, term| h.with(term));
        let judged = search.refit(&search.rough(&hypothesis), &FLOOR).unwrap();
        let delay_s =
            |judged: &FilteredHypothesis| judged.at_posterior().term("cmd_delay").unwrap().values[0];
        assert!(delay_s(&judged) > 0.035, "{}", delay_s(&judged));
        let restated = restate(&search, &judged).unwrap();
        assert!((delay_s(&restated) - 0.03).abs() < 0.001, "{}", delay_s(&restated));
        assert!(!restated.hypothesis.has("inertia_scale") && restated.hypothesis.has("attitude_order"));
        assert!(restate(&search, &restated).is_none(), "once");
    }
}
