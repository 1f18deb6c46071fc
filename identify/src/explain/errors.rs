//! Errors of prediction on flights that the fit never saw: from an estimated state, by the commands alone, so and so far ahead.

use std::ops::Range;

use rayon::prelude::*;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::fit::filter::{Belief, Disturbances, filter};
use crate::fit::flight::{Flight, Window};
use crate::fit::hypothesis::Hypothesis;
use crate::fit::predict::{Compared, Worker};

/// How far ahead, in seconds; the free run goes from the start to the end.
pub const HORIZONS_S: [f64; 4] = [0.02, 0.1, 0.5, 2.0];
/// Names of the horizons with the free run.
pub const HORIZONS: [&str; 5] = ["one_step", "0.1_s", "0.5_s", "2_s", "free_run"];
/// Predicted quantities and their units.
pub const QUANTITIES: [(&str, &str); 3] = [("position", "m"), ("velocity", "m/s"), ("attitude", "rad")];
/// Predictions start this far apart.
const EVERY_S: f64 = 0.25;
/// Stretches of a flight that are taken as independent of each other.
const STRETCH_S: f64 = 5.0;
/// What the filter needs to find the state.
const SETTLE_S: f64 = 2.0;
/// A free run does not go on further than this from the start.
const FREE_S: f64 = 20.0;

/// Root mean square error per quantity and horizon, in the order of [`QUANTITIES`] and [`HORIZONS`].
pub type Table = [[f64; 5]; 3];

/// Errors on the test flights.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Errors {
    pub before: Table,
    pub after: Table,
    /// Of holding the position, velocity and attitude from which the prediction starts.
    pub naive: Table,
    /// Two-sided p value of the paired differences between before and after, per quantity and horizon, over stretches of the flights.
    pub p_value: Table,
}

/// Squared errors of one prediction: per quantity and horizon; NaN where there is nothing to compare with.
type Squares = [[f64; 5]; 3];

/// Errors of two hypotheses, each with its disturbances, on the same flights. Predictions start from what the filter of each knows then; from there
/// on the commands alone decide.
pub fn compare(before: (&Hypothesis, &Disturbances), after: (&Hypothesis, &Disturbances), flights: &[Flight]) -> Errors {
    let of = |(hypothesis, disturbances): (&Hypothesis, &Disturbances), naive| squares(&hypothesis.fixed(), disturbances, flights, naive);
    let (b, (a, n)) = rayon::join(|| of(before, false), || rayon::join(|| of(after, false), || of(before, true)));
    let mut p_value = [[1.0; 5]; 3];
    for (quantity, row) in p_value.iter_mut().enumerate() {
        for (horizon, p) in row.iter_mut().enumerate() {
            let differences = b.iter().zip(&a).map(|(b, a)| mean_of(b, quantity, horizon) - mean_of(a, quantity, horizon));
            *p = paired(&differences.filter(|d| d.is_finite()).collect::<Vec<_>>());
        }
    }
    Errors { before: table(&b), after: table(&a), naive: table(&n), p_value }
}

fn mean_of(stretch: &[Squares], quantity: usize, horizon: usize) -> f64 {
    let known: Vec<f64> = stretch.iter().map(|s| s[quantity][horizon]).filter(|v| v.is_finite()).collect();
    known.iter().sum::<f64>() / known.len() as f64
}

fn table(stretches: &[Vec<Squares>]) -> Table {
    let all: Vec<Squares> = stretches.iter().flatten().copied().collect();
    std::array::from_fn(|quantity| std::array::from_fn(|horizon| mean_of(&all, quantity, horizon).sqrt()))
}

/// Student's paired t test: the two-sided p value of a mean of zero.
fn paired(differences: &[f64]) -> f64 {
    let n = differences.len() as f64;
    if n < 2.0 {
        return 1.0;
    }
    let mean = differences.iter().sum::<f64>() / n;
    let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let (Ok(student), true) = (StudentsT::new(0.0, 1.0, n - 1.0), variance > 0.0) else { return 1.0 };
    2.0 * student.cdf(-(mean / (variance / n).sqrt()).abs())
}

