//! Possible gain of each effect. One run of the filter yields the slopes of all of them; windows cover those that
//! have no slope while they are off.

use std::collections::BTreeSet;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::calibration::search::{LEAST_INFORMATION, STEPS};
use super::candidates::{Candidate, candidates};
use super::search::{FilteredHypothesis, Search};
use super::starts::WindowSubset;
use crate::fit::filter::Disturbances;
use crate::fit::flight::Flight;
use crate::fit::hypothesis::{Hypothesis, Term};
use crate::fit::likelihood_slopes::likelihood_slopes;
use crate::fit::solve::{NormalEquations, Solution, pseudo_inverse};

/// The gain that an effect could bring.
#[derive(Debug, Clone)]
pub struct Score {
    /// Start of its fit.
    pub start: Term,
    /// In units of log-likelihood, the other parameters following.
    pub gain: f64,
    /// Standard error of each of its free parameters that these flights allow, the other parameters unknown
    /// too.
    pub sd: Vec<f64>,
    /// The step along the filter's slopes and its uncertainty; none for a start that only the windows evaluated.
    pub ahead: Option<(Term, Vec<f64>)>,
}

/// Scores of all effects.
pub(super) struct Scores {
    pub best_first: Vec<Score>,
    /// The windows' fit without any of them.
    pub base: Solution,
}

/// The best first, of one effect its best start.
fn best_first(mut scores: Vec<Score>) -> Vec<Score> {
    scores.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    let mut seen = BTreeSet::new();
    scores.retain(|score| seen.insert(score.start.entry.name));
    scores
}

impl NormalEquations {
    /// The gain of the parameters at `place`, those at `known` following.
    fn score(&self, start: &Term, place: &[usize], known: &[usize]) -> Score {
        // a share of what is nothing yet has no slope: what rounding makes of it is no step
        let mut told: Vec<_> = (0..place.len()).filter(|k| self.has_slope(place[*k], start, *k)).collect();
        let step_along =
            |told: &[usize]| self.step(&told.iter().map(|k| place[*k]).collect::<Vec<_>>(), known);
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

    /// Returns whether the full range of a term's free parameter would be visible.
    fn has_slope(&self, place: usize, term: &Term, k: usize) -> bool {
        let p = &term.entry.params[term.free[k]];
        self.information[(place, place)] * (p.high - p.low).powi(2) >= LEAST_INFORMATION
    }

    /// The step of some parameters to the least loss.
    pub(super) fn joint_step(&self, places: &[usize]) -> DVector<f64> {
        self.step(places, &[]).by
    }

    /// Loss that a step of some parameters takes off.
    pub(super) fn gain(&self, places: &[usize], by: &DVector<f64>) -> f64 {
        let curved = |i: usize| {
            places.iter().zip(by.iter()).map(|(j, by)| self.information[(places[i], *j)] * by).sum::<f64>()
        };
        (0..places.len()).map(|i| by[i] * (self.gradient[places[i]] - 0.5 * curved(i))).sum()
    }

    /// Loss that parameters a distance away from where they are nothing take off, the others following.
    pub(super) fn worth(&self, place: &[usize], away: &[f64], others: &[usize]) -> f64 {
        let away = DVector::from_column_slice(away);
        0.5 * away.dot(&(self.conditioned(place, others).1 * &away))
    }

    /// The step of the parameters at `place` to the least loss, those at `known` following.
    fn step(&self, place: &[usize], known: &[usize]) -> QuadraticStep {
        let (gradient, information) = self.conditioned(place, known);
        let covariance = inverted(&information);
        let by = finite(&covariance) * &gradient;
        QuadraticStep { gain: 0.5 * gradient.dot(&by), by, covariance }
    }

    /// Gradient and information of the parameters at `place`, those at `known` following.
    fn conditioned(&self, place: &[usize], known: &[usize]) -> (DVector<f64>, DMatrix<f64>) {
        let block = |rows: &[usize], columns: &[usize]| {
            DMatrix::from_fn(rows.len(), columns.len(), |i, j| self.information[(rows[i], columns[j])])
        };
        let part = |rows: &[usize]| DVector::from_fn(rows.len(), |i, _| self.gradient[rows[i]]);
        let across = block(place, known);
        let follow = &across * finite(&inverted(&block(known, known)));
        (part(place) - &follow * part(known), block(place, place) - follow * across.transpose())
    }
}

fn inverted(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    pseudo_inverse(matrix).unwrap_or_else(|| DMatrix::zeros(matrix.nrows(), matrix.nrows()))
}

fn finite(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    matrix.map(|v| if v.is_finite() { v } else { 0.0 })
}

/// A step of some parameters to the least loss of a [`NormalEquations`].
struct QuadraticStep {
    by: DVector<f64>,
    /// Loss that it takes off.
    gain: f64,
    /// Covariance of the parameters there.
    covariance: DMatrix<f64>,
}

/// Returns whether a step takes the `k`-th free parameter of a term out of its range.
fn is_outward(term: &Term, k: usize, by: f64) -> bool {
    let (value, p) = (term.values[term.free[k]], &term.entry.params[term.free[k]]);
    (value <= p.low && by < 0.0) || (value >= p.high && by > 0.0)
}

/// A hypothesis with all effects that it lacks, each close to "off", and the slopes of its likelihood.
struct JointModel {
    candidates: Vec<Candidate>,
    joint: Hypothesis,
    slopes: NormalEquations,
    /// Places of what the hypothesis has already.
    known: Vec<usize>,
}

impl JointModel {
    fn place(&self, candidate: &Candidate) -> Vec<usize> {
        self.joint.place(candidate.entry.name).collect()
    }

