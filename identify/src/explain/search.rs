//! The search for effects. Windows of flights, fitted by output error, propose. The Kalman filter decides:
//! its innovations are independent of each other whatever shakes the vehicle.

use crazyflie_env::effects::{Entry, Geometry, Observability, Role};
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
        self.hypothesis
            .terms
            .iter()
            .any(|term| before.term(term.entry.name).is_some_and(|held| moves(term, held)))
    }

    /// Standard errors of the free parameters, those of an effect left out.
    pub(super) fn sd_without(&self, effect: &str) -> Vec<f64> {
        let place = self.hypothesis.place(effect);
        (0..self.posterior.mean.len()).filter(|i| !place.contains(i)).map(|i| self.posterior.sd(i)).collect()
    }

    /// Returns whether the first parameter of an effect, its strength, ran to a bound: then something else is the
    /// cause. The full exact geometry does not count as a bound.
    pub(super) fn is_at_bound(&self, effect: &str) -> bool {
        let Some(term) = self
            .hypothesis
            .term(effect)
            .filter(|t| t.entry.geometry == Geometry::None && t.free.first() == Some(&0))
        else {
            return false;
        };
        let (p, at) = (&term.entry.params[0], self.hypothesis.place(effect).start);
        let value = self.posterior.mean[at].clamp(p.low, p.high);
        value != p.off && at_bound(value, [p.low, p.high])
    }

    /// The hypothesis at the filter's values.
    pub fn at_posterior(&self) -> Hypothesis {
        let bounds = self.hypothesis.bounds();
        let inside: Vec<f64> =
            self.posterior.mean.iter().zip(bounds).map(|(v, [low, high])| v.clamp(low, high)).collect();
        self.hypothesis.with_values(&inside)
    }

    /// The settled hypothesis with one more effect, and how well the free parameters are known, those of the
    /// effect about as well as `sd`.
    pub fn with_term(&self, term: &Term, sd: &[f64]) -> (Hypothesis, Vec<f64>) {
        let hypothesis = self.at_posterior().with(term.clone());
        let mut known: Vec<f64> = (0..self.posterior.mean.len()).map(|i| self.posterior.sd(i)).collect();
        let place = hypothesis.place(term.entry.name);
        known.splice(place.start..place.start, sd.iter().copied());
        (hypothesis, known)
    }
}

/// The flights of a fit with the windows that propose.
pub struct Search<'a> {
    /// Flights that hypotheses are fitted to.
    pub flights: &'a [Flight],
    pub(super) windows: Vec<Window>,
}

/// An effect proposed by the windows: the hypothesis with it, at the fitted values, and their standard
/// errors.
pub(super) struct Proposal {
    hypothesis: Hypothesis,
    sd: Vec<f64>,
}

impl Proposal {
    /// The newcomer as it was fitted, in the place of an effect of another hypothesis whose other effects stay as
    /// they are: beside one that does the same they need not move.
    pub(super) fn in_place(&self, judged: &FilteredHypothesis, effect: &str) -> Option<Proposal> {
        let newcomer = self.hypothesis.terms.iter().find(|t| !judged.hypothesis.has(t.entry.name))?;
        let place = self.hypothesis.place(newcomer.entry.name);
        let hypothesis = judged.at_posterior().without(effect).with(newcomer.clone());
        let mut sd = judged.sd_without(effect);
        let at = hypothesis.place(newcomer.entry.name).start;
        sd.splice(at..at, self.sd[place].iter().copied());
        Some(Proposal { hypothesis, sd })
    }

    /// The same with other lengths of what swings in it, if that is new to the settled hypothesis.
    pub(super) fn other_swings(&self, settled: &Hypothesis) -> Vec<Proposal> {
        let swings =
            |t: &&Term| t.entry.observability == Observability::Resonant && !settled.has(t.entry.name);
        let Some(term) = self.hypothesis.terms.iter().find(swings) else { return Vec::new() };
        let Some(length) = term.free.iter().position(|i| term.entry.params[*i].unit == "m") else {
            return Vec::new();
        };
        let place = self.hypothesis.place(term.entry.name).start + length;
        let with_length = |length_m: f64| {
            let mut other = Proposal { hypothesis: self.hypothesis.clone(), sd: self.sd.clone() };
            let mut values = other.hypothesis.free_values();
            values[place] = length_m;
            other.hypothesis = other.hypothesis.with_values(&values);
            other.sd[place] = SWING_SD * length_m;
            other
        };
        SWINGS_M.into_iter().map(with_length).collect()
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
        self.with_physics_hz(judged, Some(self.rough_hz(2)))
    }

    /// Judges a hypothesis with the finest integration step that any of its effects needs.
    pub fn judge_exactly(&self, judged: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        self.with_physics_hz(judged, None)
    }

    fn with_physics_hz(
        &self,
        judged: &FilteredHypothesis,
        max_physics_hz: Option<u32>,
    ) -> Option<FilteredHypothesis> {
        let mut other = judged.clone();
        other.hypothesis.max_physics_hz = max_physics_hz;
        self.rejudge(&other, &judged.disturbances)
    }

