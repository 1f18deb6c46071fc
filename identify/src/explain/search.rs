//! The search for effects. Windows of flights, fitted by output error, propose. The Kalman filter decides:
//! its innovations are independent of each other whatever shakes the vehicle.

use crazyflie_env::effects::{Geometry, Observability, Role};
use rayon::prelude::*;

use super::calibration::search::{
    ABANDON, COMPANION_SHARE, ENOUGH, FAR_BEHIND, FOUND, KEPT, LEAST_JOINED, LEAST_PROPOSAL, LOSS_SD,
    MOST_REFINED, NEAR_M, NEAR_MPS, SHORTLIST, STEPS, SWING_SD, SWINGS_M, WIDEN, WINDOWS_TO_PROPOSE,
};
pub use super::calibration::search::{CLEAR, LEAST_GAIN, MOST_EFFECTS, MOST_UNMASKED};
use super::lost_commands::{hold_losses, is_lossy, release_losses};
use super::noise::{damped_in_turn, is_outlying, penalty, tune_disturbances};
use super::scores::{Score, Scores};
use crate::estimate::at_bound;
use crate::fit::filter::{Disturbances, ParameterPrior, filter_below, filter_fixed};
use crate::fit::flight::{Flight, WINDOW_S, Window};
use crate::fit::hypothesis::{Hypothesis, Term};
use crate::fit::output_error::OutputErrorProblem;
use crate::fit::solve::{Solution, solve_within};

/// A hypothesis judged by the filter: posterior of its parameters, disturbances and loss.
#[derive(Debug, Clone)]
pub struct FilteredHypothesis {
    /// Values as the windows have them.
    pub hypothesis: Hypothesis,
    /// Posterior of the filter after all flights of the fit.
    pub posterior: ParameterPrior,
    /// Random disturbances that the filter took to act.
    pub disturbances: Disturbances,
    /// Negative log-likelihood of the flights of the fit, the free parameters integrated out, and the penalty
    /// of the disturbances.
    pub loss: f64,
    /// The same up to each tick, flight after flight, without the penalty.
    pub losses: Vec<f64>,
}

impl FilteredHypothesis {
    /// Standard errors between "off" and the value of an effect's clearest amount.
    pub fn clearance(&self, effect: &str) -> f64 {
        let place = self.hypothesis.place(effect);
        let Some(term) = self.hypothesis.term(effect) else { return 0.0 };
        let standard_errors = |(i, at): (&usize, usize)| {
            (self.posterior.mean[at] - term.entry.params[*i].off).abs() / self.posterior.sd(at)
        };
        // a constant or a companion is estimated beside the amount, and tells nothing where that is nothing
        let is_amount = |(i, _): &(&usize, usize)| term.entry.params[**i].role == Role::Free;
        term.free.iter().zip(place).filter(is_amount).map(standard_errors).fold(0.0, f64::max)
    }

