//! Which effects earn their place. Windows of flights, fitted by output error, propose; the Kalman filter, whose residuals are independent of each
//! other whatever shakes the vehicle, decides.

use crazyflie_env::effects::{self, Entry, Geometry, Observability};
use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;

use super::calibration::search::{
    BEYOND, ENOUGH, EVERY_TO_START, FAR_BEHIND, KEPT, LAG_PRICE, LEAST_JOINED, LEAST_PROPOSAL, LEAST_SHARE, NEAR_M, NEAR_MPS, NEARLY,
    PROBABILITIES, PROBABILITY_SD, SHORTLIST, SHORTLIST_IN_CALM, STEPS, STEPS_TO_START, TIGHT, TUNED, WIDEN, WINDOWS_TO_PROPOSE,
};
pub use super::calibration::search::{CLEAR, LEAST_GAIN, MOST_EFFECTS};
use super::calibration::verdict::MOST_RIVALS;
use super::candidates::{Candidate, candidates};
use super::noise::{FLOOR, calm, loud, price, tune};
use crate::estimate::at_bound;
use crate::fit::filter::{Belief, Disturbances, filter};
use crate::fit::flight::{Flight, WINDOW_S, Window};
use crate::fit::hypothesis::{Hypothesis, Term};
use crate::fit::predict::Prediction;
use crate::fit::solve::{Solution, pseudo_inverse, solve_within};

/// A hypothesis with what the flights say of it.
#[derive(Debug, Clone)]
pub struct FilteredHypothesis {
    /// Values as the windows have them.
    pub hypothesis: Hypothesis,
    /// As the filter has them after all flights of the fit.
    pub belief: Belief,
    pub disturbances: Disturbances,
    /// Negative log-likelihood of the flights of the fit, the free parameters integrated out, and the price of the disturbances.
    pub loss: f64,
}

/// A hypothesis, and each that lacks one of its effects.
#[derive(Debug, Clone)]
pub struct Ablation {
    pub judged: FilteredHypothesis,
    pub without: Vec<(&'static str, FilteredHypothesis)>,
    /// The most that an effect was worth which was taken out, because its size was unclear.
    pub unclear: f64,
    /// As it was before the last effect was taken out whose size was clear, and that was worth most of what it must be.
    pub nearly: Option<FilteredHypothesis>,
}

impl FilteredHypothesis {
    /// How many standard errors lie between "off" and the value of an effect's clearest parameter.
    pub fn clearance(&self, effect: &str) -> f64 {
        let place = self.hypothesis.place(effect);
        let Some(term) = self.hypothesis.term(effect) else { return 0.0 };
        let of = |(i, at): (&usize, usize)| (self.belief.mean[at] - term.entry.params[*i].off).abs() / self.belief.sd(at);
        term.free.iter().zip(place).map(of).fold(0.0, f64::max)
    }

    /// Whether the first parameter of an effect, its strength, ran to a bound: something else is the cause. Of the exact geometry all is no bound.
    fn is_at_bound(&self, effect: &str) -> bool {
        let Some(term) = self.hypothesis.term(effect).filter(|t| t.entry.geometry == Geometry::None && t.free.first() == Some(&0)) else {
            return false;
        };
        let (p, at) = (&term.entry.params[0], self.hypothesis.place(effect).start);
        let value = self.belief.mean[at].clamp(p.low, p.high);
        value != p.off && at_bound(value, [p.low, p.high])
    }

    /// The hypothesis at the filter's values.
    pub fn settled(&self) -> Hypothesis {
        let bounds = self.hypothesis.bounds();
        let inside: Vec<f64> = self.belief.mean.iter().zip(bounds).map(|(v, [low, high])| v.clamp(low, high)).collect();
        self.hypothesis.at(&inside)
    }

