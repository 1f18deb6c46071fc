//! Effects of real flights by what they are worth to predictions. Something always shakes a real vehicle, and a filter that may take everything for shaking finds
//! no effect. Motion capture tells where each window starts, so windows fitted by output error do: one effect joins at a time, by the fit, and stays
//! if predictions of flights that choose get better for it.

use rayon::prelude::*;

use super::calibration::prediction::{LEAST_GAIN, MOST_EFFECTS, STEPS};
use super::candidates::candidates;
use super::search::{Search, deviations};
use super::verdict::{Estimate, Finding};
use crate::axis_errors::{AxisErrors, axis_changes, axis_errors};
use crate::fit::flight::Flight;
use crate::fit::hypothesis::{Hypothesis, Term};
use crate::fit::solve::Solution;

/// The model with effects that predict better, and these.
pub struct PredictedEffects {
    pub hypothesis: Hypothesis,
    pub findings: Vec<Finding>,
}

struct FittedHypothesis {
    hypothesis: Hypothesis,
    solution: Solution,
}

fn fit_windows(search: &Search, hypothesis: &Hypothesis) -> FittedHypothesis {
    let solution = search.fit(hypothesis, None, STEPS);
    FittedHypothesis { hypothesis: hypothesis.at(&solution.shared), solution }
}

/// Errors of the flights that choose, from measured states.
fn errors(choosing: &[Flight], at: &Hypothesis) -> Option<Vec<AxisErrors>> {
    let fixed = at.fixed();
    choosing.iter().map(|flight| axis_errors(&fixed, flight, 0.0, None)).collect()
}

/// Logarithm of the errors over those before, of each judged axis: sideways, vertical, tilt.
fn log_ratios(before: &[AxisErrors], after: &[AxisErrors]) -> [f64; 3] {
    let changes = axis_changes(before, after);
    ["sideways", "vertical", "attitude"].map(|axis| {
        let of_axis: Vec<f64> = changes.iter().filter(|c| c.axis == axis).map(|c| (c.after / c.before).ln()).collect();
        of_axis.iter().sum::<f64>() / of_axis.len() as f64
    })
}

fn mean(ratios: [f64; 3]) -> f64 {
    ratios.iter().sum::<f64>() / ratios.len() as f64
}

/// Names effects that the declared model lacks; `None` where it cannot be simulated or none predicts better.
pub fn name_by_prediction(search: &Search, choosing: &[Flight], declared: &Hypothesis) -> Option<PredictedEffects> {
    let mut now = fit_windows(search, declared);
    let mut known = errors(choosing, declared)?;
    while now.hypothesis.terms.len() < MOST_EFFECTS {
        let starts: Vec<Term> = candidates(&now.hypothesis).into_iter().flat_map(|c| c.starts.into_iter().take(c.variants)).collect();
        let tried: Vec<FittedHypothesis> = starts.into_par_iter().map(|term| fit_windows(search, &now.hypothesis.with(term))).collect();
        let Some(best) = tried.into_iter().min_by(|a, b| a.solution.loss.total_cmp(&b.solution.loss)) else { break };
        let Some(next) = errors(choosing, &best.hypothesis).filter(|next| mean(log_ratios(&known, next)) < -LEAST_GAIN) else { break };
        (now, known) = (best, next);
    }
    // what a later effect made needless goes
    while let Some((less, next)) = needless(search, choosing, &now, &known) {
        (now, known) = (less, next);
    }
    let findings: Vec<Finding> = now.hypothesis.terms.iter().filter_map(|term| finding(search, choosing, &now, &known, term)).collect();
    (!findings.is_empty()).then_some(PredictedEffects { hypothesis: now.hypothesis, findings })
}

/// The hypothesis without an effect that predictions do not miss.
fn needless(
    search: &Search,
    choosing: &[Flight],
    now: &FittedHypothesis,
    known: &[AxisErrors],
) -> Option<(FittedHypothesis, Vec<AxisErrors>)> {
    let without = |term: &Term| {
        let less = fit_windows(search, &now.hypothesis.without(term.entry.name));
        let next = errors(choosing, &less.hypothesis)?;
        Some((mean(log_ratios(known, &next)), less, next))
    };
    let least = now.hypothesis.terms.iter().filter_map(without).min_by(|a, b| a.0.total_cmp(&b.0))?;
    (least.0 < LEAST_GAIN).then_some((least.1, least.2))
}

fn finding(search: &Search, choosing: &[Flight], now: &FittedHypothesis, known: &[AxisErrors], term: &Term) -> Option<Finding> {
    let less = fit_windows(search, &now.hypothesis.without(term.entry.name));
    let [sideways, vertical, tilt] = log_ratios(known, &errors(choosing, &less.hypothesis)?);
    let judge = Search::new(choosing);
    let loss = |at: &Hypothesis| judge.fit(&at.fixed(), None, STEPS).loss;
    let sd = deviations(&now.solution);
    let params = term.free.iter().zip(now.hypothesis.place(term.entry.name)).map(|(i, at)| {
        let p = &term.entry.params[*i];
        Estimate { name: p.name, value: term.values[*i], stderr: sd[at], unit: p.unit }
    });
    Some(Finding {
        name: term.entry.name,
        params: params.collect(),
        confusable_with: Vec::new(),
        manoeuvre: String::new(),
        worth_fit: less.solution.loss - now.solution.loss,
        worth_test: loss(&less.hypothesis) - loss(&now.hypothesis),
        worth_by_signal: [sideways, vertical, tilt, 0.0],
        with: Vec::new(),
    })
}