    /// The name of the effect that the hypothesis before it lacks, if there is one.
    pub(super) fn newcomer(&self, before: &Hypothesis) -> Option<&'static str> {
        self.hypothesis.terms.iter().map(|term| term.entry.name).find(|name| !before.has(name))
    }

    /// Returns whether a parameter that is not free in `before` differs clearly from its value there.
    fn moves_companions(&self, before: &Hypothesis) -> bool {
        let moves = |term: &Term, held: &Term| {
            let first = self.hypothesis.place(term.entry.name).start;
            let mut released = term.free.iter().enumerate().filter(|(_, i)| !held.free.contains(i));
            let lies_clear = |(k, i): (usize, &usize)| {
                let away = (self.posterior.mean[first + k] - held.values[*i]).abs();
                away > CLEAR.get() * self.posterior.sd(first + k)
            };
            released.any(lies_clear)
        };
        let mut terms = self.hypothesis.terms.iter();
        terms.any(|term| before.term(term.entry.name).is_some_and(|held| moves(term, held)))
    }

    /// Returns whether the first parameter of an effect, its strength, ran to a bound: then something else is the
    /// cause. The full exact geometry does not count as a bound.
    pub(super) fn is_at_bound(&self, effect: &str) -> bool {
        let ran = |term: &Term| {
            let (p, at) = (&term.entry.params[0], self.hypothesis.place(effect).start);
            let value = self.posterior.mean[at].clamp(p.low, p.high);
            value != p.off && at_bound(value, [p.low, p.high])
        };
        let has_strength = |t: &&Term| t.entry.geometry == Geometry::None && t.free.first() == Some(&0);
        self.hypothesis.term(effect).filter(has_strength).is_some_and(ran)
    }

    /// Returns whether an amount of an effect lies clear of "off", and its strength of its bounds.
    pub(super) fn is_clear(&self, effect: &str) -> bool {
        self.clearance(effect) >= CLEAR.get() && !self.is_at_bound(effect)
    }

    /// The hypothesis at the filter's values.
    pub fn at_posterior(&self) -> Hypothesis {
        let values = self.posterior.mean.iter().zip(self.hypothesis.bounds());
        self.hypothesis.with_values(&values.map(|(v, [low, high])| v.clamp(low, high)).collect::<Vec<_>>())
    }

    fn with_physics_hz(&self, max_physics_hz: Option<u32>) -> Self {
        let hypothesis = Hypothesis { max_physics_hz, ..self.hypothesis.clone() };
        FilteredHypothesis { hypothesis, ..self.clone() }
    }

    /// The hypothesis at the filter's values, as well known as after the flights.
    pub fn settled(&self) -> Proposal {
        let sd = (0..self.posterior.mean.len()).map(|i| self.posterior.sd(i)).collect();
        Proposal { hypothesis: self.at_posterior(), sd }
    }
}

/// The flights of a fit with the windows that propose.
pub struct Search<'a> {
    /// Flights that hypotheses are fitted to.
    pub flights: &'a [Flight],
    pub(super) windows: Vec<Window>,
}

/// The searches of an explanation: on the flights of the fit, and on those that judge. `progress` gets each step.
pub(super) struct SearchPair<'a> {
    pub search: Search<'a>,
    pub judge: Search<'a>,
    pub progress: &'a dyn Fn(&str),
}

/// A hypothesis to judge, and how well its free parameters are known: their standard errors.
#[derive(Debug, Clone)]
pub struct Proposal {
    /// The values are those to start from.
    pub hypothesis: Hypothesis,
    /// In the order of [`Hypothesis::free_values`].
    pub sd: Vec<f64>,
}

impl Proposal {
    /// The values of a fit by windows, each its own cluster.
    pub(super) fn from_fit(hypothesis: &Hypothesis, solution: &Solution) -> Self {
        let clusters: Vec<usize> = (0..solution.reduced.len()).collect();
        let covariance = solution.covariance(&clusters);
        let sd = |i: usize| covariance.as_ref().map_or(f64::INFINITY, |c| c[(i, i)].max(0.0).sqrt());
        let sd = (0..solution.shared.len()).map(sd).collect();
        Proposal { hypothesis: hypothesis.with_values(&solution.shared), sd }
    }

    /// The same with one more effect, whose free parameters have these standard errors.
    pub(super) fn with(&self, term: &Term, sd: &[f64]) -> Self {
        let hypothesis = self.hypothesis.with(term.clone());
        let (place, mut known) = (hypothesis.place(term.entry.name).start, self.sd.clone());
        known.splice(place..place, sd.iter().copied());
        Proposal { hypothesis, sd: known }
    }

    /// The same without one of its effects.
    pub(super) fn without(&self, effect: &str) -> Self {
        let place = self.hypothesis.place(effect);
        let kept = (0..self.sd.len()).filter(|i| !place.contains(i)).map(|i| self.sd[i]);
        Proposal { hypothesis: self.hypothesis.without(effect), sd: kept.collect() }
    }