    /// Fits the free numbers of a hypothesis to the windows, in at most `most_steps` steps.
    /// The windows start from `own`, the starts of an earlier fit, or as measured.
    pub fn fit(&self, hypothesis: &Hypothesis, own: Option<&[Vec<f64>]>, most_steps: usize) -> Solution {
        let hypothesis = &self.rough(hypothesis);
        let prediction =
            OutputErrorProblem { flights: self.flights, windows: &self.windows, hypothesis, inflation: 1.0 };
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

    /// Filters a hypothesis whose free parameters are known about as well as `sd`.
    pub fn judge(
        &self,
        hypothesis: &Hypothesis,
        sd: &[f64],
        disturbances: &Disturbances,
    ) -> Option<FilteredHypothesis> {
        self.judge_against(hypothesis, sd, disturbances, &[])
    }

    /// Judges like [`Search::judge`]. Returns `None` also for a hypothesis that falls hopelessly behind these losses,
    /// see [`FilteredHypothesis::losses`].
    pub(super) fn judge_against(
        &self,
        hypothesis: &Hypothesis,
        sd: &[f64],
        disturbances: &Disturbances,
        least: &[f64],
    ) -> Option<FilteredHypothesis> {
        let ranges = hypothesis.bounds();
        let mut wide: Vec<f64> = sd
            .iter()
            .zip(&ranges)
            .map(|(sd, [low, high])| (WIDEN.get() * sd).min(0.25 * (high - low)))
            .collect();
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
        let first = self.judge(hypothesis, &[], &disturbances)?;
        if is_outlying(&self.flights[0], &first.losses) { self.retune(&first) } else { Some(first) }
    }

    /// The hypothesis fitted anew, disturbances tuned, judged.
    pub fn refit(&self, hypothesis: &Hypothesis, disturbances: &Disturbances) -> Option<FilteredHypothesis> {
        let solution = self.fit(hypothesis, None, STEPS);
        let (fitted, sd) =
            drop_idle_parameters(&hypothesis.with_values(&solution.shared), &standard_errors(&solution), &[]);
        let first = self.judge(&fitted, &sd, disturbances)?;
        let disturbances =
            tune_disturbances(&self.flights[0], &first.at_posterior(), Some(disturbances), &first.losses);
        self.judge(&fitted, &sd, &disturbances)
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
        let mut proposals: Vec<Proposal> =
            worthy.par_iter().flat_map_iter(|s| self.propose(&settled, s, &base)).collect();
        let swings: Vec<Proposal> = proposals.iter().flat_map(|p| p.other_swings(&settled)).collect();
        proposals.extend(swings);
        let mut first = self.judge_all(&proposals, &now.disturbances, now);
        let promised = promised(now, &worthy, &first);
        first.extend(self.judge_all(&promised, &now.disturbances, now));
        let first = likeliest_by_newcomer(first, &now.hypothesis, MOST_REFINED);
        let judged = self.refine_nearest(&first, f64::INFINITY);
        // what runs to a bound would be taken out at the end, and may stand in the way of the cause until then
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
        let (mut hypothesis, mut sd) = (settled.clone(), Vec::new());
        sd.extend((0..settled.free.len()).map(|i| now.posterior.sd(i)));
        for (at, term) in settled.terms.iter().enumerate() {
            let first = settled.place(term.entry.name).start;
            let more = term.clone().with_companions();
            sd.extend(more.free.iter().map(|i| {
                let known = term.free.iter().position(|free| free == i);
                let p = &term.entry.params[*i];
                known.map_or(COMPANION_SHARE * (p.high - p.low), |k| now.posterior.sd(first + k))
            }));
            hypothesis.terms[at] = more;
        }
        if sd.len() == settled.free_values().len() {
            return now;
        }
        let gains = |told: &FilteredHypothesis| now.loss - told.loss > LEAST_GAIN.get();
        let told = self.judge(&hypothesis, &sd, &now.disturbances).filter(gains);
        // beside quite another value of it, the amount may be another too
        let anew = || self.refit(&hypothesis, &now.disturbances).filter(gains);
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
            let (hypothesis, sd) = now.with_term(term, &sd);
            let both = self.judge(&hypothesis, &sd, &now.disturbances);
            now = both
                .filter(|both| {
                    now.loss - both.loss > KEPT.get() * alone && both.hypothesis.terms.len() <= MOST_EFFECTS
                })
                .unwrap_or(now);
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
        let judge = |p: &Proposal| self.judge_against(&p.hypothesis, &p.sd, disturbances, &beside.losses);
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
        let sd: Vec<f64> = (0..judged.posterior.mean.len()).map(|i| judged.posterior.sd(i)).collect();
        self.judge(&judged.at_posterior(), &sd, disturbances)
    }

    /// Returns the likeliest hypothesis with the same effects, one of them begun anew from the values that it gives
    /// ([`Entry::starts`]): beside effects that were added later it may change its meaning. Disturbances that could
    /// mask it are tuned anew too.
    pub(super) fn restart(&self, judged: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        let settled = judged.at_posterior();
        let begun = settled.terms.iter().flat_map(|term| {
            let values = term.entry.starts.chunks_exact(term.entry.params.len());
            values.map(|values| Term { values: values.to_vec(), ..Term::off(term.entry) })
        });
        let anew = |term: Term| {
            let hypothesis = settled.without(term.entry.name).with(term);
            let solution = self.fit(&hypothesis, None, STEPS);
            let fitted = hypothesis.with_values(&solution.shared);
            let first = self.judge(&fitted, &standard_errors(&solution), &judged.disturbances)?;
            // a disturbance large enough to mask an effect may have stood for what this one explains
            if damped_in_turn(&judged.disturbances).is_empty() { Some(first) } else { self.retune(&first) }
        };
        let all: Vec<Term> = begun.collect();
        all.into_par_iter().filter_map(anew).min_by(|a, b| a.loss.total_cmp(&b.loss))
    }

    /// Proposals of a newcomer: windows see a delay in lost commands, and would make it that of a newcomer that
    /// delays. So these are fitted with the others, and kept as they are.
    pub(super) fn propose(&self, settled: &Hypothesis, score: &Score, base: &Solution) -> Vec<Proposal> {
        let held = settled.terms.iter().any(is_lossy).then(|| hold_losses(settled));
        let released = |proposal: Proposal| {
            let (hypothesis, sd) = release_losses(proposal.hypothesis, proposal.sd, settled);
            Proposal { hypothesis, sd }
        };
        let held = held.and_then(|held| self.propose_beside(&held, score, base)).map(released);
        self.propose_beside(settled, score, base).into_iter().chain(held).collect()
    }

    fn propose_beside(&self, settled: &Hypothesis, score: &Score, base: &Solution) -> Option<Proposal> {
        let hypothesis = settled.with(score.start.clone());
        let solution = self.fit(&hypothesis, Some(&base.own), STEPS);
        let settled_names: Vec<&str> = settled.terms.iter().map(|t| t.entry.name).collect();
        let (fitted, sd) = drop_idle_parameters(
            &hypothesis.with_values(&solution.shared),
            &standard_errors(&solution),
            &settled_names,
        );
        let useful =
            fitted.terms.iter().any(|t| t.entry.name == score.start.entry.name && !t.free.is_empty());
        useful.then_some(Proposal { hypothesis: fitted, sd })
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
    missed
        .filter_map(|s| {
            let (term, sd) = s.ahead.as_ref()?;
            let (hypothesis, sd) = now.with_term(term, sd);
            sd.iter().all(|sd| sd.is_finite()).then_some(Proposal { hypothesis, sd })
        })
        .collect()
}

/// Returns whether a fitted start is close to the measured one: position and velocity are the first numbers.
fn is_near(fitted: &[f64], measured: &[f64]) -> bool {
    let off = |i: usize| (fitted[i] - measured[i]).abs();
    (0..3).all(|i| off(i) < NEAR_M && off(3 + i) < NEAR_MPS)
}

/// Standard errors of a fit by windows, each its own cluster.
pub fn standard_errors(solution: &Solution) -> Vec<f64> {
    let clusters: Vec<usize> = (0..solution.reduced.len()).collect();
    let covariance = solution.covariance(&clusters);
    (0..solution.shared.len())
        .map(|i| covariance.as_ref().map_or(f64::INFINITY, |c| c[(i, i)].max(0.0).sqrt()))
        .collect()
}

/// The hypothesis without free parameters that the windows do not determine. Those of `settled` effects stay free:
/// beside a newcomer that does the same, only the filter decides which stays.
fn drop_idle_parameters(hypothesis: &Hypothesis, sd: &[f64], settled: &[&str]) -> (Hypothesis, Vec<f64>) {
    let mut kept = hypothesis.clone();
    let mut known = sd[..hypothesis.free.len()].to_vec();
    let mut rest = sd[hypothesis.free.len()..].iter();
    for term in &mut kept.terms {
        let entry: &'static Entry = term.entry;
        let stays = settled.contains(&entry.name);
        let range = |i: usize| entry.params[i].high - entry.params[i].low;
        let bounded = |i: usize, sd: f64| if sd.is_finite() { sd.min(range(i)) } else { range(i) };
        let free = term
            .free
            .iter()
            .zip(rest.by_ref())
            .filter(|(i, sd)| stays || (sd.is_finite() && **sd < range(**i)));
        let free: Vec<(usize, f64)> = free.map(|(i, sd)| (*i, bounded(*i, *sd))).collect();
        term.free = free.iter().map(|(i, _)| *i).collect();
        known.extend(free.iter().map(|(_, sd)| *sd));
    }
    (kept, known)
}

#[cfg(test)]
mod tests;
