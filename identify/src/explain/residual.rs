//! The residual under an explanation: correlation and lines in the innovations, and disturbances too large
//! for a model's small errors.

use rayon::prelude::*;

use super::calibration::finding::SLOW_GUST_S;
use super::calibration::noise::WORTH_REPORT;
use super::calibration::residual::REPORTED;
use super::curves::CurveGain;
use super::leftover;
use super::noise;
use super::place;
use super::search::{FilteredHypothesis, Search, SearchPair};
use super::selection::{Selection, validate};
use super::shape;
use super::signals::Signal;
use super::verdict::{Leftover, Structure};
use crate::fit::filter::{Disturbances, FilterResult, filter_fixed};
use crate::fit::flight::Flight;

/// A wandering force that may be a gust: disturbances with its size and correlation time finely, and the
/// standard errors of these.
pub struct GustCandidate {
    pub disturbances: Disturbances,
    pub sd: [f64; 2],
}

/// Sizes are tuned on short stretches, where a small gust may not be worth its penalty: at the limit of what
/// is reported, whole flights decide.
fn gust_candidate(search: &Search, last: &FilteredHypothesis) -> Option<GustCandidate> {
    let is_gust = |d: &Disturbances| d.force.tau_s > noise::GUST_S && noise::reportable_force(d).is_some();
    let before = &last.disturbances;
    if !is_gust(before) && before.force.sigma < noise::REPORTABLE_FORCE_MPS2 {
        return None;
    }
    let hypothesis = last.at_posterior();
    let (disturbances, sd) = noise::tune_force(search.flights, &hypothesis, before);
    // a size just beyond the limit is hardly likelier than the limit itself: what counts is that there is one
    let calm = noise::calm(&disturbances);
    let worth = || Some(search.plug_in(&hypothesis, &calm)? - search.plug_in(&hypothesis, &disturbances)?);
    // a slow one that small may be an error of a force that is there for good
    let is_slow = disturbances.force.tau_s > SLOW_GUST_S;
    let found = if is_slow {
        is_gust(before) && is_gust(&disturbances)
    } else {
        is_gust(before) || (is_gust(&disturbances) && worth()? > WORTH_REPORT.get())
    };
    found.then_some(GustCandidate { disturbances, sd })
}

/// The residual of a selection of effects.
pub struct Residual {
    pub gust: Option<GustCandidate>,
    pub leftover: Vec<Leftover>,
}

impl Residual {
    fn from_selection(search: &Search, test: &[Flight], selection: &Selection) -> Self {
        let (fit, last) = (search.flights, &selection.ablation.full);
        let gust = gust_candidate(search, last);
        let curves = selection.curves.iter().map(CurveGain::leftover);
        let leftover = curves.chain(leftovers(fit, test, last, gust.as_ref())).collect();
        Residual { gust, leftover }
    }

    pub fn is_structured(&self) -> bool {
        self.leftover.iter().any(Leftover::is_structure)
    }
}

/// Residual of a selection, and the selection. Readmits an effect that was nearly kept, if it accounts for all
/// structure that is left without it.
pub fn rescue(searches: &SearchPair, mut selection: Selection, test: &[Flight]) -> (Selection, Residual) {
    let SearchPair { search, judge, .. } = searches;
    let residual = Residual::from_selection(search, test, &selection);
    let near_miss = selection.ablation.near_miss.take().filter(|_| residual.is_structured());
    let curves = &selection.curves;
    let other = near_miss.and_then(|near_miss| {
        let other = validate(search, judge, search.ablate(near_miss), selection.rivals.clone())?;
        let other = Selection { curves: curves.clone(), ..other };
        let left = Residual::from_selection(search, test, &other);
        (!left.is_structured()).then_some((other, left))
    });
    other.unwrap_or((selection, residual))
}

