//! Errors of prediction on flights that the fit never saw: from an estimated state, by the commands alone, so and so far ahead.

use rayon::prelude::*;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::fit::flight::{Flight, Window};
use crate::fit::hypothesis::Hypothesis;
use crate::fit::predict::Worker;

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

/// Errors of two hypotheses on the same flights.
pub fn compare(before: &Hypothesis, after: &Hypothesis, flights: &[Flight]) -> Errors {
    let (b, a) = (squares(&before.fixed(), flights, false), squares(&after.fixed(), flights, false));
    let n = squares(&before.fixed(), flights, true);
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
fn squares(hypothesis: &Hypothesis, flights: &[Flight], naive: bool) -> Vec<Vec<Squares>> {
    let per_flight = |flight: &Flight| -> Vec<Vec<Squares>> {
        let each = (STRETCH_S / flight.tick_s) as usize;
        let stretches: Vec<usize> = (0..flight.ticks.saturating_sub(each / 2)).step_by(each).collect();
        let of = |first: &usize| {
            let mut worker = Worker::new(hypothesis, flight, false, false).ok();
            let starts = (*first..(first + each).min(flight.ticks)).step_by((EVERY_S / flight.tick_s) as usize);
            starts.filter_map(|start| one(worker.as_mut()?, flight, start, start == 0, naive)).collect()
        };
        stretches.par_iter().map(of).collect()
    };
    flights.iter().flat_map(per_flight).collect()
}

/// One prediction from a tick: at each horizon the error at its end, for the free run the mean over it.
fn one(worker: &mut Worker, flight: &Flight, start: usize, free: bool, naive: bool) -> Option<Squares> {
    let ahead = |s: f64| ((s / flight.tick_s).round() as usize).max(1);
    let longest = if free { ahead(FREE_S) } else { ahead(HORIZONS_S[3]) };
    let end = (start + longest).min(flight.ticks);
    if end <= start {
        return None;
    }
    let mut own = flight.start_numbers(start);
    let from = own.clone();
    let lags = worker.lags(flight, start, &own);
    own.extend(lags);
    let window = Window { flight: 0, ticks: start..end };
    worker.predict(flight, &window, &own);
    let rows = worker.rows();
    let mut out = [[f64::NAN; 5]; 3];
    for (horizon, seconds) in HORIZONS_S.iter().enumerate() {
        let tick = start + ahead(*seconds);
        if tick > end {
            continue;
        }
        // position where it was measured next to the horizon
        let at_s = tick as f64 * flight.tick_s;
        let near = |channels: std::ops::Range<usize>| -> f64 {
            let reach = if channels.start == 0 { 0.6 * flight.tick_s } else { 0.02 };
            let all = rows.iter().filter(|r| channels.contains(&r.channel) && (r.t_s - at_s).abs() <= reach);
            let held = |r: &crate::fit::predict::Compared| if r.channel < 3 { from[6 + r.channel] } else { from[r.channel - 3] };
            let errors: Vec<f64> = all.map(|r| (r.measured - if naive { held(r) } else { r.predicted }).powi(2)).collect();
            if errors.is_empty() { f64::NAN } else { 3.0 * errors.iter().sum::<f64>() / errors.len() as f64 }
        };
        (out[0][horizon], out[2][horizon]) = (near(3..6), near(0..3));
        let predicted = if naive { &from[3..6] } else { &worker.velocities()[3 * (tick - start)..3 * (tick - start) + 3] };
        let measured = flight.start(tick).vel_mps;
        out[1][horizon] = predicted.iter().zip(measured).map(|(p, m)| (p - m).powi(2)).sum();
    }
    if free {
        let mean = |channels: std::ops::Range<usize>| {
            let held = |r: &crate::fit::predict::Compared| if r.channel < 3 { from[6 + r.channel] } else { from[r.channel - 3] };
            let errors: Vec<f64> = rows
                .iter()
                .filter(|r| channels.contains(&r.channel))
                .map(|r| (r.measured - if naive { held(r) } else { r.predicted }).powi(2))
                .collect();
            3.0 * errors.iter().sum::<f64>() / errors.len() as f64
        };
        (out[0][4], out[2][4]) = (mean(3..6), mean(0..3));
        let v = worker.velocities();
        let errors = (start + 1..=end).map(|tick| {
            let measured = flight.start(tick).vel_mps;
            let predicted = if naive { &from[3..6] } else { &v[3 * (tick - start)..3 * (tick - start) + 3] };
            predicted.iter().zip(measured).map(|(p, m)| (p - m).powi(2)).sum::<f64>()
        });
        out[1][4] = errors.sum::<f64>() / (end - start) as f64;
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