    /// The settled hypothesis with one more effect, and how well the free parameters are known, those of the effect about as well as `sd`.
    pub fn and(&self, term: &Term, sd: &[f64]) -> (Hypothesis, Vec<f64>) {
        let hypothesis = self.settled().with(term.clone());
        let mut known: Vec<f64> = (0..self.belief.mean.len()).map(|i| self.belief.sd(i)).collect();
        let place = hypothesis.place(term.entry.name);
        known.splice(place.start..place.start, sd.iter().copied());
        (hypothesis, known)
    }
}

/// The flights of a fit with the windows that propose.
pub struct Search<'a> {
    pub flights: &'a [Flight],
    windows: Vec<Window>,
}

/// An effect proposed by the windows: the hypothesis with it, at the fitted values, and their standard errors.
struct Proposal {
    hypothesis: Hypothesis,
    sd: Vec<f64>,
}

/// Some of the windows, with their starts and their loss.
struct Sample<'a> {
    search: Search<'a>,
    own: Vec<Vec<f64>>,
    before: f64,
    /// How many times as many windows there are.
    of_all: f64,
}

impl Sample<'_> {
    /// Of an effect without a slope at "off": the start from which the windows gain most, and what it gains there.
    fn start_elsewhere(&self, at: &Hypothesis, starts: &[Term]) -> Option<Score> {
        let from = |start: &Term| {
            let with = at.with(start.clone());
            let solution = self.search.fit(&with, Some(&self.own), STEPS_TO_START);
            (self.of_all * (self.before - solution.loss), with.at(&solution.shared))
        };
        let tried: Vec<(f64, Hypothesis)> = starts.par_iter().map(from).collect();
        let (gain, best) = tried.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let start = best.terms.into_iter().find(|t| t.entry.name == starts[0].entry.name)?;
        Some(Score { sd: vec![f64::INFINITY; start.free.len()], start, gain })
    }
}

/// What an effect could gain.
#[derive(Debug, Clone)]
pub struct Score {
    /// Where to start its fit.
    pub start: Term,
    /// In units of log-likelihood, the other parameters following.
    pub gain: f64,
    /// Standard error of each of its free parameters that these flights allow, the other parameters unknown too.
    pub sd: Vec<f64>,
}

/// What all effects could gain, the best first.
struct Scores {
    usual: Vec<Score>,
    /// Those with a slope at "off", if little were random.
    in_calm: Vec<Score>,
    /// The windows' fit without any of them.
    base: Solution,
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

/// A likelihood to second order.
struct Jet {
    loss: f64,
    gradient: DVector<f64>,
    information: DMatrix<f64>,
}

impl Jet {
    /// The gain of the parameters at `place`, those at `known` following.
    fn score(&self, start: &Term, place: &[usize], known: &[usize]) -> Score {
        let block =
            |rows: &[usize], columns: &[usize]| DMatrix::from_fn(rows.len(), columns.len(), |i, j| self.information[(rows[i], columns[j])]);
        let part = |rows: &[usize]| DVector::from_fn(rows.len(), |i, _| self.gradient[rows[i]]);
        let across = block(place, known);
        let inverse = pseudo_inverse(&block(known, known)).unwrap_or_else(|| DMatrix::zeros(known.len(), known.len()));
        let inverse = inverse.map(|v| if v.is_finite() { v } else { 0.0 });
        let information = block(place, place) - &across * &inverse * across.transpose();
        let gradient = part(place) - &across * &inverse * part(known);
        let covariance = pseudo_inverse(&information).unwrap_or_else(|| DMatrix::zeros(place.len(), place.len()));
        let sd = (0..place.len()).map(|i| covariance[(i, i)].max(0.0).sqrt()).collect();
        let usable = covariance.map(|v| if v.is_finite() { v } else { 0.0 });
        let step = &usable * &gradient;
        let entry = start.entry;
        // a step out of the range, as of a drag below zero, gains nothing
        let outward = |(k, i): (usize, &usize)| {
            let p = &entry.params[*i];
            (start.values[*i] <= p.low && step[k] < 0.0) || (start.values[*i] >= p.high && step[k] > 0.0)
        };
        let gains = !start.free.iter().enumerate().any(outward);
        Score { start: start.clone(), gain: if gains { 0.5 * gradient.dot(&step) } else { 0.0 }, sd }
    }
}

/// From the lowest to the highest value of a free parameter.
fn joint_range(hypothesis: &Hypothesis, i: usize) -> f64 {
    let [low, high] = hypothesis.bounds()[i];
    high - low
}

impl<'a> Search<'a> {
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
    pub fn roughly(&self, judged: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        self.at_most(judged, Some(self.rough_hz(2)))
    }