/// Disturbances too large for the small errors of a model; their size in units of what makes a finding.
fn excess_disturbances(disturbances: &Disturbances, gust: Option<&GustCandidate>) -> Vec<Leftover> {
    let Disturbances { lift, torque, turn, .. } = *disturbances;
    let finding = |part: Signal, signal: &str, words: String, size: f64| {
        Leftover::new(Structure::Disturbance, part, signal, words, leftover::FINDING.get() * size)
    };
    let finding_for = |(part, size): (Signal, f64)| {
        let (signal, what, tau_s) = match part {
            Signal::Sideways => return None,
            Signal::Vertical => ("lift", "the thrust is", lift.tau_s),
            Signal::Tilt => ("torque", "roll and pitch are", torque.tau_s),
            Signal::Yaw => ("turn", "the yaw is", turn.tau_s),
        };
        let (sigma, unit) = part.disturbance(disturbances);
        let shaken = format!("{what} shaken by {sigma:.2} {unit}, for {tau_s:.2} s at a time");
        Some(finding(part, signal, format!("{shaken}, whatever the commands"), size))
    };
    let mut found: Vec<Leftover> = noise::reportable(disturbances).filter_map(finding_for).collect();
    let endless = gust.map(|g| g.disturbances).filter(|d| d.force.tau_s >= noise::LONGEST_S);
    let wander = endless.and_then(|d| {
        let words = format!("wanders by {:.2} m/s^2, for longer than gusts do", d.force.sigma);
        Some(finding(Signal::Sideways, "force", words, noise::reportable_force(&d)?))
    });
    found.extend(wander);
    found
}

/// The strongest findings in the innovations of the test flights, and in the forces of all.
pub fn leftovers(
    fit: &[Flight],
    test: &[Flight],
    last: &FilteredHypothesis,
    gust: Option<&GustCandidate>,
) -> Vec<Leftover> {
    let (hypothesis, disturbances) = (last.at_posterior(), &last.disturbances);
    let filtered = |f| Some((f, filter_fixed(f, &hypothesis, disturbances)?));
    let mut known: Vec<Option<_>> = fit.par_iter().chain(test).map(filtered).collect();
    let tested: Vec<_> = known.split_off(fit.len()).into_iter().flatten().collect();
    let known: Vec<_> = known.into_iter().flatten().collect();
    let findings = |(flight, filtered): &(&Flight, FilterResult)| {
        let innovations = leftover::leftover_findings(flight, filtered);
        [innovations, shape::force_findings(flight, filtered, disturbances)].concat()
    };
    let mut all: Vec<Leftover> = tested.iter().flat_map(findings).collect();
    all.extend(place::spatial_repeatability(known.iter().chain(&tested), disturbances));
    all.sort_by(|a, b| b.size.abs().total_cmp(&a.size.abs()));
    // the strongest of each signal is reported, however strong the others
    let (mut kept, mut rest): (Vec<Leftover>, Vec<Leftover>) = (Vec::new(), Vec::new());
    for finding in all {
        if kept.iter().any(|k| k.part == finding.part) { rest.push(finding) } else { kept.push(finding) }
    }
    kept.extend(rest.into_iter().take(REPORTED.saturating_sub(Signal::ALL.len())));
    kept.sort_by(|a, b| b.size.abs().total_cmp(&a.size.abs()));
    [excess_disturbances(disturbances, gust), kept].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::filter::GaussMarkov;

    #[test]
    fn a_force_that_wanders_on_and_on_is_structure() {
        let found = |tau_s: f64| {
            let disturbances = Disturbances { force: GaussMarkov { sigma: 0.4, tau_s }, ..noise::FLOOR };
            excess_disturbances(&disturbances, Some(&GustCandidate { disturbances, sd: [0.1; 2] }))
        };
        assert!(found(3.0).is_empty());
        assert!(
            found(noise::LONGEST_S).iter().all(Leftover::is_structure) && found(noise::LONGEST_S).len() == 1
        );
    }
}