    /// The newcomer as it was fitted, in the place of an effect of another hypothesis whose other effects stay as
    /// they are: beside one that does the same they need not move.
    pub(super) fn in_place(&self, judged: &FilteredHypothesis, effect: &str) -> Option<Proposal> {
        let newcomer = self.hypothesis.terms.iter().find(|t| !judged.hypothesis.has(t.entry.name))?;
        let sd = &self.sd[self.hypothesis.place(newcomer.entry.name)];
        Some(judged.settled().without(effect).with(newcomer, sd))
    }

    /// The same without free parameters that the windows do not determine. Those of `settled` effects stay free:
    /// beside a newcomer that does the same, only the filter decides which stays.
    fn without_idle(mut self, settled: &[&str]) -> Self {
        let mut rest = self.sd.split_off(self.hypothesis.free.len()).into_iter();
        for term in &mut self.hypothesis.terms {
            let stays = settled.contains(&term.entry.name);
            let range = |i: usize| term.entry.params[i].high - term.entry.params[i].low;
            let bounded =
                |(i, sd): (usize, f64)| (i, if sd.is_finite() { sd.min(range(i)) } else { range(i) });
            let all = term.free.iter().copied().zip(rest.by_ref());
            let free = all.filter(|(i, sd)| stays || (sd.is_finite() && *sd < range(*i)));
            let (free, sd): (Vec<usize>, Vec<f64>) = free.map(bounded).unzip();
            term.free = free;
            self.sd.extend(sd);
        }
        self
    }

    /// The same with other lengths of what swings in it, if that is new to the settled hypothesis.
    pub(super) fn other_swings(&self, settled: &Hypothesis) -> Vec<Proposal> {
        let swings =
            |t: &&Term| t.entry.observability == Observability::Resonant && !settled.has(t.entry.name);
        let Some(term) = self.hypothesis.terms.iter().find(swings) else { return Vec::new() };
        let length = term.free.iter().position(|i| term.entry.params[*i].unit == "m");
        let with_length = |length: usize, length_m: f64| {
            let place = self.hypothesis.place(term.entry.name).start + length;
            let (mut values, mut sd) = (self.hypothesis.free_values(), self.sd.clone());
            (values[place], sd[place]) = (length_m, SWING_SD * length_m);
            Proposal { hypothesis: self.hypothesis.with_values(&values), sd }
        };
        length.map_or_else(Vec::new, |length| SWINGS_M.map(|length_m| with_length(length, length_m)).to_vec())
    }
}

impl<'a> Search<'a> {
    /// Prepares a search: cuts the flights into windows of [`WINDOW_S`] and keeps an even selection of them.
    pub fn new(flights: &'a [Flight]) -> Self {
        let all: Vec<Window> = flights.iter().enumerate().flat_map(|(i, f)| f.windows(i, WINDOW_S)).collect();
        let every = all.len().div_ceil(WINDOWS_TO_PROPOSE).max(1);
        Search { flights, windows: all.into_iter().step_by(every).collect() }
    }

    /// Physics steps per second of a search: so many per tick, what only chooses need not be exact.
    pub(super) fn rough_hz(&self, per_tick: u32) -> u32 {
        per_tick * (1.0 / self.flights[0].tick_s).round() as u32
    }

    /// A hypothesis simulated as roughly as windows are.
    pub(super) fn rough(&self, hypothesis: &Hypothesis) -> Hypothesis {
        let max_physics_hz = hypothesis.max_physics_hz.or(Some(self.rough_hz(2)));
        Hypothesis { max_physics_hz, ..hypothesis.clone() }
    }

    /// A hypothesis judged as a search judges.
    pub fn judge_roughly(&self, judged: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        self.rejudge(&judged.with_physics_hz(Some(self.rough_hz(2))), &judged.disturbances)
    }

    /// Judges a hypothesis with the finest integration step that any of its effects needs.
    pub fn judge_exactly(&self, judged: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        self.rejudge(&judged.with_physics_hz(None), &judged.disturbances)
    }