    /// And as exactly as its effects ask for.
    pub fn exactly(&self, judged: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        self.at_most(judged, None)
    }

    fn at_most(&self, judged: &FilteredHypothesis, most_hz: Option<u32>) -> Option<FilteredHypothesis> {
        let mut other = judged.clone();
        other.hypothesis.most_hz = most_hz;
        self.again(&other, &judged.disturbances)
    }

    pub fn fit(&self, hypothesis: &Hypothesis, own: Option<&[Vec<f64>]>, most_steps: usize) -> Solution {
        let hypothesis = &Hypothesis { most_hz: hypothesis.most_hz.or(Some(self.rough_hz(2))), ..hypothesis.clone() };
        let prediction = Prediction { flights: self.flights, windows: &self.windows, hypothesis, inflation: 1.0 };
        let measured = prediction.starts();
        let longer = |(known, start): (&Vec<f64>, &Vec<f64>)| {
            // a start that makes up for what the other hypothesis lacks may lie below the floor, where a ground effect has no slope
            let known = if is_near(known, start) { &known[..] } else { &[] };
            // a lag that is new to the hypothesis has no value yet
            [known, &start[known.len().min(start.len())..]].concat()
        };
        let own = own.map_or_else(|| measured.clone(), |own| own.iter().zip(&measured).map(longer).collect());
        solve_within(&prediction, own, hypothesis.shared(), most_steps, ENOUGH)
    }

    /// What the filter says of a hypothesis whose free parameters are known about as well as `sd`.
    pub fn judge(&self, hypothesis: &Hypothesis, sd: &[f64], disturbances: &Disturbances) -> Option<FilteredHypothesis> {
        let ranges = hypothesis.bounds();
        let wide: Vec<f64> = sd.iter().zip(&ranges).map(|(sd, [low, high])| (WIDEN * sd).min(0.25 * (high - low))).collect();
        let mut belief = Belief::independent(hypothesis.shared(), &wide);
        let mut loss = price(disturbances);
        for flight in self.flights {
            let filtered = filter(flight, flight.all(), hypothesis, &belief, disturbances)?;
            loss += filtered.loss;
            belief = filtered.belief;
        }
        Some(FilteredHypothesis { hypothesis: hypothesis.clone(), belief, disturbances: *disturbances, loss })
    }

    /// Negative log-likelihood with all parameters as they are.
    pub fn plug_in(&self, hypothesis: &Hypothesis, disturbances: &Disturbances) -> Option<f64> {
        let nothing = Belief::independent(Vec::new(), &[]);
        let fixed = hypothesis.fixed();
        self.flights.iter().map(|f| filter(f, f.all(), &fixed, &nothing, disturbances).map(|f| f.loss)).sum()
    }

    /// The declared model, with what is random about the flight.
    pub fn declared(&self, hypothesis: &Hypothesis) -> Option<FilteredHypothesis> {
        let disturbances = tune(&self.flights[0], hypothesis, None);
        self.judge(hypothesis, &[], &disturbances)
    }

