//! The search for effects. Windows of flights, fitted by output error, propose. The Kalman filter decides:
//! its innovations are independent of each other whatever shakes the vehicle.

use crazyflie_env::effects::{Entry, Geometry, Observability, Role};
use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;

pub use super::calibration::search::{CLEAR, LEAST_GAIN, MOST_EFFECTS};
use super::calibration::search::{
    ENOUGH, EVERY_TO_START, FAR_BEHIND, FOUND, KEPT, LEAST_INFORMATION, LEAST_JOINED, LEAST_PROPOSAL,
    LOSS_SD, NEAR_M, NEAR_MPS, SHORTLIST, SHORTLIST_DAMPED, STEPS, STEPS_TO_START, SWING_SD, SWINGS_M, TIGHT,
    WIDEN, WINDOWS_TO_PROPOSE,
};
use super::candidates::{Candidate, candidates};
use super::lost_commands::is_lossy;
use super::noise::{damped, masks_effects, penalty, tune_disturbances};
use crate::estimate::at_bound;
use crate::fit::filter::{Disturbances, ParameterPrior, filter};
use crate::fit::flight::{Flight, WINDOW_S, Window};
use crate::fit::hypothesis::{Hypothesis, Term};
use crate::fit::output_error::OutputErrorProblem;
use crate::fit::solve::{Solution, pseudo_inverse, solve_within};

/// A hypothesis judged by the filter: posterior of its parameters, disturbances and loss.
#[derive(Debug, Clone)]
pub struct FilteredHypothesis {
    /// Values as the windows have them.
    pub hypothesis: Hypothesis,
    /// As the filter has them after all flights of the fit.
    pub posterior: ParameterPrior,
    /// Random disturbances that the filter took to act.
    pub disturbances: Disturbances,
    /// Negative log-likelihood of the flights of the fit, the free parameters integrated out, and the penalty
    /// of the disturbances.
    pub loss: f64,
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

    /// Standard errors of the free parameters, those of an effect left out.
    pub(super) fn sd_without(&self, effect: &str) -> Vec<f64> {
        let place = self.hypothesis.place(effect);
        (0..self.posterior.mean.len()).filter(|i| !place.contains(i)).map(|i| self.posterior.sd(i)).collect()
    }

    /// Whether the first parameter of an effect, its strength, ran to a bound: something else is the cause.
    /// Of the exact geometry all is no bound.
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
    windows: Vec<Window>,
}

/// An effect proposed by the windows: the hypothesis with it, at the fitted values, and their standard
/// errors.
pub(super) struct Proposal {
    hypothesis: Hypothesis,
    sd: Vec<f64>,
}

impl Proposal {
    /// The same with other lengths of what swings in it.
    pub(super) fn other_swings(&self) -> Vec<Proposal> {
        let swings = |t: &&Term| t.entry.observability == Observability::Resonant;
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

/// A subset of the windows, with their starts and their loss.
struct WindowSubset<'a> {
    search: Search<'a>,
    own: Vec<Vec<f64>>,
    before: f64,
    /// All windows over those of the subset.
    scale: f64,
}

impl WindowSubset<'_> {
    /// Of an effect without a slope at "off": the start from which the windows gain most, and what it gains
    /// there.
    fn best_alternative_start(&self, hypothesis: &Hypothesis, starts: &[Term]) -> Option<Score> {
        let from = |start: &Term| {
            let with = hypothesis.with(start.clone());
            let solution = self.search.fit(&with, Some(&self.own), STEPS_TO_START);
            (self.scale * (self.before - solution.loss), with.with_values(&solution.shared))
        };
        let tried: Vec<(f64, Hypothesis)> = starts.par_iter().map(from).collect();
        let (gain, best) = tried.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let start = best.terms.into_iter().find(|t| t.entry.name == starts[0].entry.name)?;
        Some(Score { sd: vec![f64::INFINITY; start.free.len()], start, gain, ahead: None })
    }
}

/// The gain that an effect could bring.
#[derive(Debug, Clone)]
pub struct Score {
    /// Where to start its fit.
    pub start: Term,
    /// In units of log-likelihood, the other parameters following.
    pub gain: f64,
    /// Standard error of each of its free parameters that these flights allow, the other parameters unknown
    /// too.
    pub sd: Vec<f64>,
    /// Where the slopes of the filter lead, and how well they know that; nothing of a start that only the
    /// windows know.
    pub ahead: Option<(Term, Vec<f64>)>,
}