    /// Fits the free numbers of a hypothesis to the windows, in at most `most_steps` steps.
    /// The windows start from `own`, the starts of an earlier fit, or as measured.
    pub fn fit(&self, hypothesis: &Hypothesis, own: Option<&[Vec<f64>]>, most_steps: usize) -> Solution {
        let hypothesis = &self.rough(hypothesis);
        let prediction = OutputErrorProblem::new(self.flights, &self.windows, hypothesis);
        let measured = prediction.measured_starts();
        let longer = |(known, start): (&Vec<f64>, &Vec<f64>)| {
            // a start that makes up for what the other hypothesis lacks may lie below the floor, where a
            // ground effect has no slope
            let known = if is_near(known, start) { &known[..] } else { &[] };
            // a lag that is new to the hypothesis has no value yet
            [known, &start[known.len().min(start.len())..]].concat()
        };
        let own = own.map_or_else(|| measured.clone(), |own| own.iter().zip(&measured).map(longer).collect());
        solve_within(&prediction, own, hypothesis.free_values(), most_steps, ENOUGH)
    }

    /// Filters a hypothesis.
    pub fn judge(&self, proposal: &Proposal, disturbances: &Disturbances) -> Option<FilteredHypothesis> {
        self.judge_against(proposal, disturbances, &[])
    }

    /// Judges like [`Search::judge`]. Returns `None` also for a hypothesis that falls hopelessly behind these losses,
    /// see [`FilteredHypothesis::losses`].
    pub(super) fn judge_against(
        &self,
        Proposal { hypothesis, sd }: &Proposal,
        disturbances: &Disturbances,
        least: &[f64],
    ) -> Option<FilteredHypothesis> {
        let known = sd.iter().zip(hypothesis.bounds());
        let mut wide: Vec<f64> =
            known.map(|(sd, [low, high])| (WIDEN.get() * sd).min(0.25 * (high - low))).collect();
        // the filter learns from the mean alone, where lost commands are a delay; what they are shows in the
        // spread, which the last word on the parameters weighs
        for term in hypothesis.terms.iter().filter(|t| is_lossy(t)) {
            wide[hypothesis.place(term.entry.name)].fill(LOSS_SD);
        }
        let mut prior = ParameterPrior::independent(hypothesis.free_values(), &wide);
        let (mut loss, mut losses) = (0.0, Vec::new());
        for flight in self.flights {
            let first = losses.len();
            let most = |tick: usize| least.get(first + tick).map_or(f64::INFINITY, |l| l - loss + ABANDON);
            let filtered = filter_below(flight, hypothesis, &prior, disturbances, &most)?;
            losses.extend(filtered.losses.iter().map(|l| loss + l));
            loss += filtered.loss;
            prior = filtered.posterior;
        }
        Some(FilteredHypothesis {
            hypothesis: hypothesis.clone(),
            posterior: prior,
            disturbances: *disturbances,
            loss: loss + penalty(disturbances),
            losses,
        })
    }

    /// Negative log-likelihood with all parameters as they are.
    pub fn plug_in(&self, hypothesis: &Hypothesis, disturbances: &Disturbances) -> Option<f64> {
        let loss = |f: &Flight| filter_fixed(f, hypothesis, disturbances).map(|filtered| filtered.loss);
        // summed in the order of the flights, whichever is done first
        let losses: Option<Vec<f64>> = self.flights.par_iter().map(loss).collect();
        losses.map(|losses| losses.iter().sum())
    }

    /// The declared model, with what is random about the flight.
    pub fn judge_declared(&self, hypothesis: &Hypothesis) -> Option<FilteredHypothesis> {
        let disturbances = tune_disturbances(&self.flights[0], hypothesis, None, &[]);
        let first =
            self.judge(&Proposal { hypothesis: hypothesis.clone(), sd: Vec::new() }, &disturbances)?;
        if is_outlying(&self.flights[0], &first.losses) { self.retune(&first) } else { Some(first) }
    }