    /// The hypothesis fitted anew, disturbances tuned, judged.
    pub fn refit(&self, hypothesis: &Hypothesis, disturbances: &Disturbances) -> Option<FilteredHypothesis> {
        let solution = self.fit(hypothesis, None, STEPS);
        let (fitted, sd) = without_idle(&hypothesis.at(&solution.shared), &deviations(&solution), &[]);
        let first = self.judge(&fitted, &sd, disturbances)?;
        let disturbances = tune(&self.flights[0], &first.settled(), Some(disturbances));
        self.judge(&fitted, &sd, &disturbances)
    }

    /// One more effect: all scores, and the best by the filter of those that score highest.
    pub fn extend(&self, now: &FilteredHypothesis) -> (Vec<Score>, Option<FilteredHypothesis>) {
        // what is missing for good may pass for a disturbance that wanders slowly: in a calm it would stand out
        let calm = Some(calm(&now.disturbances)).filter(|_| loud(&now.disturbances));
        let Some(Scores { usual: scored, in_calm, base }) = self.score(now, calm.as_ref()) else { return (Vec::new(), None) };
        let at = now.settled();
        let worth = |s: &&Score| s.gain > LEAST_PROPOSAL;
        let mut worthy: Vec<&Score> = scored.iter().filter(worth).take(SHORTLIST).collect();
        let seen = |worthy: &[&Score], s: &Score| worthy.iter().any(|w| w.start.entry.name == s.start.entry.name);
        let more: Vec<&Score> = in_calm.iter().filter(worth).filter(|s| !seen(&worthy, s)).take(SHORTLIST_IN_CALM).collect();
        worthy.extend(more);
        let proposals: Vec<Proposal> = worthy.par_iter().filter_map(|s| self.propose(&at, s, &base)).collect();
        let first = self.judge_all(&proposals, &now.disturbances);
        let mut judged = self.refine_nearest(&first, f64::INFINITY);
        judged.extend(calm.iter().flat_map(|calm| self.refine_nearest(&self.judge_all(&proposals, calm), now.loss)));
        let best = judged.into_iter().min_by(|a, b| a.loss.total_cmp(&b.loss));
        (scored, best.and_then(|best| self.tuned(&self.joined(best, first, now))))
    }

    /// The best hypothesis of a round, and besides what others of the round added, as long as it keeps half of what it gained alone: what is
    /// missing in several ways takes one round, not several.
    fn joined(&self, best: FilteredHypothesis, mut others: Vec<FilteredHypothesis>, before: &FilteredHypothesis) -> FilteredHypothesis {
        others.retain(|other| before.loss - other.loss > LEAST_JOINED);
        others.sort_by(|a, b| a.loss.total_cmp(&b.loss));
        let mut now = best;
        for other in others {
            let alone = before.loss - other.loss;
            let settled = other.settled();
            let added = |t: &&Term| !before.hypothesis.has(t.entry.name) && !now.hypothesis.has(t.entry.name);
            let Some(term) = settled.terms.iter().find(added) else { continue };
            let sd: Vec<f64> = settled.place(term.entry.name).map(|i| other.belief.sd(i)).collect();
            let (hypothesis, sd) = now.and(term, &sd);
            let both = self.judge(&hypothesis, &sd, &now.disturbances);
            now = both.filter(|both| now.loss - both.loss > KEPT * alone && both.hypothesis.terms.len() <= MOST_EFFECTS).unwrap_or(now);
        }
        now
    }

    /// The best hypothesis with commands that may not arrive, if there is such an effect that it does not have. The windows see only what is
    /// expected of it, a delay; that the vehicle is shaken just when commands change, the filter sees once its disturbances no longer stand for it.
    pub fn held(&self, now: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        let unshaken = Disturbances { torque: FLOOR.torque, ..now.disturbances };
        let with = |(entry, probability): (&'static Entry, f64)| {
            let mut term = Term::off(entry);
            *term.values.first_mut()? = probability;
            let (hypothesis, sd) = now.and(&term, &[PROBABILITY_SD]);
            self.judge(&hypothesis, &sd, &unshaken)
        };
        let absent = candidates(&now.settled()).into_iter().map(|c| c.entry).filter(|e| e.observability == Observability::HeldCommand);
        let tried: Vec<_> = absent.flat_map(|entry| PROBABILITIES.map(|p| (entry, p))).collect();
        let mut judged: Vec<FilteredHypothesis> = tried.into_par_iter().filter_map(with).collect();
        judged.sort_by(|a, b| a.loss.total_cmp(&b.loss));
        judged.par_iter().take(TUNED).filter_map(|j| self.tuned(j)).min_by(|a, b| a.loss.total_cmp(&b.loss))
    }