/// Scores of all effects, the best first.
pub(super) struct Scores {
    pub usual: Vec<Score>,
    /// Those with a slope at "off", under damped disturbances.
    damped: Vec<Score>,
    /// The windows' fit without any of them.
    pub base: Solution,
}

/// The best first, of one effect its best start.
fn best_first(mut scores: Vec<Score>) -> Vec<Score> {
    scores.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    let mut seen = Vec::new();
    scores.retain(|s| {
        !seen.contains(&s.start.entry.name) && {
            seen.push(s.start.entry.name);
            true
        }
    });
    scores
}

/// Quadratic model of the negative log-likelihood: its value, gradient and information at a point.
struct QuadraticModel {
    loss: f64,
    gradient: DVector<f64>,
    information: DMatrix<f64>,
}

impl QuadraticModel {
    /// The gain of the parameters at `place`, those at `known` following.
    fn score(&self, start: &Term, place: &[usize], known: &[usize]) -> Score {
        // a share of what is nothing yet has no slope: what rounding makes of it is no step
        let mut told: Vec<usize> =
            (0..place.len()).filter(|k| self.has_slope(place[*k], start, *k)).collect();
        let step_along = |told: &[usize]| {
            let place_told: Vec<usize> = told.iter().map(|k| place[*k]).collect();
            self.step(&place_told, known)
        };
        let mut step = step_along(&told);
        let mut sd = vec![f64::INFINITY; place.len()];
        for (k, at) in told.iter().enumerate() {
            sd[*at] = step.covariance[(k, k)].max(0.0).sqrt();
        }
        // a parameter that would leave its range, as a drag below zero, stays at its bound
        while let Some(k) = told.iter().zip(step.by.iter()).position(|(k, by)| is_outward(start, *k, *by)) {
            told.remove(k);
            step = step_along(&told);
        }
        let mut ahead = start.clone();
        for (k, by) in told.iter().zip(step.by.iter()) {
            let (i, p) = (start.free[*k], &start.entry.params[start.free[*k]]);
            ahead.values[i] = (ahead.values[i] + by).clamp(p.low, p.high);
        }
        ahead.free = told.iter().map(|k| start.free[*k]).collect();
        let sd_ahead = told.iter().map(|k| sd[*k]).collect();
        Score { start: start.clone(), gain: step.gain, sd, ahead: Some((ahead, sd_ahead)) }
    }

    /// Whether the whole range of a free parameter of a term would show.
    fn has_slope(&self, place: usize, term: &Term, k: usize) -> bool {
        let p = &term.entry.params[term.free[k]];
        self.information[(place, place)] * (p.high - p.low).powi(2) >= LEAST_INFORMATION
    }

    /// The step of the parameters at `place` to the least loss, those at `known` following.
    fn step(&self, place: &[usize], known: &[usize]) -> QuadraticStep {
        let block = |rows: &[usize], columns: &[usize]| {
            DMatrix::from_fn(rows.len(), columns.len(), |i, j| self.information[(rows[i], columns[j])])
        };
        let part = |rows: &[usize]| DVector::from_fn(rows.len(), |i, _| self.gradient[rows[i]]);
        let inverted = |matrix: &DMatrix<f64>| {
            pseudo_inverse(matrix).unwrap_or_else(|| DMatrix::zeros(matrix.nrows(), matrix.nrows()))
        };
        let finite = |matrix: &DMatrix<f64>| matrix.map(|v| if v.is_finite() { v } else { 0.0 });
        let across = block(place, known);
        let inverse = finite(&inverted(&block(known, known)));
        let information = block(place, place) - &across * &inverse * across.transpose();
        let gradient = part(place) - &across * &inverse * part(known);
        let covariance = inverted(&information);
        let by = finite(&covariance) * &gradient;
        QuadraticStep { gain: 0.5 * gradient.dot(&by), by, covariance }
    }
}

/// A step of some parameters to the least loss of a [`QuadraticModel`].
struct QuadraticStep {
    by: DVector<f64>,
    /// Loss that it takes off.
    gain: f64,
    /// Of the parameters there.
    covariance: DMatrix<f64>,
}

/// Whether a step takes the `k`-th free parameter of a term out of its range.
fn is_outward(term: &Term, k: usize, by: f64) -> bool {
    let (value, p) = (term.values[term.free[k]], &term.entry.params[term.free[k]]);
    (value <= p.low && by < 0.0) || (value >= p.high && by > 0.0)
}