    /// The hypothesis fitted anew, disturbances tuned, judged.
    pub fn refit(&self, hypothesis: &Hypothesis, disturbances: &Disturbances) -> Option<FilteredHypothesis> {
        let solution = self.fit(hypothesis, None, STEPS);
        let fitted = Proposal::from_fit(hypothesis, &solution).without_idle(&[]);
        let first = self.judge(&fitted, disturbances)?;
        let disturbances =
            tune_disturbances(&self.flights[0], &first.at_posterior(), Some(disturbances), &first.losses);
        self.judge(&fitted, &disturbances)
    }

    /// One more effect: all scores, and the best by the filter of those that score highest, without those that
    /// were taken out.
    pub fn extend(
        &self,
        now: &FilteredHypothesis,
        taken_out: &[&str],
    ) -> (Vec<Score>, Option<FilteredHypothesis>) {
        let Some(Scores { best_first: mut scored, base }) = self.score(now) else {
            return (Vec::new(), None);
        };
        scored.retain(|score| !taken_out.contains(&score.start.entry.name));
        let settled = now.at_posterior();
        let worthy: Vec<&Score> = best_of(&scored, SHORTLIST).collect();
        let proposals = self.propose_all(&settled, &worthy, &base);
        let mut first = self.judge_all(&proposals, &now.disturbances, now);
        let promised = promised(now, &worthy, &first);
        first.extend(self.judge_all(&promised, &now.disturbances, now));
        let first = likeliest_by_newcomer(first, &now.hypothesis, MOST_REFINED);
        let judged = self.refine_nearest(&first, f64::INFINITY);
        // an effect at its bound would be removed at the end, and may hide the cause until then
        let bounded = |j: &FilteredHypothesis| {
            j.hypothesis.terms.iter().any(|t| !settled.has(t.entry.name) && j.is_at_bound(t.entry.name))
        };
        let best =
            judged.into_iter().min_by(|a, b| bounded(a).cmp(&bounded(b)).then(a.loss.total_cmp(&b.loss)));
        let joined = best.map(|best| self.with_companions(self.join_round(best, first, now)));
        (scored, joined.and_then(|joined| self.retune(&joined)))
    }

    /// Returns the same with those numbers free too that only show beside an effect's amount, such as the damping of
    /// a swing, if these flights determine them.
    pub(super) fn with_companions(&self, now: FilteredHypothesis) -> FilteredHypothesis {
        let settled = now.at_posterior();
        let mut more = now.settled();
        let mut known = more.sd.split_off(settled.free.len()).into_iter();
        for (term, before) in more.hypothesis.terms.iter_mut().zip(&settled.terms) {
            *term = before.clone().with_companions();
            more.sd.extend(term.free.iter().map(|i| {
                let p = &term.entry.params[*i];
                let sd = if before.free.contains(i) { known.next() } else { None };
                sd.unwrap_or(COMPANION_SHARE * (p.high - p.low))
            }));
        }
        if more.sd.len() == settled.free_values().len() {
            return now;
        }
        let gains = |told: &FilteredHypothesis| now.loss - told.loss > LEAST_GAIN.get();
        let told = self.judge(&more, &now.disturbances).filter(gains);
        // beside quite another value of it, the amount may be another too
        let anew = || self.refit(&more.hypothesis, &now.disturbances).filter(gains);
        told.or_else(|| anew().filter(|told| told.moves_companions(&settled))).unwrap_or(now)
    }