    /// The same hypothesis with the disturbances that suit it.
    pub fn tuned(&self, judged: &FilteredHypothesis) -> Option<FilteredHypothesis> {
        let disturbances = tune(&self.flights[0], &judged.settled(), Some(&judged.disturbances));
        // tuned on a part of a flight, judged on all
        let again = self.again(judged, &disturbances).filter(|again| again.loss < judged.loss);
        Some(again.unwrap_or_else(|| judged.clone()))
    }

    /// Without one of its effects, the others and the disturbances settled anew.
    pub fn reduced(&self, judged: &FilteredHypothesis, effect: &str) -> Option<FilteredHypothesis> {
        let at = judged.settled();
        let place = at.place(effect);
        let sd: Vec<f64> = (0..judged.belief.mean.len()).filter(|i| !place.contains(i)).map(|i| judged.belief.sd(i)).collect();
        let first = self.judge(&at.without(effect), &sd, &judged.disturbances)?;
        if first.loss - judged.loss > BEYOND { Some(first) } else { self.tuned(&first) }
    }

    /// A hypothesis with what is left of it without each of its effects.
    pub fn dissect(&self, judged: FilteredHypothesis) -> Ablation {
        let names: Vec<&'static str> = judged.hypothesis.terms.iter().map(|t| t.entry.name).collect();
        let without = names.into_par_iter().filter_map(|name| Some((name, self.reduced(&judged, name)?))).collect();
        Ablation { judged, without, unclear: 0.0, nearly: None }
    }

    /// Effects that do not earn their place at the end, when all others are there, are taken out again: each must be worth so much
    /// log-likelihood, and one of its parameters must lie clear of "off".
    pub fn backward(&self, from: FilteredHypothesis, worth: f64) -> Ablation {
        let mut now = self.dissect(from);
        let (mut unclear, mut nearly) = (0.0_f64, None);
        loop {
            let is_idle = |(name, less): &&(&'static str, FilteredHypothesis)| {
                less.loss - now.judged.loss < worth || now.judged.clearance(name) < CLEAR || now.judged.is_at_bound(name)
            };
            let idle = now.without.iter().filter(is_idle);
            let Some((name, less)) = idle.min_by(|a, b| a.1.loss.total_cmp(&b.1.loss)) else {
                return Ablation { unclear, nearly, ..now };
            };
            let is_worth = less.loss - now.judged.loss;
            unclear = unclear.max(is_worth);
            if is_worth > NEARLY * worth && now.judged.clearance(name) >= CLEAR && !now.judged.is_at_bound(name) {
                nearly = Some(now.judged.clone());
            }
            now = self.dissect(less.clone());
        }
    }

