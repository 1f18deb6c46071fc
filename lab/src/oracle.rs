//! Oracle: a fit that is given the hidden effects, and how much better it predicts.

use crazyflie_env::effects::{Geometry, find};
use crazyflie_env::model::Model;
use crazyflie_identify::explain::errors::{Errors, compare_errors};
use crazyflie_identify::explain::logs::ExplainedLogs;
use crazyflie_identify::explain::search::Search;
use crazyflie_identify::fit::hypothesis::{Hypothesis, Term};

use crate::truth::{HiddenEffect, Truth};

/// Horizons that are compared, of those of the errors: 0.5 s and 2 s. Shorter ones show noise, the free run
/// chance.
const HORIZONS: [usize; 2] = [2, 3];

/// Standard errors that the oracle's estimate must lie from "off" for the flights to show an effect at all.
const SHOWN: f64 = 4.0;

/// A case beside a fit that is given the answer.
pub struct OracleComparison {
    /// Largest error of the explanation over that of the oracle, over position, velocity and attitude.
    pub ratio: f64,
    /// True if the flights of the fit show all that is hidden: the oracle finds each effect clear of "off".
    pub shown: bool,
}

/// `None` where the library lacks a hidden effect, or the oracle's fit cannot be made.
pub fn compare_with_oracle(model: &Model, logs: &ExplainedLogs, truth: &Truth) -> Option<OracleComparison> {
    let declared = Hypothesis::from_model(model);
    let mut hypothesis = declared.clone();
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
    // random effects have no expectation to fit
    hypothesis.terms.retain(|t| t.entry.observability.shapes_mean());
    let search = Search::new(&logs.fit.flights);
    let [disturbances, _] = &logs.found.disturbances;
    let fitted = search.refit(&hypothesis, disturbances)?;
    let test = &logs.test.flights[..];
    let oracle =
        compare_errors((&declared, disturbances, test), (&fitted.at_posterior(), &fitted.disturbances, test));
    let shows =
        |effect: &HiddenEffect| !hypothesis.has(&effect.name) || fitted.clearance(&effect.name) > SHOWN;
    Some(OracleComparison {
        ratio: largest_ratio(&logs.found.errors, &oracle),
        shown: truth.effects.iter().all(shows),
    })
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
    let ratios =
        (0..3).flat_map(|q| HORIZONS.map(|h| own.quantities.after[q][h] / oracle.quantities.after[q][h]));
    ratios.filter(|r| r.is_finite()).fold(0.0, f64::max)
}
