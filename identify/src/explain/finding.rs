//! Effects that were kept, as they are reported: values, worth, rivals, and the flight that distinguishes these.

use crazyflie_env::effects::{Entry, GaussMarkovSignal, Geometry, Observability, Role, registry};
use rayon::prelude::*;

use super::calibration::finding::{LAW_SHARE, SLOW_GUST_S};
use super::calibration::verdict::{MOST_RIVALS, UNDECIDED};
use super::noise;
use super::residual::{GustCandidate, Residual};
use super::search::{FilteredHypothesis, Search, SearchPair};
use super::selection::Selection;
use super::signals::{self, Signal, losses_by_signal};
use super::verdict::{EffectParameterEstimate, Finding, RankedCandidate, Step};
use super::{ALIKE, WORTH_TEST};
use crate::fit::filter::{Disturbances, FilterResult, filter_fixed};
use crate::fit::hypothesis::Hypothesis;

/// Negative log-likelihood of the test flights by signal, all parameters as they are.
fn signal_losses(judge: &Search, hypothesis: &Hypothesis, disturbances: &Disturbances) -> Option<[f64; 4]> {
    let filtered = judge.flights.par_iter().map(|f| filter_fixed(f, hypothesis, disturbances));
    Some(losses_by_signal(&filtered.collect::<Option<Vec<FilterResult>>>()?))
}

/// The effects of a selection.
fn findings(judge: &Search, selection: &Selection) -> Option<Vec<Finding>> {
    let Selection { ablation, worths, rivals, .. } = selection;
    let settled = ablation.full.at_posterior();
    let with = signal_losses(judge, &settled, &ablation.full.disturbances)?;
    let describe = |(name, less): &(&'static str, FilteredHypothesis), worth_test: f64| {
        let term = settled.term(name).filter(|term| !term.is_description())?;
        let params = term.free.iter().zip(settled.place(name)).map(|(i, at)| {
            let p = &term.entry.params[*i];
            let value = term.values[*i];
            let stderr = ablation.full.posterior.sd(at).hypot(LAW_SHARE * p.reach(value));
            EffectParameterEstimate::new(p, value, stderr)
        });
        let params: Vec<EffectParameterEstimate> = params.collect();
        let confusable_with =
            rivals.iter().find(|(other, _)| other == name).map_or_else(Vec::new, |(_, r)| r.clone());
        let without = signal_losses(judge, &less.at_posterior(), &less.disturbances)?;
        Some(Finding {
            name,
            params,
            manoeuvre: manoeuvre(term.entry, &confusable_with),
            confusable_with,
            worth_fit: less.loss - ablation.full.loss,
            worth_test,
            worth_by_signal: std::array::from_fn(|i| without[i] - with[i]),
            with: Vec::new(),
        })
    };
    Some(ablation.without.par_iter().zip(worths).filter_map(|(each, worth)| describe(each, *worth)).collect())
}

/// Effects that likelihood names, before predictions have judged them.
pub struct NamedEffects {
    pub effects: Vec<Finding>,
    /// No causes of their own, as what is too small.
    pub corrections: Vec<Finding>,
    /// Disturbances beside them: of the gust, where one is named.
    pub disturbances: Disturbances,
    /// Something is missing, and these flights do not determine which effect it is.
    pub undecided: bool,
}

/// The findings of a selection, with a gust where nothing else is left in the sideways signal, and without
/// those that too many others could be as well.
pub fn name_effects(
    searches: &SearchPair,
    selection: &Selection,
    residual: &Residual,
) -> Option<NamedEffects> {
    let last = &selection.ablation.full;
    let settled = last.at_posterior();
    let (mut effects, corrections): (Vec<_>, Vec<_>) =
        findings(&searches.judge, selection)?.into_iter().partition(|e| settled.is_cause(e.name));
    let mut disturbances = last.disturbances;
    let is_structured = signals::is_structured(&residual.leftover, Signal::Sideways);
    if let Some(gust) = residual.gust.as_ref().filter(|_| !is_structured) {
        effects.extend(gust_finding(searches, last, gust));
        disturbances = gust.disturbances;
    }
    let is_vague = |e: &Finding| e.confusable_with.len() > MOST_RIVALS;
    let dropped = selection.dropped && effects.is_empty();
    let undecided =
        selection.ablation.unclear_worth > UNDECIDED.get() || effects.iter().any(is_vague) || dropped;
    effects.retain(|e| !is_vague(e));
    Some(NamedEffects { effects: group_model_form(effects), corrections, disturbances, undecided })
}

/// Returns whether a finding describes the exact geometry, which any vehicle has.
pub fn is_model_form(effect: &Finding) -> bool {
    registry().iter().any(|entry| entry.name == effect.name && entry.geometry != Geometry::None)
}

/// One finding in place of all parts of the exact geometry: what the declared model leaves out by its form.
fn group_model_form(effects: Vec<Finding>) -> Vec<Finding> {
    let (mut geometry, mut others): (Vec<_>, Vec<_>) = effects.into_iter().partition(is_model_form);
    if !geometry.is_empty() {
        let with = geometry.split_off(1);
        others.extend(geometry.pop().map(|first| Finding { with, ..first }));
    }
    others
}