    /// The best hypothesis of a round, and besides what others of the round added, as long as it keeps half
    /// of what it gained alone: what is missing in several ways takes one round, not several.
    pub(super) fn join_round(
        &self,
        best: FilteredHypothesis,
        mut others: Vec<FilteredHypothesis>,
        before: &FilteredHypothesis,
    ) -> FilteredHypothesis {
        others.retain(|other| before.loss - other.loss > LEAST_JOINED.get());
        others.sort_by(|a, b| a.loss.total_cmp(&b.loss));
        let mut now = best;
        for other in others {
            let alone = before.loss - other.loss;
            let settled = other.at_posterior();
            let added = |t: &&Term| !before.hypothesis.has(t.entry.name) && !now.hypothesis.has(t.entry.name);
            let Some(term) = settled.terms.iter().find(added) else { continue };
            let sd: Vec<f64> = settled.place(term.entry.name).map(|i| other.posterior.sd(i)).collect();
            let both = self.judge(&now.settled().with(term, &sd), &now.disturbances);
            let is_few = |both: &FilteredHypothesis| both.hypothesis.terms.len() <= MOST_EFFECTS;
            let adds = |both: &FilteredHypothesis| now.loss - both.loss > KEPT.get() * alone && is_few(both);
            now = both.filter(adds).unwrap_or(now);
        }
        now
    }

    /// The same hypothesis with the disturbances that suit it.
    pub fn retune(&self, judged: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        let (from, losses) = (Some(&judged.disturbances), &judged.losses);
        let disturbances = tune_disturbances(&self.flights[0], &judged.at_posterior(), from, losses);
        // tuned on a part of a flight, judged on all
        let retuned = self.rejudge(judged, &disturbances).filter(|retuned| retuned.loss < judged.loss);
        Some(retuned.unwrap_or_else(|| judged.clone()))
    }

    /// Proposals judged, without those that fall hopelessly behind the hypothesis that they are to beat.
    pub(super) fn judge_all(
        &self,
        proposals: &[Proposal],
        disturbances: &Disturbances,
        beside: &FilteredHypothesis,
    ) -> Vec<FilteredHypothesis> {
        let judge = |p: &Proposal| self.judge_against(p, disturbances, &beside.losses);
        proposals.par_iter().filter_map(judge).collect()
    }

    /// Proposals judged again from where they settled: what is then believed beforehand is as wide for every
    /// hypothesis, in its own standard errors, so that all pay the same for a parameter. Those far behind the best,
    /// or the given loss, are left out.
    pub(super) fn refine_nearest(&self, first: &[FilteredHypothesis], most: f64) -> Vec<FilteredHypothesis> {
        let least = first.iter().map(|j| j.loss).fold(f64::INFINITY, f64::min);
        let near =
            first.par_iter().filter(|j| j.loss < if most.is_finite() { most } else { least } + FAR_BEHIND);
        near.filter_map(|j| self.rejudge(j, &j.disturbances)).collect()
    }

    /// The same hypothesis judged from where it settled, under other disturbances.
    pub(super) fn rejudge(
        &self,
        judged: &FilteredHypothesis,
        disturbances: &Disturbances,
    ) -> Option<FilteredHypothesis> {
        self.judge(&judged.settled(), disturbances)
    }

    /// Returns the likeliest hypothesis with the same effects, one of them begun anew from the values that it gives
    /// ([`crazyflie_env::effects::Entry::starts`]): beside effects that were added later it may change its meaning. Disturbances that could
    /// mask it are tuned anew too.
    pub(super) fn restart(&self, judged: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        let settled = judged.at_posterior();
        let begun: Vec<_> = settled.terms.iter().flat_map(|term| Term::at_given_starts(term.entry)).collect();
        let anew = |term: Term| {
            let hypothesis = settled.without(term.entry.name).with(term);
            let fitted = Proposal::from_fit(&hypothesis, &self.fit(&hypothesis, None, STEPS));
            let first = self.judge(&fitted, &judged.disturbances)?;
            // a disturbance large enough to mask an effect may have stood for what this one explains
            if damped_in_turn(&judged.disturbances).is_empty() { Some(first) } else { self.retune(&first) }
        };
        begun.into_par_iter().filter_map(anew).min_by(|a, b| a.loss.total_cmp(&b.loss))
    }