/// From the lowest to the highest value of a free parameter.
fn joint_range(hypothesis: &Hypothesis, i: usize) -> f64 {
    let [low, high] = hypothesis.bounds()[i];
    high - low
}

impl<'a> Search<'a> {
    /// Prepares a search: cuts the flights into windows of [`WINDOW_S`] and keeps an even selection of them.
    pub fn new(flights: &'a [Flight]) -> Self {
        let all: Vec<Window> = flights.iter().enumerate().flat_map(|(i, f)| f.windows(i, WINDOW_S)).collect();
        let every = all.len().div_ceil(WINDOWS_TO_PROPOSE).max(1);
        Search { flights, windows: all.into_iter().step_by(every).collect() }
    }

    /// Physics steps per second of a search: so many per tick, what only chooses need not be exact.
    fn rough_hz(&self, per_tick: u32) -> u32 {
        per_tick * (1.0 / self.flights[0].tick_s).round() as u32
    }

    /// A hypothesis judged as a search judges.
    pub fn judge_roughly(&self, judged: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        self.with_physics_hz(judged, Some(self.rough_hz(2)))
    }

    /// And as exactly as its effects ask for.
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
        let hypothesis = &Hypothesis {
            max_physics_hz: hypothesis.max_physics_hz.or(Some(self.rough_hz(2))),
            ..hypothesis.clone()
        };
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
        let ranges = hypothesis.bounds();
        let mut wide: Vec<f64> =
            sd.iter().zip(&ranges).map(|(sd, [low, high])| (WIDEN * sd).min(0.25 * (high - low))).collect();
        // the filter learns from the mean alone, where lost commands are a delay; what they are shows in the
        // spread, which the last word on the parameters weighs
        for term in hypothesis.terms.iter().filter(|t| is_lossy(t)) {
            wide[hypothesis.place(term.entry.name)].fill(LOSS_SD);
        }
        let mut prior = ParameterPrior::independent(hypothesis.free_values(), &wide);
        let mut loss = penalty(disturbances);
        for flight in self.flights {
            let filtered = filter(flight, flight.all_ticks(), hypothesis, &prior, disturbances)?;
            loss += filtered.loss;
            prior = filtered.posterior;
        }
        Some(FilteredHypothesis {
            hypothesis: hypothesis.clone(),
            posterior: prior,
            disturbances: *disturbances,
            loss,
        })
    }

    /// Negative log-likelihood with all parameters as they are.
    pub fn plug_in(&self, hypothesis: &Hypothesis, disturbances: &Disturbances) -> Option<f64> {
        let nothing = ParameterPrior::independent(Vec::new(), &[]);
        let fixed = hypothesis.without_free();
        self.flights
            .iter()
            .map(|f| filter(f, f.all_ticks(), &fixed, &nothing, disturbances).map(|f| f.loss))
            .sum()
    }

    /// The declared model, with what is random about the flight.
    pub fn judge_declared(&self, hypothesis: &Hypothesis) -> Option<FilteredHypothesis> {
        let disturbances = tune_disturbances(&self.flights[0], hypothesis, None);
        self.judge(hypothesis, &[], &disturbances)
    }

    /// The hypothesis fitted anew, disturbances tuned, judged.
    pub fn refit(&self, hypothesis: &Hypothesis, disturbances: &Disturbances) -> Option<FilteredHypothesis> {
        let solution = self.fit(hypothesis, None, STEPS);
        let (fitted, sd) =
            drop_idle_parameters(&hypothesis.with_values(&solution.shared), &standard_errors(&solution), &[]);
        let first = self.judge(&fitted, &sd, disturbances)?;
        let disturbances = tune_disturbances(&self.flights[0], &first.at_posterior(), Some(disturbances));
        self.judge(&fitted, &sd, &disturbances)
    }

    /// One more effect: all scores, and the best by the filter of those that score highest.
    pub fn extend(&self, now: &FilteredHypothesis) -> (Vec<Score>, Option<FilteredHypothesis>) {
        // what is missing for good may pass for a disturbance that wanders slowly: under damped disturbances
        // it would stand out
        let damped = Some(damped(&now.disturbances)).filter(|_| masks_effects(&now.disturbances));
        let Some(Scores { usual: scored, damped: damped_scores, base }) = self.score(now, damped.as_ref())
        else {
            return (Vec::new(), None);
        };
        let settled = now.at_posterior();
        let worth = |s: &&Score| s.gain > LEAST_PROPOSAL;
        let mut worthy: Vec<&Score> = scored.iter().filter(worth).take(SHORTLIST).collect();
        let seen =
            |worthy: &[&Score], s: &Score| worthy.iter().any(|w| w.start.entry.name == s.start.entry.name);
        let more: Vec<&Score> =
            damped_scores.iter().filter(worth).filter(|s| !seen(&worthy, s)).take(SHORTLIST_DAMPED).collect();
        worthy.extend(more);
        let mut proposals: Vec<Proposal> =
            worthy.par_iter().filter_map(|s| self.propose(&settled, s, &base)).collect();
        let swings: Vec<Proposal> = proposals.iter().flat_map(Proposal::other_swings).collect();
        proposals.extend(swings);
        let mut first = self.judge_all(&proposals, &now.disturbances);
        let promised = promised(now, &worthy, &first);
        first.extend(self.judge_all(&promised, &now.disturbances));
        let mut judged = self.refine_nearest(&first, f64::INFINITY);
        judged.extend(
            damped
                .iter()
                .flat_map(|damped| self.refine_nearest(&self.judge_all(&proposals, damped), now.loss)),
        );
        let best = judged.into_iter().min_by(|a, b| a.loss.total_cmp(&b.loss));
        (scored, best.and_then(|best| self.retune(&self.join_round(best, first, now))))
    }

    /// The best hypothesis of a round, and besides what others of the round added, as long as it keeps half
    /// of what it gained alone: what is missing in several ways takes one round, not several.
    fn join_round(
        &self,
        best: FilteredHypothesis,
        mut others: Vec<FilteredHypothesis>,
        before: &FilteredHypothesis,
    ) -> FilteredHypothesis {
        others.retain(|other| before.loss - other.loss > LEAST_JOINED);
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
                    now.loss - both.loss > KEPT * alone && both.hypothesis.terms.len() <= MOST_EFFECTS
                })
                .unwrap_or(now);
        }
        now
    }

    /// The same hypothesis with the disturbances that suit it.
    pub fn retune(&self, judged: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        let disturbances =
            tune_disturbances(&self.flights[0], &judged.at_posterior(), Some(&judged.disturbances));
        // tuned on a part of a flight, judged on all
        let retuned = self.rejudge(judged, &disturbances).filter(|retuned| retuned.loss < judged.loss);
        Some(retuned.unwrap_or_else(|| judged.clone()))
    }

    pub(super) fn judge_all(
        &self,
        proposals: &[Proposal],
        disturbances: &Disturbances,
    ) -> Vec<FilteredHypothesis> {
        proposals.par_iter().filter_map(|p| self.judge(&p.hypothesis, &p.sd, disturbances)).collect()
    }

    /// Proposals judged again from where they settled: what is then believed beforehand is as wide for every
    /// hypothesis, in its own standard errors, so that all pay the same for a parameter. Those far behind the
    /// best, or the loss that is asked for, are left out.
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

    /// Scores of all effects, from one filter run that carries the parameters of all of them, each close to
    /// "off". An effect without a slope at "off" is tried from other starts, on the windows, whose fit comes
    /// along.
    pub(super) fn score(&self, now: &FilteredHypothesis, damped: Option<&Disturbances>) -> Option<Scores> {
        let settled = now.at_posterior();
        let fixed = settled.without_free();
        let all = candidates(&settled);
        let mut joint = settled.clone();
        joint.max_physics_hz = Some(self.rough_hz(1));
        for candidate in &all {
            joint = joint.with(candidate.starts[0].clone());
        }
        let (model, (damped_model, base)) = rayon::join(
            || self.quadratic_model(&joint, &now.disturbances),
            || {
                rayon::join(
                    || damped.and_then(|damped| self.quadratic_model(&joint, damped)),
                    || self.fit(&fixed, None, STEPS),
                )
            },
        );
        let (model, subset) = (model?, self.window_subset(&fixed, &base));
        let known: Vec<usize> = settled
            .terms
            .iter()
            .flat_map(|t| joint.place(t.entry.name))
            .chain(0..settled.free.len())
            .collect();
        let candidate_scores = |candidate: &Candidate| {
            let place: Vec<usize> = joint.place(candidate.entry.name).collect();
            let has_no_slope = place
                .iter()
                .all(|i| model.information[(*i, *i)] * joint_range(&joint, *i).powi(2) < LEAST_INFORMATION);
            let here = (!has_no_slope).then(|| model.score(&candidate.starts[0], &place, &known));
            let elsewhere =
                if has_no_slope { &candidate.starts[..] } else { &candidate.starts[..candidate.variants] };
            let tried = has_no_slope || candidate.variants > 1;
            let there = if tried { subset.best_alternative_start(&fixed, elsewhere) } else { None };
            here.into_iter().chain(there).collect::<Vec<Score>>()
        };
        let usual = best_first(all.par_iter().flat_map_iter(candidate_scores).collect());
        let stands_out = |(candidate, model): (&Candidate, &QuadraticModel)| {
            model.score(
                &candidate.starts[0],
                &joint.place(candidate.entry.name).collect::<Vec<usize>>(),
                &known,
            )
        };
        let damped = best_first(all.iter().zip(damped_model.iter().cycle()).map(stands_out).collect());
        Some(Scores { usual, damped, base })
    }

    /// A part of the windows, which will do to choose where to start.
    fn window_subset(&self, hypothesis: &Hypothesis, base: &Solution) -> WindowSubset<'_> {
        let some: Vec<usize> = (0..self.windows.len()).step_by(EVERY_TO_START).collect();
        let own: Vec<Vec<f64>> = some.iter().map(|i| base.own[*i].clone()).collect();
        let search = Search {
            flights: self.flights,
            windows: some.iter().map(|i| self.windows[*i].clone()).collect(),
        };
        // as many steps as with an effect, or what they gain by themselves would be taken for its gain
        let before = search.fit(hypothesis, Some(&own), STEPS_TO_START).loss;
        WindowSubset { search, own, before, scale: self.windows.len() as f64 / some.len() as f64 }
    }

    /// Likelihood, gradient and information at a hypothesis, by the filter with parameters known to a
    /// hundredth of their range.
    fn quadratic_model(
        &self,
        hypothesis: &Hypothesis,
        disturbances: &Disturbances,
    ) -> Option<QuadraticModel> {
        let ranges: Vec<f64> =
            (0..hypothesis.free_values().len()).map(|i| TIGHT * joint_range(hypothesis, i)).collect();
        let prior = ParameterPrior::independent(hypothesis.free_values(), &ranges);
        let mut model = QuadraticModel {
            loss: 0.0,
            gradient: DVector::zeros(ranges.len()),
            information: DMatrix::zeros(ranges.len(), ranges.len()),
        };
        for flight in self.flights {
            let filtered = filter(flight, flight.all_ticks(), hypothesis, &prior, disturbances)?;
            let n = ranges.len();
            let covariance = DMatrix::from_row_slice(n, n, &filtered.posterior.covariance);
            // in units of the prior, for the sake of the inverse
            let scaled = DMatrix::from_fn(n, n, |i, j| covariance[(i, j)] / (ranges[i] * ranges[j]));
            let precision = Cholesky::new(scaled)?.inverse();
            let step = DVector::from_fn(n, |i, _| (filtered.posterior.mean[i] - prior.mean[i]) / ranges[i]);
            let gradient = &precision * step;
            for i in 0..n {
                model.gradient[i] += gradient[i] / ranges[i];
                for j in 0..n {
                    let own = if i == j { 1.0 } else { 0.0 };
                    model.information[(i, j)] += (precision[(i, j)] - own) / (ranges[i] * ranges[j]);
                }
            }
            model.loss += filtered.loss;
        }
        Some(model)
    }

    pub(super) fn propose(&self, settled: &Hypothesis, score: &Score, base: &Solution) -> Option<Proposal> {
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

/// Effects of which the windows found little beside what the slopes of the filter promise: where these lead.
fn promised(now: &FilteredHypothesis, scores: &[&Score], judged: &[FilteredHypothesis]) -> Vec<Proposal> {
    let found = |score: &Score| {
        let with = judged.iter().filter(|j| j.hypothesis.has(score.start.entry.name));
        with.map(|j| now.loss - j.loss).fold(0.0, f64::max)
    };
    let missed = scores.iter().filter(|s| s.gain > LEAST_JOINED && found(s) < FOUND * s.gain);
    missed
        .filter_map(|s| {
            let (term, sd) = s.ahead.as_ref()?;
            let (hypothesis, sd) = now.with_term(term, sd);
            sd.iter().all(|sd| sd.is_finite()).then_some(Proposal { hypothesis, sd })
        })
        .collect()
}

/// Whether a fitted start lies where the vehicle was measured: position and velocity come first.
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

/// The hypothesis without free parameters that the windows do not determine. Those of `settled` effects stay
/// free: beside a newcomer that does the same, only the filter can say which stays.
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