/// Describes a flight that would distinguish effects: the place at which they enter decides what has to change. Empty
/// without others.
pub fn manoeuvre(effect: &Entry, others: &[&'static str]) -> String {
    if others.is_empty() {
        return String::new();
    }
    let lookup = |name: &&str| registry().iter().find(|e| e.name == *name);
    let all: Vec<&Entry> = others.iter().filter_map(lookup).chain([effect]).collect();
    if matches!(effect.observability, Observability::GaussMarkov(_)) {
        return "fly for more than twenty times as long as the gusts last, with one full turn in yaw".into();
    }
    if all.iter().all(|e| e.hooks.push) {
        return "climb and descend fast between 0.1 m and 1.5 m, then fly on until the battery is low, with one full turn in yaw".into();
    }
    if all.iter().any(|e| e.hooks.frame) {
        return "turn slowly through 360 degrees while translating at two heights".into();
    }
    "doublets of two sizes (2 and 8 degrees) on roll and pitch at two rates of change".into()
}

/// An effect that is there for good and as likely as a slow gust, and that leaves no gust beside it.
fn constant_alternative(
    search: &Search,
    last: &FilteredHypothesis,
    gust: &GustCandidate,
) -> Option<&'static str> {
    (gust.disturbances.force.tau_s > SLOW_GUST_S).then_some(())?;
    let other = search.extend(last, &[]).1.filter(|other| other.loss < last.loss + ALIKE.get())?;
    noise::reportable_force(&other.disturbances).is_none().then_some(())?;
    other.hypothesis.terms.iter().map(|t| t.entry.name).find(|name| !last.hypothesis.has(name))
}

/// The wandering force as the effect of the registry that is one.
fn gust_finding(searches: &SearchPair, last: &FilteredHypothesis, gust: &GustCandidate) -> Option<Finding> {
    let SearchPair { search, judge, .. } = searches;
    let is_gust = |e: &&Entry| e.observability == Observability::GaussMarkov(GaussMarkovSignal::Force);
    let entry = registry().iter().find(is_gust)?;
    let force = gust.disturbances.force;
    let (at, calm) = (last.at_posterior(), noise::calm(&gust.disturbances));
    let (without, with) = (signal_losses(judge, &at, &calm)?, signal_losses(judge, &at, &gust.disturbances)?);
    let worth_by_signal: [f64; 4] = std::array::from_fn(|i| without[i] - with[i]);
    let worth_test = worth_by_signal.iter().sum();
    let estimates = entry.params.iter().zip([force.sigma, force.tau_s]).zip(gust.sd);
    let params =
        estimates.map(|((p, value), stderr)| EffectParameterEstimate::new(p, value, stderr)).collect();
    let confusable_with: Vec<&'static str> = constant_alternative(search, last, gust).into_iter().collect();
    (worth_test > WORTH_TEST.get()).then_some(Finding {
        name: entry.name,
        params,
        manoeuvre: manoeuvre(entry, &confusable_with),
        confusable_with,
        worth_fit: worth_test,
        worth_test,
        worth_by_signal,
        with: Vec::new(),
    })
}

/// Effects of which a tenth of the range of every free parameter would not have shown at four standard
/// errors.
pub fn not_excited(steps: &[Step]) -> Vec<(&'static str, f64)> {
    let first = steps.first().map_or(&[][..], |s| &s.ranking);
    let hidden = |r: &RankedCandidate| {
        let entry = registry().iter().find(|e| e.name == r.name)?;
        let free = entry.params.iter().filter(|p| p.role == Role::Free).zip(&r.stderr);
        let shows = free.clone().any(|(p, sd)| 4.0 * sd <= 0.1 * (p.high - p.low));
        let (_, sd) = free.into_iter().next()?;
        (!shows).then_some((r.name, *sd))
    };
    first.iter().filter_map(hidden).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finding(name: &'static str) -> Finding {
        let (params, confusable_with, manoeuvre) = (Vec::new(), Vec::new(), String::new());
        let worth_by_signal = [20.0, 0.0, 0.0, 0.0];
        Finding {
            name,
            params,
            confusable_with,
            manoeuvre,
            worth_fit: 20.0,
            worth_test: 20.0,
            worth_by_signal,
            with: Vec::new(),
        }
    }

    #[test]
    fn exact_geometry_is_one_finding() {
        let grouped = group_model_form(["wind", "tilt_loss", "euler_kinematics"].map(finding).to_vec());
        assert_eq!(grouped.iter().map(|e| e.name).collect::<Vec<_>>(), ["wind", "tilt_loss"]);
        assert_eq!(grouped[1].all().map(|e| e.name).collect::<Vec<_>>(), ["tilt_loss", "euler_kinematics"]);
        assert_eq!(group_model_form(vec![finding("euler_kinematics")])[0].name, "euler_kinematics");
        assert!(group_model_form(Vec::new()).is_empty());
    }
}
