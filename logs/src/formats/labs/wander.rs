//! Estimates the delay between two clocks, which wanders during a flight.

use crazyflie_statistics::quantile;
use std::ops::Range;

use crate::signal::usual_step;
use crate::skew::{AVERAGED_S, LONGEST_LAG_S, Rates, derivative, lag};

/// The skew is a line between knots this far apart, each of which may differ from the one before by
/// [`WANDER_S`] times the root of this. Chosen on flights of the fit, trims fitted to each (no flight was
/// left out): horizontal velocity predicted 2 s ahead by commands was off by 0.139 m/s with one skew for all,
/// by 0.127 with knots every second and 0.02, by 0.125 with these, by 0.123 with twice as many and 0.04.
const KNOT_S: f64 = 0.5;
/// Drift of the skew in one second.
const WANDER_S: f64 = 0.03;
/// Most of the steps of [`wander`], and how small the last must be.
const STEPS: usize = 15;
const SETTLED_S: f64 = 2e-4;
/// Longest step of a knot: beyond it, the slope of the rates no longer points to the minimum.
const LONGEST_STEP_S: f64 = 0.03;
/// Residuals beyond so many standard deviations count linearly.
const HUBER: f64 = 2.0;
/// Estimates the delay of the onboard data at each row: least squares of the rates of both sides over a skew that
/// drifts. It starts from the delay at which they differ least in `rows`. `None` if the rates do not determine it.
pub(super) fn wander(rates: &Rates<'_>, rows: &Range<usize>) -> Option<Vec<f64>> {
    let usual_s = lag(rates, rows)?;
    let t_s = &rates.t_s[rows.clone()];
    let (first_s, last_s) = (*t_s.first()?, *t_s.last()?);
    let knots = ((last_s - first_s) / KNOT_S).ceil() as usize + 1;
    let seen_and_felt = rates.angles_rad.iter().zip(rates.gyro_radps);
    let sides: Vec<_> = seen_and_felt.map(|(angle, gyro)| sides(rates.t_s, angle, gyro)).collect();
    let hat = |t: f64| {
        let position = ((t - first_s) / KNOT_S).clamp(0.0, (knots - 1) as f64);
        let knot = (position as usize).min(knots.saturating_sub(2));
        (knot, position - knot as f64)
    };
    let mut late_s = vec![usual_s; knots];
    for _ in 0..STEPS {
        let mut system = Chain::smooth(&late_s);
        for [seen, felt, slope] in &sides {
            let meet = |row: usize| {
                let (knot, share) = hat(rates.t_s[row]);
                let at_s = rates.t_s[row]
                    + late_s[knot]
                    + share * (late_s[(knot + 1).min(knots - 1)] - late_s[knot]);
                let apart = seen[row] - interpolate(rates.t_s, felt, at_s);
                (knot, share, apart, interpolate(rates.t_s, slope, at_s))
            };
            let all: Vec<_> = rows.clone().map(meet).collect();
            let apart: Vec<f64> = all.iter().map(|(_, _, apart, _)| *apart).collect();
            let offset = quantile(&apart, 0.5).unwrap_or(0.0);
            let scatter = quantile(&apart.iter().map(|e| (e - offset).abs()).collect::<Vec<_>>(), 0.5)
                .unwrap_or(0.0)
                / 0.6745;
            // averaged rates are no more samples than fit side by side into the recording
            let alone = AVERAGED_S / usual_step(t_s);
            for (knot, share, apart, slope) in all {
                let far = ((apart - offset).abs() / scatter).max(1e-9);
                let weight = (HUBER / far).min(1.0) / (scatter * scatter * alone);
                system.add(knot, share, slope, apart - offset, weight);
            }
        }
        let steps = system.solve();
        for (late, step) in late_s.iter_mut().zip(&steps) {
            *late += step.clamp(-LONGEST_STEP_S, LONGEST_STEP_S);
        }
        if steps.iter().all(|step| step.abs() < SETTLED_S) {
            break;
        }
    }
    let late_at = |t: &f64| {
        let (knot, share) = hat(*t);
        late_s[knot] + share * (late_s[(knot + 1).min(knots - 1)] - late_s[knot])
    };
    late_s.iter().all(|late| late.abs() < LONGEST_LAG_S).then(|| rates.t_s.iter().map(late_at).collect())
}

/// The averaged rate by motion capture, that of the gyro, and the slope of the latter.
fn sides(t_s: &[f64], angle_rad: &[f64], gyro_radps: &[f64]) -> [Vec<f64>; 3] {
    let width = (AVERAGED_S / usual_step(t_s)).round().max(1.0) as usize;
    let felt = moving_average(gyro_radps, width);
    let slope = derivative(t_s, &felt);
    [moving_average(&derivative(t_s, angle_rad), width), felt, slope]
}