    /// Score of a candidate at "off", if it has a slope there.
    fn score(&self, candidate: &Candidate) -> Option<Score> {
        let (place, start) = (self.place(candidate), &candidate.starts[0]);
        let has_slope = place.iter().enumerate().any(|(k, at)| self.slopes.has_slope(*at, start, k));
        has_slope.then(|| self.slopes.score(start, &place, &self.known))
    }
}

impl Search<'_> {
    /// Scores of all effects. An effect without a slope at "off" is tried from other starts, on the windows, whose
    /// fit is returned too.
    pub(super) fn score(&self, now: &FilteredHypothesis) -> Option<Scores> {
        let fixed = now.at_posterior().without_free();
        let (model, base) = rayon::join(|| self.joint_model(now), || self.fit(&fixed, None, STEPS));
        let (model, subset) = (model?, WindowSubset::new(self, &fixed, &base)?);
        let scores = |candidate: &Candidate| {
            let here = model.score(candidate);
            let starts = if here.is_none() { candidate.starts.len() } else { candidate.variants };
            let tried = here.is_none() || candidate.variants > 1;
            let elsewhere = || subset.best_alternative_start(&fixed, &candidate.starts[..starts]);
            here.into_iter().chain(tried.then(elsewhere).flatten()).collect::<Vec<Score>>()
        };
        let all = model.candidates.par_iter().flat_map_iter(scores).collect();
        Some(Scores { best_first: best_first(all), base })
    }

    /// Scores of the effects that have a slope at "off", the best first.
    pub(super) fn slope_scores(&self, now: &FilteredHypothesis) -> Option<Vec<Score>> {
        let model = self.joint_model(now)?;
        Some(best_first(model.candidates.iter().filter_map(|candidate| model.score(candidate)).collect()))
    }

    /// From one filter run.
    fn joint_model(&self, now: &FilteredHypothesis) -> Option<JointModel> {
        let settled = now.at_posterior();
        let candidates = candidates(&settled);
        let joint = Hypothesis { max_physics_hz: Some(self.rough_hz(1)), ..settled.clone() };
        let joint = candidates.iter().fold(joint, |joint, candidate| joint.with(candidate.starts[0].clone()));
        let of_terms = settled.terms.iter().flat_map(|t| joint.place(t.entry.name));
        let known = of_terms.chain(0..settled.free.len()).collect();
        let slopes = self.likelihood_slopes(&joint, &now.disturbances)?;
        Some(JointModel { candidates, joint, slopes, known })
    }

    /// Likelihood, gradient and information at a hypothesis.
    pub(super) fn likelihood_slopes(
        &self,
        hypothesis: &Hypothesis,
        disturbances: &Disturbances,
    ) -> Option<NormalEquations> {
        let slopes = |flight: &Flight| likelihood_slopes(flight, hypothesis, disturbances);
        let slopes: Vec<NormalEquations> = self.flights.par_iter().map(slopes).collect::<Option<_>>()?;
        slopes.into_iter().reduce(|sum, flight| sum.plus(&flight))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crazyflie_env::effects::find;

    #[test]
    fn a_parameter_at_its_bound_does_not_hide_its_effect() {
        // a weaker thrust: the scale wants down, and its torque share, at none, wants below none
        let start = Term::off(find("thrust_scale").unwrap().1);
        let mut model = NormalEquations {
            loss: 0.0,
            gradient: DVector::from_vec(vec![-1e4, -50.0]),
            information: DMatrix::from_diagonal(&DVector::from_vec(vec![1e5, 100.0])),
        };
        let score = model.score(&start, &[0, 1], &[]);
        assert!((score.gain - 500.0).abs() < 1e-6, "of the scale alone: {}", score.gain);
        let (ahead, _) = score.ahead.unwrap();
        assert!((ahead.values[0] - 0.9).abs() < 1e-9 && ahead.free == [0], "{:?}", ahead.values);
        // a parameter without a slope makes no step
        model.information[(1, 1)] = 1e-12;
        assert!((model.score(&start, &[0, 1], &[]).gain - 500.0).abs() < 1e-6);
        // and an effect of which nothing may move gains nothing
        model.information = DMatrix::zeros(2, 2);
        assert_eq!(model.score(&start, &[0, 1], &[]).gain, 0.0);
    }
}
