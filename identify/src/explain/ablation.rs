//! Backward elimination: a hypothesis without each of its effects, and others in their places.

use crazyflie_env::effects::{self, Geometry};
use rayon::prelude::*;

use super::calibration::search::{BEYOND, LAG_PENALTY, LEAST_SHARE, MOST_REFINED, NEARLY, SHORTLIST_RIVALS};
use super::calibration::verdict::MOST_RIVALS;
use super::scores::{Score, Scores};
use super::search::{FilteredHypothesis, Proposal, Search, likeliest_by_newcomer};

/// Ablation study of a hypothesis: itself, and each that lacks one of its effects.
#[derive(Debug, Clone)]
pub(crate) struct Ablation {
    pub full: FilteredHypothesis,
    pub without: Vec<(&'static str, FilteredHypothesis)>,
    /// The most that an effect was worth that was taken out because its size was unclear.
    pub unclear_worth: f64,
    /// The hypothesis with the effect that nearly earned its place: clear in size, and worth most of what it
    /// must be.
    pub near_miss: Option<FilteredHypothesis>,
}

impl Ablation {
    /// Names of the effects.
    pub(crate) fn names(&self) -> Vec<&'static str> {
        self.full.hypothesis.terms.iter().map(|t| t.entry.name).collect()
    }
}

impl Search<'_> {
    /// Without one of its effects, the others and the disturbances settled anew.
    pub fn judge_without(&self, judged: &FilteredHypothesis, effect: &str) -> Option<FilteredHypothesis> {
        let first = self.judge(&judged.settled().without(effect), &judged.disturbances)?;
        if let Some(other) = self.with_other_losses(&first).filter(|other| other.loss < first.loss) {
            return Some(other);
        }
        if first.loss - judged.loss > BEYOND { Some(first) } else { self.retune(&first) }
    }

    /// The ablation of a hypothesis: judged without each of its effects.
    pub(crate) fn ablate(&self, judged: FilteredHypothesis) -> Ablation {
        let names: Vec<&'static str> = judged.hypothesis.terms.iter().map(|t| t.entry.name).collect();
        let less = names.into_par_iter().filter_map(|name| Some((name, self.judge_without(&judged, name)?)));
        Ablation { without: less.collect(), full: judged, unclear_worth: 0.0, near_miss: None }
    }

    /// Effects that do not earn their place at the end, when all others are there, are taken out again: each
    /// must be worth so much log-likelihood, and one of its parameters must lie clear of "off".
    pub(crate) fn eliminate_backward(&self, from: FilteredHypothesis, worth: f64) -> Ablation {
        let mut now = self.ablate(from);
        let (mut unclear_worth, mut near_miss) = (0.0_f64, None);
        loop {
            let is_idle = |(name, less): &&(&'static str, FilteredHypothesis)| {
                less.loss - now.full.loss < worth || !now.full.is_clear(name)
            };
            let idle = now.without.iter().filter(is_idle);
            let Some((name, less)) = idle.min_by(|a, b| a.1.loss.total_cmp(&b.1.loss)) else {
                return Ablation { unclear_worth, near_miss, ..now };
            };
            let worth_of_least = less.loss - now.full.loss;
            unclear_worth = unclear_worth.max(worth_of_least);
            if worth_of_least > NEARLY.get() * worth && now.full.is_clear(name) {
                near_miss = Some(now.full.clone());
            }
            now = self.ablate(less.clone());
        }
    }

    /// Other effects in the place of one of a hypothesis: each as judged, within `noise` of the likelihood of
    /// the one that it replaces.
    pub fn rivals(
        &self,
        judged: &FilteredHypothesis,
        effect: &str,
        without: &FilteredHypothesis,
        noise: f64,
    ) -> Vec<(&'static str, FilteredHypothesis)> {
        // judged with the disturbances of the full hypothesis, and with those of its own
        let kept = FilteredHypothesis { disturbances: judged.disturbances, ..without.clone() };
        let Some(without) = self.rejudge(&kept, &judged.disturbances) else { return Vec::new() };
        let settled = without.at_posterior();
        let Some(Scores { best_first: scores, base }) = self.score(&without) else { return Vec::new() };
        let own = scores.iter().find(|s| s.start.entry.name == effect).map_or(0.0, |s| s.gain);
        // parts of the exact geometry are no rivals of each other or of the whole
        let is_geometry = effects::find(effect).is_ok_and(|(_, e)| e.geometry != Geometry::None);
        let is_rival = |s: &&Score| {
            s.start.entry.name != effect
                && s.gain > LEAST_SHARE.get() * own
                && !(is_geometry && s.start.entry.geometry != Geometry::None)
        };
        // gains of windows and of slopes have different scales: the best of each
        let best = |by_slope: bool| {
            let alike = scores.iter().filter(is_rival).filter(move |s| s.ahead.is_some() == by_slope);
            alike.take(SHORTLIST_RIVALS)
        };
        let others: Vec<&Score> = best(true).chain(best(false)).collect();
        let mut proposals = self.propose_all(&settled, &others, &base);
        let lags = |j: &FilteredHypothesis| j.hypothesis.terms.iter().map(|t| t.entry.lags).sum::<usize>();
        // a swing whose start nobody measured pays for that, which is no word against it
        let behind = |j: &FilteredHypothesis| {
            j.loss - judged.loss - LAG_PENALTY * lags(j).saturating_sub(lags(judged)) as f64
        };
        let in_place: Vec<Proposal> = proposals.iter().filter_map(|p| p.in_place(judged, effect)).collect();
        proposals.extend(in_place);
        let all = self.judge_all(&proposals, &judged.disturbances, judged);
        let nearest = likeliest_by_newcomer(all, &judged.hypothesis, MOST_REFINED);
        let refined = self.refine_nearest(&nearest, judged.loss + noise).into_par_iter();
        let replaced = refined.map(|j| self.with_companions(j)).filter(|j| behind(j) < noise).collect();
        let alike = likeliest_by_newcomer(replaced, &judged.hypothesis, 1);
        let named = alike.into_iter().filter_map(|j| Some((j.newcomer(&judged.hypothesis)?, j)));
        let (mut rivals, swings): (Vec<_>, Vec<_>) = named.partition(|(_, j)| j.loss - judged.loss < noise);
        // a rival that differs only in its start does not make a name too vague
        rivals.extend(swings.into_iter().take(MOST_RIVALS.saturating_sub(rivals.len())));
        rivals
    }
}