    /// Other effects in the place of one of a hypothesis: each as judged, within `noise` of the likelihood of the one that it replaces.
    pub fn rivals(
        &self,
        judged: &FilteredHypothesis,
        effect: &str,
        without: &FilteredHypothesis,
        noise: f64,
    ) -> Vec<(&'static str, FilteredHypothesis)> {
        // as the effects were settled with it, and as without it
        let kept = FilteredHypothesis { disturbances: judged.disturbances, ..without.clone() };
        let Some(without) = self.again(&kept, &judged.disturbances) else { return Vec::new() };
        let at = without.settled();
        let Some(Scores { usual: scores, base, .. }) = self.score(&without, None) else { return Vec::new() };
        let own = scores.iter().find(|s| s.start.entry.name == effect).map_or(0.0, |s| s.gain);
        // of the exact geometry, a part is no rival of another or of the whole
        let is_geometry = effects::find(effect).is_ok_and(|(_, e)| e.geometry != Geometry::None);
        let is_rival = |s: &&Score| {
            s.start.entry.name != effect && s.gain > LEAST_SHARE * own && !(is_geometry && s.start.entry.geometry != Geometry::None)
        };
        let others = scores.iter().filter(is_rival).take(SHORTLIST);
        let others: Vec<&Score> = others.collect();
        let proposals: Vec<Proposal> = others.par_iter().filter_map(|s| self.propose(&at, s, &base)).collect();
        let lags = |j: &FilteredHypothesis| j.hypothesis.terms.iter().map(|t| t.entry.lags).sum::<usize>();
        // a swing whose start nobody measured pays for that, which is no word against it
        let behind = |j: &FilteredHypothesis| j.loss - judged.loss - LAG_PRICE * lags(j).saturating_sub(lags(judged)) as f64;
        let replaced = self.refine_nearest(&self.judge_all(&proposals, &judged.disturbances), judged.loss + noise).into_iter();
        let named = |j: FilteredHypothesis| Some((j.hypothesis.terms.iter().find(|t| !judged.hypothesis.has(t.entry.name))?.entry.name, j));
        let alike = replaced.filter_map(named).filter(|(_, j)| behind(j) < noise);
        let (mut rivals, swings): (Vec<_>, Vec<_>) = alike.partition(|(_, j)| j.loss - judged.loss < noise);
        // what is alike only but for its start does not make a name too vague to be said
        rivals.extend(swings.into_iter().take(MOST_RIVALS.saturating_sub(rivals.len())));
        rivals
    }

    fn judge_all(&self, proposals: &[Proposal], disturbances: &Disturbances) -> Vec<FilteredHypothesis> {
        proposals.par_iter().filter_map(|p| self.judge(&p.hypothesis, &p.sd, disturbances)).collect()
    }

    /// Proposals judged again from where they settled: what is then believed beforehand is as wide for every hypothesis, in its own standard
    /// errors, so that all pay the same for a parameter. Those far behind the best, or the loss that is asked for, are left out.
    fn refine_nearest(&self, first: &[FilteredHypothesis], most: f64) -> Vec<FilteredHypothesis> {
        let least = first.iter().map(|j| j.loss).fold(f64::INFINITY, f64::min);
        let near = first.par_iter().filter(|j| j.loss < if most.is_finite() { most } else { least } + FAR_BEHIND);
        near.filter_map(|j| self.again(j, &j.disturbances)).collect()
    }

    /// The same hypothesis judged from where it settled, under other disturbances.
    fn again(&self, judged: &FilteredHypothesis, disturbances: &Disturbances) -> Option<FilteredHypothesis> {
        let sd: Vec<f64> = (0..judged.belief.mean.len()).map(|i| judged.belief.sd(i)).collect();
        self.judge(&judged.settled(), &sd, disturbances)
    }