    /// Proposals of all these newcomers, swings with other lengths too.
    pub(super) fn propose_all(&self, settled: &Hypothesis, all: &[&Score], base: &Solution) -> Vec<Proposal> {
        let fitted = all.par_iter().flat_map_iter(|score| self.propose(settled, score, base));
        let fitted: Vec<Proposal> = fitted.collect();
        let swings: Vec<Proposal> = fitted.iter().flat_map(|p| p.other_swings(settled)).collect();
        [fitted, swings].concat()
    }

    /// Proposals of a newcomer: windows see a delay in lost commands, and would make it that of a newcomer that
    /// delays. So these are fitted with the others, and kept as they are.
    pub(super) fn propose(&self, settled: &Hypothesis, score: &Score, base: &Solution) -> Vec<Proposal> {
        let held = settled.terms.iter().any(is_lossy).then(|| hold_losses(settled));
        let held = held.and_then(|held| self.propose_beside(&held, score, base));
        let released = held.map(|proposal| release_losses(proposal, settled));
        self.propose_beside(settled, score, base).into_iter().chain(released).collect()
    }

    fn propose_beside(&self, settled: &Hypothesis, score: &Score, base: &Solution) -> Option<Proposal> {
        let hypothesis = settled.with(score.start.clone());
        let solution = self.fit(&hypothesis, Some(&base.own), STEPS);
        let names: Vec<&str> = settled.terms.iter().map(|t| t.entry.name).collect();
        let fitted = Proposal::from_fit(&hypothesis, &solution).without_idle(&names);
        let newcomer = fitted.hypothesis.term(score.start.entry.name);
        newcomer.is_some_and(|term| !term.free.is_empty()).then_some(fitted)
    }
}

/// Returns the likeliest hypotheses with each newcomer, so many at most, sorted by name and loss: for a pendulum, the
/// best lengths are enough.
pub(super) fn likeliest_by_newcomer(
    mut judged: Vec<FilteredHypothesis>,
    before: &Hypothesis,
    most: usize,
) -> Vec<FilteredHypothesis> {
    let newcomer = |j: &FilteredHypothesis| j.newcomer(before);
    judged.sort_by(|a, b| newcomer(a).cmp(&newcomer(b)).then(a.loss.total_cmp(&b.loss)));
    let by_newcomer = judged.chunk_by(|a, b| newcomer(a) == newcomer(b));
    by_newcomer.flat_map(|alike| alike.iter().take(most).cloned()).collect()
}

/// The best scores that are worth a proposal.
pub(super) fn best_of(scores: &[Score], most: usize) -> impl Iterator<Item = &Score> {
    scores.iter().filter(|s| s.gain > LEAST_PROPOSAL).take(most)
}

/// Effects of which the windows found little beside what the slopes of the filter promise: where these lead.
fn promised(now: &FilteredHypothesis, scores: &[&Score], judged: &[FilteredHypothesis]) -> Vec<Proposal> {
    let found = |score: &Score| {
        let with = judged.iter().filter(|j| j.hypothesis.has(score.start.entry.name));
        with.map(|j| now.loss - j.loss).fold(0.0, f64::max)
    };
    let missed = scores.iter().filter(|s| s.gain > LEAST_JOINED.get() && found(s) < FOUND * s.gain);
    let ahead = missed.filter_map(|s| s.ahead.as_ref().map(|(term, sd)| now.settled().with(term, sd)));
    ahead.filter(|proposal| proposal.sd.iter().all(|sd| sd.is_finite())).collect()
}

/// Returns whether a fitted start is close to the measured one: position and velocity are the first numbers.
fn is_near(fitted: &[f64], measured: &[f64]) -> bool {
    let off = |i: usize| (fitted[i] - measured[i]).abs();
    (0..3).all(|i| off(i) < NEAR_M && off(3 + i) < NEAR_MPS)
}

#[cfg(test)]
mod tests;
