//! Oracle: a fit that is given the hidden effects, and how much better it predicts.

use crazyflie_env::effects::{Geometry, find};
use crazyflie_identify::explain::errors::{Errors, compare};
use crazyflie_identify::explain::search::Search;
use crazyflie_identify::fit::hypothesis::{Hypothesis, Term};

use super::truth::Truth;
use crate::explained::Run;

/// Horizons that are compared, of those of the errors: 0.5 s and 2 s. Shorter ones show noise, the free run chance.
const HORIZONS: [usize; 2] = [2, 3];

/// Largest error of the explanation over that of the oracle, over position, velocity and attitude. `None` where the library lacks
/// a hidden effect, or the oracle's fit cannot be made.
pub(super) fn error_ratio(run: &Run, truth: &Truth) -> Option<f64> {
    let mut hypothesis = Hypothesis::of(&run.model);
    for effect in &truth.effects {
        hypothesis = hypothesis.with(term(&effect.name, &effect.ours())?);
    }
    for name in truth.benign() {
        let Some(term) = term(name, &[]).filter(|_| !hypothesis.has(name)) else { continue };
        hypothesis = hypothesis.with(term);
    }
    // in the whole geometry its parts would count twice
    if hypothesis.terms.iter().any(|t| t.entry.geometry == Geometry::Whole) {
        hypothesis.terms.retain(|t| t.entry.geometry != Geometry::Part);
    }
    // what is random has no place among expectations
    hypothesis.terms.retain(|t| t.entry.trace.shapes_mean());
    let search = Search::new(&run.fit.flights);
    let [disturbances, _] = &run.found.disturbances;
    let fitted = search.refit(&hypothesis, disturbances)?;
    let (declared, test) = (Hypothesis::of(&run.model), &run.test.flights[..]);
    let oracle = compare((&declared, disturbances, test), (&fitted.settled(), &fitted.disturbances, test));
    Some(largest_ratio(&run.found.errors, &oracle))
}

/// An effect that starts at the true values: a delay or a limit would not be found from "off".
fn term(name: &str, params: &[(&str, f64)]) -> Option<Term> {
    let (_, entry) = find(name).ok()?;
    let mut term = Term::off(entry);
    for (name, value) in params {
        let at = entry.params.iter().position(|p| p.name == *name)?;
        term.values[at] = *value;
    }
    Some(term)
}

fn largest_ratio(own: &Errors, oracle: &Errors) -> f64 {
    let ratios = (0..3).flat_map(|q| HORIZONS.map(|h| own.after[q][h] / oracle.after[q][h]));
    ratios.filter(|r| r.is_finite()).fold(0.0, f64::max)
}
