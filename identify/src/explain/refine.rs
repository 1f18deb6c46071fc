//! The last word on the parameters: where the likelihood of the flights is highest with every parameter a
//! constant, and how far off that may be. The filter that learns them on the way is linear about what it
//! believed at each moment, and takes its own noise for the truth.

use std::collections::BTreeMap;

use nalgebra::DVector;
use rayon::prelude::*;

use super::calibration::refine::{ENOUGH, ROUNDS, STEP, STRETCH_S};
use super::search::FilteredHypothesis;
use crate::fit::filter::{Disturbances, FilterResult, Innovation, ParameterPrior, filter_fixed};
use crate::fit::flight::Flight;
use crate::fit::huber::huber;
use crate::fit::hypothesis::Hypothesis;
use crate::fit::solve::{NormalEquations, cluster_robust_covariance, pseudo_inverse};

/// The innovations of all flights with the parameters at some values, one after the other.
struct FilterRun {
    loss: f64,
    /// Each with the stretch that it lies in.
    innovations: Vec<(usize, Innovation)>,
}

fn filter_flights(flights: &[Flight], hypothesis: &Hypothesis, under: &Disturbances) -> Option<FilterRun> {
    let (mut all, mut first) = (FilterRun { loss: 0.0, innovations: Vec::new() }, 0);
    let filtered = flights.par_iter().map(|f| filter_fixed(f, hypothesis, under));
    let filtered: Vec<FilterResult> = filtered.collect::<Option<_>>()?;
    for (flight, filtered) in flights.iter().zip(filtered) {
        all.loss += filtered.loss;
        let stretches = ((flight.ticks as f64 * flight.tick_s / STRETCH_S) as usize).max(1);
        let stretch_of = |i: &Innovation| first + ((i.t_s / STRETCH_S) as usize).min(stretches - 1);
        all.innovations.extend(filtered.innovations.iter().map(|i| (stretch_of(i), *i)));
        first += stretches;
    }
    Some(all)
}

/// Gradient and information of each stretch, by differences.
fn clusters(
    flights: &[Flight],
    hypothesis: &Hypothesis,
    here: &FilterRun,
    sd: &[f64],
    disturbances: &Disturbances,
) -> Option<Vec<NormalEquations>> {
    let (values, bounds) = (hypothesis.free_values(), hypothesis.bounds());
    let n = values.len();
    let sides = |i: usize| [-STEP, STEP].map(|by| (values[i] + by * sd[i]).clamp(bounds[i][0], bounds[i][1]));
    let moved = |k: usize| {
        let mut to = values.clone();
        to[k / 2] = sides(k / 2)[k % 2];
        filter_flights(flights, &hypothesis.with_values(&to), disturbances)
    };
    let runs: Vec<FilterRun> = (0..2 * n).into_par_iter().map(moved).collect::<Option<_>>()?;
    let mut clusters = BTreeMap::new();
    for (row, (stretch, innovation)) in here.innovations.iter().enumerate() {
        let slope = |i: usize, number: fn(&Innovation) -> f64| {
            let [low, high] = sides(i);
            (number(&runs[2 * i + 1].innovations[row].1) - number(&runs[2 * i].innovations[row].1))
                / (high - low)
        };
        let z = DVector::from_fn(n, |i, _| slope(i, |v| v.normalised));
        // a parameter that changes how far predictions miss is known by that too
        let log_sd = DVector::from_fn(n, |i, _| slope(i, |v| v.log_sd));
        let (_, weight) = huber(innovation.normalised);
        let cluster = clusters.entry(*stretch).or_insert_with(|| NormalEquations::new(n));
        cluster.information.ger(weight, &z, &z, 1.0);
        cluster.information.ger(weight, &log_sd, &log_sd, 1.0);
        cluster.gradient += DVector::from_fn(n, |i, _| slope(i, |v| v.loss));
    }
    Some(clusters.into_values().collect())
}

/// Computes the most likely values and their covariance, clustered by stretches of the flights: it is valid although
/// the innovations are not quite independent. `None` if nothing is free or the filter breaks down.
pub fn refine(flights: &[Flight], judged: &FilteredHypothesis) -> Option<ParameterPrior> {
    let mut hypothesis = judged.at_posterior();
    let (n, bounds) = (hypothesis.free_values().len(), hypothesis.bounds());
    if n == 0 {
        return None;
    }
    // to differ by more than the range tells nothing
    let inside = |sd: f64, i: usize| sd.min(bounds[i][1] - bounds[i][0]);
    let mut sd: Vec<f64> = (0..n).map(|i| inside(judged.posterior.sd(i), i)).collect();
    let mut here = filter_flights(flights, &hypothesis, &judged.disturbances)?;
    let mut known = clusters(flights, &hypothesis, &here, &sd, &judged.disturbances)?;
    for _ in 0..ROUNDS {
        let gradient: DVector<f64> = known.iter().map(|c| &c.gradient).sum();
        let bread = pseudo_inverse(&known.iter().map(|c| &c.information).sum())?;
        let step = &bread * gradient;
        let values = hypothesis.free_values().into_iter().enumerate();
        let to: Vec<f64> = values.map(|(i, v)| (v - step[i]).clamp(bounds[i][0], bounds[i][1])).collect();
        if to.iter().any(|v| v.is_nan()) {
            return None;
        }
        let next = hypothesis.with_values(&to);
        let there = filter_flights(flights, &next, &judged.disturbances)?;
        let gain = here.loss - there.loss;
        if gain < ENOUGH {
            break;
        }
        (hypothesis, here) = (next, there);
        sd = (0..n).map(|i| inside(bread[(i, i)].sqrt(), i)).collect();
        known = clusters(flights, &hypothesis, &here, &sd, &judged.disturbances)?;
    }
    Some(ParameterPrior {
        mean: hypothesis.free_values(),
        covariance: cluster_robust_covariance(&known)?.as_slice().to_vec(),
    })
}