    /// What every effect could gain, from one run of the filter that carries the parameters of all of them, each known to be almost off. An
    /// effect without a slope at "off" is tried from elsewhere, on the windows, whose fit comes along.
    fn score(&self, now: &FilteredHypothesis, calm: Option<&Disturbances>) -> Option<Scores> {
        let at = now.settled();
        let fixed = at.fixed();
        let all = candidates(&at);
        let mut joint = at.clone();
        joint.most_hz = Some(self.rough_hz(1));
        for candidate in &all {
            joint = joint.with(candidate.starts[0].clone());
        }
        let (jet, (calm, base)) = rayon::join(
            || self.jet(&joint, &now.disturbances),
            || rayon::join(|| calm.and_then(|calm| self.jet(&joint, calm)), || self.fit(&fixed, None, STEPS)),
        );
        let (jet, sample) = (jet?, self.sample(&fixed, &base));
        let known: Vec<usize> = at.terms.iter().flat_map(|t| joint.place(t.entry.name)).chain(0..at.free.len()).collect();
        let of = |candidate: &Candidate| {
            let place: Vec<usize> = joint.place(candidate.entry.name).collect();
            let deaf = place.iter().all(|i| jet.information[(*i, *i)] * joint_range(&joint, *i).powi(2) < 1.0);
            let here = (!deaf).then(|| jet.score(&candidate.starts[0], &place, &known));
            let elsewhere = if deaf { &candidate.starts[..] } else { &candidate.starts[..candidate.variants] };
            let tried = deaf || candidate.variants > 1;
            let there = if tried { sample.start_elsewhere(&fixed, elsewhere) } else { None };
            here.into_iter().chain(there).collect::<Vec<Score>>()
        };
        let usual = best_first(all.par_iter().flat_map_iter(of).collect());
        let stands_out = |(candidate, jet): (&Candidate, &Jet)| {
            jet.score(&candidate.starts[0], &joint.place(candidate.entry.name).collect::<Vec<usize>>(), &known)
        };
        let in_calm = best_first(all.iter().zip(calm.iter().cycle()).map(stands_out).collect());
        Some(Scores { usual, in_calm, base })
    }

    /// A part of the windows, which will do to choose where to start.
    fn sample(&self, at: &Hypothesis, base: &Solution) -> Sample<'_> {
        let some: Vec<usize> = (0..self.windows.len()).step_by(EVERY_TO_START).collect();
        let own: Vec<Vec<f64>> = some.iter().map(|i| base.own[*i].clone()).collect();
        let search = Search { flights: self.flights, windows: some.iter().map(|i| self.windows[*i].clone()).collect() };
        // as many steps as with an effect, or what they gain by themselves would be taken for its gain
        let before = search.fit(at, Some(&own), STEPS_TO_START).loss;
        Sample { search, own, before, of_all: self.windows.len() as f64 / some.len() as f64 }
    }

    /// Likelihood, gradient and information at a hypothesis, by the filter with parameters known to a hundredth of their range.
    fn jet(&self, at: &Hypothesis, disturbances: &Disturbances) -> Option<Jet> {
        let ranges: Vec<f64> = (0..at.shared().len()).map(|i| TIGHT * joint_range(at, i)).collect();
        let prior = Belief::independent(at.shared(), &ranges);
        let mut jet = Jet { loss: 0.0, gradient: DVector::zeros(ranges.len()), information: DMatrix::zeros(ranges.len(), ranges.len()) };
        for flight in self.flights {
            let filtered = filter(flight, flight.all(), at, &prior, disturbances)?;
            let n = ranges.len();
            let covariance = DMatrix::from_row_slice(n, n, &filtered.belief.covariance);
            // in units of the prior, for the sake of the inverse
            let scaled = DMatrix::from_fn(n, n, |i, j| covariance[(i, j)] / (ranges[i] * ranges[j]));
            let precision = Cholesky::new(scaled)?.inverse();
            let step = DVector::from_fn(n, |i, _| (filtered.belief.mean[i] - prior.mean[i]) / ranges[i]);
            let gradient = &precision * step;
            for i in 0..n {
                jet.gradient[i] += gradient[i] / ranges[i];
                for j in 0..n {
                    let own = if i == j { 1.0 } else { 0.0 };
                    jet.information[(i, j)] += (precision[(i, j)] - own) / (ranges[i] * ranges[j]);
                }
            }
            jet.loss += filtered.loss;
        }
        Some(jet)
    }

