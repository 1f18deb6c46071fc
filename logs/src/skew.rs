//! The delay between two clocks, from signals that both sides measured.

use crazyflie_statistics::quantile;
use std::ops::Range;

use super::Note;
use super::align::{self, correlation};
use super::signal::usual_step;

/// Wider than any skew seen (79 ms), narrow enough not to find the next period of a manoeuvre.
pub(super) const LONGEST_LAG_S: f64 = 0.3;
/// Below this correlation the peak is noise. The files have 0.65 to 0.97, least where the skew itself
/// wanders.
const LEAST_CORRELATION: f64 = 0.6;
/// Averaging over 0.15 s takes the motor vibration out of the gyro; both sides are averaged, so no lag
/// results.
pub(super) const AVERAGED_S: f64 = 0.15;

/// The same rates as seen by motion capture (angles, still to be differentiated) and by the onboard gyro.
pub(super) struct Rates<'a> {
    pub(super) t_s: &'a [f64],
    /// Roll and pitch.
    pub(super) angles_rad: [&'a [f64]; 2],
    /// Gyro x and y.
    pub(super) gyro_radps: [&'a [f64]; 2],
}

/// Estimates how much later the onboard data appears, in the thirds of `rows`. Nothing is shifted.
pub(super) fn estimate(rates: &Rates<'_>, rows: &Range<usize>) -> Note {
    let third = rows.len() / 3;
    let parts = (0..3).map(|i| rows.start + i * third..rows.start + (i + 1) * third);
    let lags: Vec<f64> = parts.filter_map(|part| lag(rates, &part)).collect();
    if lags.is_empty() {
        return Note::ClockSkewUnknown;
    }
    Note::ClockSkew {
        median_s: quantile(&lags, 0.5).unwrap_or(0.0),
        lowest_s: lags.iter().copied().fold(f64::INFINITY, f64::min),
        highest_s: lags.iter().copied().fold(f64::NEG_INFINITY, f64::max),
    }
}

/// The lag of the highest correlation, both axes together, refined by a parabola through the peak.
pub(super) fn lag(rates: &Rates<'_>, rows: &Range<usize>) -> Option<f64> {
    let step_s = usual_step(&rates.t_s[rows.clone()]);
    if step_s <= 0.0 {
        return None;
    }
    let reach = (LONGEST_LAG_S / step_s).round() as usize;
    let width = (AVERAGED_S / step_s).round().max(1.0) as usize;
    if rows.len() < 4 * (reach + width) {
        return None;
    }
    let mut by_lag = vec![0.0; 2 * reach + 1];
    for (angle, gyro) in rates.angles_rad.iter().zip(rates.gyro_radps) {
        let seen = average(&derivative(&rates.t_s[rows.clone()], &angle[rows.clone()]), width);
        let felt = average(&gyro[rows.clone()], width);
        let middle = &seen[reach..seen.len() - reach];
        for (shift, sum) in by_lag.iter_mut().enumerate() {
            *sum += correlation(middle, &felt[shift..shift + middle.len()]) / 2.0;
        }
    }
    let (peak, _) = align::peak(&by_lag, LEAST_CORRELATION)?;
    Some((peak - reach as f64) * step_s)
}

/// Central differences, the ends repeated.
pub(super) fn derivative(t_s: &[f64], x: &[f64]) -> Vec<f64> {
    let last = x.len() - 1;
    let slope = |i: usize| {
        let (a, b) = (i.saturating_sub(1), (i + 1).min(last));
        (x[b] - x[a]) / (t_s[b] - t_s[a])
    };
    (0..=last).map(slope).collect()
}

/// Moving average over `width` samples.
fn average(x: &[f64], width: usize) -> Vec<f64> {
    x.windows(width).map(|w| w.iter().sum::<f64>() / width as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn angle(t: f64) -> f64 {
        (1.3 * t).sin() * 0.1 + (3.1 * t + 0.4).sin() * 0.05
    }

    #[test]
    fn a_known_delay_is_found_to_a_millisecond() {
        let t_s: Vec<f64> = (0..3000).map(|i| f64::from(i) * 0.01).collect();
        let angles: Vec<f64> = t_s.iter().map(|t| angle(*t)).collect();
        let rate = |t: f64| (angle(t + 1e-4) - angle(t - 1e-4)) / 2e-4;
        let gyro: Vec<f64> = t_s.iter().map(|t| rate(t - 0.023)).collect();
        let rates = Rates { t_s: &t_s, angles_rad: [&angles, &angles], gyro_radps: [&gyro, &gyro] };
        let Note::ClockSkew { median_s, lowest_s, highest_s } = estimate(&rates, &(0..3000)) else {
            panic!("no skew found");
        };
        assert!((median_s - 0.023).abs() < 1e-3, "{median_s}");
        assert!(highest_s - lowest_s < 2e-3);
    }

    #[test]
    fn no_motion_gives_no_skew() {
        let t_s: Vec<f64> = (0..3000).map(|i| f64::from(i) * 0.01).collect();
        let still = vec![0.0; 3000];
        let rates = Rates { t_s: &t_s, angles_rad: [&still, &still], gyro_radps: [&still, &still] };
        assert_eq!(estimate(&rates, &(0..3000)), Note::ClockSkewUnknown);
    }
}