/// Squared errors of all predictions, by stretches.
fn squares(hypothesis: &Hypothesis, disturbances: &Disturbances, flights: &[Flight], naive: bool) -> Vec<Vec<Squares>> {
    let nothing = Belief::independent(Vec::new(), &[]);
    let per_flight = |flight: &Flight| -> Vec<Vec<Squares>> {
        let Some(filtered) = filter(flight, flight.all(), hypothesis, &nothing, disturbances) else { return Vec::new() };
        let ticks = |s: f64| (s / flight.tick_s).round() as usize;
        // the filter has to find the state first
        let stretches: Vec<usize> =
            (ticks(SETTLE_S)..flight.ticks.saturating_sub(ticks(0.5 * STRETCH_S))).step_by(ticks(STRETCH_S)).collect();
        let of = |first: &usize| {
            let mut worker = Worker::new(hypothesis, flight, false, false).ok();
            let starts = (*first..(first + ticks(STRETCH_S)).min(flight.ticks)).step_by(ticks(EVERY_S));
            starts
                .filter_map(|start| one(worker.as_mut()?, flight, &filtered.states[start], start, start == ticks(SETTLE_S), naive))
                .collect()
        };
        stretches.par_iter().map(of).collect()
    };
    flights.iter().flat_map(per_flight).collect()
}

/// One prediction from a tick: at each horizon the error at its end, for the free run the mean over it.
fn one(worker: &mut Worker, flight: &Flight, own: &[f64], start: usize, free: bool, naive: bool) -> Option<Squares> {
    let ahead = |s: f64| ((s / flight.tick_s).round() as usize).max(1);
    let end = (start + if free { ahead(FREE_S) } else { ahead(HORIZONS_S[3]) }).min(flight.ticks);
    if end <= start {
        return None;
    }
    worker.predict(flight, &Window { flight: 0, ticks: start..end }, own);
    let from = flight.start(start);
    let held = |r: &Compared| if r.channel < 3 { from.att_rad[r.channel] } else { from.pos_m[r.channel - 3] };
    let mean = |channels: Range<usize>, about_s: f64, reach_s: f64| -> f64 {
        let near = worker.rows().iter().filter(|r| channels.contains(&r.channel) && (r.t_s - about_s).abs() <= reach_s);
        let errors: Vec<f64> = near.map(|r| (r.measured - if naive { held(r) } else { r.predicted }).powi(2)).collect();
        3.0 * errors.iter().sum::<f64>() / errors.len() as f64
    };
    let mut out = [[f64::NAN; 5]; 3];
    for (horizon, seconds) in HORIZONS_S.iter().enumerate().filter(|(_, s)| start + ahead(**s) <= end) {
        let about_s = (start + ahead(*seconds)) as f64 * flight.tick_s;
        // frames do not fall on ticks
        (out[0][horizon], out[2][horizon]) = (mean(3..6, about_s, 0.02), mean(0..3, about_s, 0.6 * flight.tick_s));
    }
    if free {
        let (about_s, reach_s) = (0.5 * (start + end) as f64 * flight.tick_s, 0.5 * (end - start) as f64 * flight.tick_s);
        (out[0][4], out[2][4]) = (mean(3..6, about_s, reach_s), mean(0..3, about_s, reach_s));
    }
    let mut velocity = |tick: usize| -> f64 {
        let predicted = if naive { Some(from.vel_mps) } else { worker.reported_velocity(flight, tick - start) };
        predicted.map_or(f64::NAN, |v| v.iter().zip(flight.start(tick).vel_mps).map(|(p, m)| (p - m).powi(2)).sum())
    };
    for (horizon, seconds) in HORIZONS_S.iter().enumerate().filter(|(_, s)| start + ahead(**s) <= end) {
        out[1][horizon] = velocity(start + ahead(*seconds));
    }
    if free {
        out[1][4] = (start + 1..=end).map(velocity).sum::<f64>() / (end - start) as f64;
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_paired_test_sees_a_steady_difference_and_not_an_unsteady_one() {
        assert!(paired(&[1.0, 1.1, 0.9, 1.05, 0.95]) < 1e-4);
        assert!(paired(&[1.0, -1.1, 0.9, -1.05, 0.3]) > 0.5);
        assert_eq!(paired(&[1.0]), 1.0);
    }
}