    fn propose(&self, at: &Hypothesis, score: &Score, base: &Solution) -> Option<Proposal> {
        let hypothesis = at.with(score.start.clone());
        let solution = self.fit(&hypothesis, Some(&base.own), STEPS);
        let settled: Vec<&str> = at.terms.iter().map(|t| t.entry.name).collect();
        let (fitted, sd) = without_idle(&hypothesis.at(&solution.shared), &deviations(&solution), &settled);
        let useful = fitted.terms.iter().any(|t| t.entry.name == score.start.entry.name && !t.free.is_empty());
        useful.then_some(Proposal { hypothesis: fitted, sd })
    }
}

/// Whether a fitted start lies where the vehicle was measured: position and velocity come first.
fn is_near(fitted: &[f64], measured: &[f64]) -> bool {
    let off = |i: usize| (fitted[i] - measured[i]).abs();
    (0..3).all(|i| off(i) < NEAR_M && off(3 + i) < NEAR_MPS)
}

/// Standard errors of a fit by windows, each its own cluster.
pub fn deviations(solution: &Solution) -> Vec<f64> {
    let clusters: Vec<usize> = (0..solution.shares.len()).collect();
    let covariance = solution.covariance(&clusters);
    (0..solution.shared.len()).map(|i| covariance.as_ref().map_or(f64::INFINITY, |c| c[(i, i)].max(0.0).sqrt())).collect()
}

/// Parameters of which the windows say nothing are not free, but for those of effects that are `settled`: beside a newcomer that does the same, nothing
/// tells them apart, and the filter has to say which stays.
fn without_idle(hypothesis: &Hypothesis, sd: &[f64], settled: &[&str]) -> (Hypothesis, Vec<f64>) {
    let mut kept = hypothesis.clone();
    let mut known = sd[..hypothesis.free.len()].to_vec();
    let mut rest = sd[hypothesis.free.len()..].iter();
    for term in &mut kept.terms {
        let entry: &'static Entry = term.entry;
        let stays = settled.contains(&entry.name);
        let range = |i: usize| entry.params[i].high - entry.params[i].low;
        let bounded = |i: usize, sd: f64| if sd.is_finite() { sd.min(range(i)) } else { range(i) };
        let free = term.free.iter().zip(rest.by_ref()).filter(|(i, sd)| stays || (sd.is_finite() && **sd < range(**i)));
        let free: Vec<(usize, f64)> = free.map(|(i, sd)| (*i, bounded(*i, *sd))).collect();
        term.free = free.iter().map(|(i, _)| *i).collect();
        known.extend(free.iter().map(|(_, sd)| *sd));
    }
    (kept, known)
}

#[cfg(test)]
mod tests {
    use crazyflie_env::effects::find;
    use crazyflie_env::model::Model;

    use super::*;

    fn judged(effect: &str, strength: f64) -> FilteredHypothesis {
        let hypothesis = Hypothesis::of(&Model::thesis()).with(Term::off(find(effect).unwrap().1));
        let mut mean = hypothesis.shared();
        mean[0] = strength;
        let belief = Belief::independent(mean.clone(), &vec![0.01; mean.len()]);
        FilteredHypothesis { hypothesis, belief, disturbances: FLOOR, loss: 0.0 }
    }

    #[test]
    fn a_strength_at_its_bound_is_no_cause_but_the_whole_geometry_is() {
        assert!(judged("camera_scale", 2.3).is_at_bound("camera_scale"));
        assert!(!judged("camera_scale", 0.9).is_at_bound("camera_scale"));
        // "off" lies at the lower bound of a drag
        assert!(!judged("drag_linear", 0.0).is_at_bound("drag_linear"));
        assert!(!judged("rigid_body", 1.0).is_at_bound("rigid_body"));
    }

    #[test]
    fn a_start_below_the_floor_is_not_believed() {
        let measured = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0];
        assert!(is_near(&[0.01, 0.0, 0.11, 0.1, 0.0, 0.2], &measured));
        assert!(!is_near(&[0.0, 0.0, -0.17, 0.0, 0.0, 0.2], &measured));
        assert!(!is_near(&[0.0, 0.0, 0.12, 0.0, 0.0, 0.9], &measured));
    }
}
