//! A permanent defect may pass for a disturbance that drifts slowly. Damping that disturbance reveals it.

use rayon::prelude::*;

use super::calibration::search::{DAMPED_STEPS, LEAST_GAIN, MOST_EFFECTS, SHORTLIST_DAMPED, STEPS};
use super::noise::{damped_in_turn, still_air};
use super::search::{FilteredHypothesis, Search, best_of};

impl Search<'_> {
    /// The likeliest hypothesis that explains what now passes for one of the disturbances. `None` if none is
    /// large enough to hide anything.
    pub(super) fn unmask(&self, now: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        let damped = damped_in_turn(&now.disturbances);
        let found = damped.par_iter().filter_map(|damped| self.rejudge(now, damped));
        let found = found.flat_map_iter(|now| self.extend_damped(now));
        // the disturbances may grow again as far as what was found leaves them to
        found.filter_map(|judged| self.retune(&judged)).min_by(|a, b| a.loss.total_cmp(&b.loss))
    }

    /// The likeliest hypothesis with one more effect, in air stiller than the floor of the disturbances has it.
    /// `None` if the drifting force lies beyond its floor, if still air is no likelier, or if no effect is clear
    /// there. Other disturbances beyond their floors stay as they are.
    pub(super) fn extend_in_still_air(&self, now: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        let still = self.rejudge(now, &still_air(&now.disturbances)?)?;
        if now.loss - still.loss < LEAST_GAIN.get() {
            return None;
        }
        let least = still.loss - LEAST_GAIN.get();
        self.extend(&still, &[])
            .1
            .filter(|next| next.loss < least && next.hypothesis.terms.len() <= MOST_EFFECTS)
    }

    /// The hypotheses of a short search under damped disturbances, one more effect at a time. A thrust that lags
    /// and a climb that is damped are missing together: neither alone does better than the disturbance.
    fn extend_damped(&self, damped: FilteredHypothesis) -> Vec<FilteredHypothesis> {
        let mut path = vec![damped];
        while let Some(next) =
            path.last().filter(|_| path.len() <= DAMPED_STEPS).and_then(|now| self.add_damped(now))
        {
            path.push(next);
        }
        path.split_off(1)
    }

    fn add_damped(&self, now: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        let settled = now.at_posterior();
        let (scores, base) =
            rayon::join(|| self.slope_scores(now), || self.fit(&settled.without_free(), None, STEPS));
        let scores = scores?;
        let proposals = best_of(&scores, SHORTLIST_DAMPED).flat_map(|s| self.propose(&settled, s, &base));
        let judged = self.judge_all(&proposals.collect::<Vec<_>>(), &now.disturbances, now);
        let best = judged.iter().min_by(|a, b| a.loss.total_cmp(&b.loss))?.clone();
        (now.loss - best.loss > LEAST_GAIN.get()).then(|| self.join_round(best, judged, now))
    }
}