/// Normal equations of knots in a row, each tied to the next.
struct Chain {
    diagonal: Vec<f64>,
    beside: Vec<f64>,
    right: Vec<f64>,
}

impl Chain {
    /// Creates the chain of knots at their present values, with the prior that neighbours are alike and nothing else.
    fn smooth(values: &[f64]) -> Self {
        let n = values.len();
        let weight = 1.0 / (WANDER_S * WANDER_S * KNOT_S);
        let mut chain = Chain { diagonal: vec![1e-9; n], beside: vec![0.0; n], right: vec![0.0; n] };
        for i in 1..n {
            chain.diagonal[i - 1] += weight;
            chain.diagonal[i] += weight;
            chain.beside[i - 1] -= weight;
            let apart = values[i] - values[i - 1];
            chain.right[i - 1] += weight * apart;
            chain.right[i] -= weight * apart;
        }
        chain
    }

    /// A residual that falls by `slope` per unit of the value `share` of the way from a knot to the next.
    fn add(&mut self, knot: usize, share: f64, slope: f64, residual: f64, weight: f64) {
        let (a, b) = ((1.0 - share) * slope, share * slope);
        self.diagonal[knot] += weight * a * a;
        self.right[knot] += weight * a * residual;
        if let Some(next) = self.diagonal.get_mut(knot + 1) {
            *next += weight * b * b;
            self.beside[knot] += weight * a * b;
            self.right[knot + 1] += weight * b * residual;
        }
    }

    /// By Thomas's algorithm.
    fn solve(mut self) -> Vec<f64> {
        let n = self.diagonal.len();
        for i in 1..n {
            let by = self.beside[i - 1] / self.diagonal[i - 1];
            self.diagonal[i] -= by * self.beside[i - 1];
            self.right[i] -= by * self.right[i - 1];
        }
        for i in (0..n).rev() {
            let after = if i + 1 < n { self.beside[i] * self.right[i + 1] } else { 0.0 };
            self.right[i] = (self.right[i] - after) / self.diagonal[i];
        }
        self.right
    }
}

/// Interpolates linearly, constant beyond the ends.
fn interpolate(t_s: &[f64], values: &[f64], at_s: f64) -> f64 {
    let after = t_s.partition_point(|t| *t <= at_s).clamp(1, t_s.len() - 1);
    let share = ((at_s - t_s[after - 1]) / (t_s[after] - t_s[after - 1])).clamp(0.0, 1.0);
    values[after - 1] + share * (values[after] - values[after - 1])
}

/// Moving average over `width` samples around each, fewer at the ends.
fn moving_average(x: &[f64], width: usize) -> Vec<f64> {
    let mean = |i: usize| {
        let near = &x[i.saturating_sub(width / 2)..(i + width / 2 + 1).min(x.len())];
        near.iter().sum::<f64>() / near.len() as f64
    };
    (0..x.len()).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn angle(t: f64) -> f64 {
        (1.3 * t).sin() * 0.1 + (3.1 * t + 0.4).sin() * 0.05
    }

    #[test]
    fn a_skew_that_wanders_is_followed() {
        let t_s: Vec<f64> = (0..3000).map(|i| f64::from(i) * 0.01).collect();
        let angles: Vec<f64> = t_s.iter().map(|t| angle(*t)).collect();
        let rate = |t: f64| (angle(t + 1e-4) - angle(t - 1e-4)) / 2e-4;
        // an event at t is logged at t + late(t); the gyro is noisy
        let late = |t: f64| 0.02 + 0.05 * (0.4 * t).sin();
        let happened = |t: f64| (0..30).fold(t, |at, _| t - late(at));
        let noise = |i: usize| 0.02 * ((i * 7919 % 1000) as f64 / 500.0 - 1.0);
        let gyro: Vec<f64> = t_s.iter().enumerate().map(|(i, t)| rate(happened(*t)) + noise(i)).collect();
        let rates = Rates { t_s: &t_s, angles_rad: [&angles, &angles], gyro_radps: [&gyro, &gyro] };
        let delays_s = wander(&rates, &(100..2900)).unwrap();
        let off = |i: usize| delays_s[i] - late(t_s[i]);
        let rms_s = ((150..2850).map(|i| off(i).powi(2)).sum::<f64>() / 2700.0).sqrt();
        // one skew for all would be off by 35 ms
        assert!(rms_s < 0.006, "{rms_s}");
        let still = vec![0.0; 3000];
        assert_eq!(
            wander(
                &Rates { t_s: &t_s, angles_rad: [&still, &still], gyro_radps: [&still, &still] },
                &(100..2900)
            ),
            None
        );
    }
}
