//! A residual without a name can still be described: a few terms of a library of functions, kept only if they
//! help where they were not fitted.

use crazyflie_env::effects::{Observability, registry};

use super::calibration::learn::{CLEAR, WORTH_TEST};
use super::search::{FilteredHypothesis, Search};
use crate::fit::hypothesis::Term;

/// The hypothesis with a sparse learned term, if there is one that helps on the test flights.
pub fn learn(search: &Search, judge: &Search, from: &FilteredHypothesis) -> Option<FilteredHypothesis> {
    let entry = registry().iter().find(|e| e.observability == Observability::Surrogate)?;
    let mut now = search.refit(&from.at_posterior().with(Term::off(entry)), &from.disturbances)?;
    loop {
        let place = now.hypothesis.place(entry.name);
        let clearance = |at: usize| now.posterior.mean[at].abs() / now.posterior.sd(at);
        // the least certain goes first: its share falls to the others
        let least = place.clone().min_by(|a, b| clearance(*a).total_cmp(&clearance(*b)))?;
        if clearance(least) >= CLEAR {
            break;
        }
        let mut fewer = now.at_posterior();
        let term = fewer.terms.iter_mut().find(|t| t.entry.name == entry.name)?;
        let i = term.free.remove(least - place.start);
        term.values[i] = 0.0;
        if term.free.is_empty() {
            return None;
        }
        let sd: Vec<f64> =
            (0..now.posterior.mean.len()).filter(|at| *at != least).map(|at| now.posterior.sd(at)).collect();
        now = search.judge(&fewer, &sd, &now.disturbances)?;
    }
    let tuned = search.retune(&now)?;
    let gain = judge.plug_in(&from.at_posterior(), &from.disturbances)?
        - judge.plug_in(&tuned.at_posterior(), &tuned.disturbances)?;
    (gain > WORTH_TEST).then_some(tuned)
}
