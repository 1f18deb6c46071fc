//! A swinging load: a line in the spectrum of the roll and pitch demands that normal flights do not have.

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use nalgebra::{DMatrix, DVector, Vector4};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::demand::mix;

/// Pendulums of 0.1 to 1.6 m on a vehicle at hand.
const LOWEST_HZ: f64 = 0.4;
const HIGHEST_HZ: f64 = 2.0;
const STEP_HZ: f64 = 0.05;
/// A shorter stretch does not hold two swings of the slowest pendulum.
const SHORTEST_S: f64 = 3.0;
const G_MPS2: f64 = 9.81;

/// Logarithm of the power of the roll and pitch demands, less its mean over the band: how loud a flight is
/// cancels. Empty if the flight is too short.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SwingSpectrum {
    /// Logarithm of the power less its mean over the band, at each of [`frequencies_hz`].
    pub relative: Vec<f64>,
    /// Length of a stretch, which bounds what frequencies can be told apart.
    pub stretch_s: f64,
}

/// A line in the spectrum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SwingLine {
    /// Frequency of the line, out of [`frequencies_hz`].
    pub frequency_hz: f64,
    /// Power over that of normal flights, both relative to their bands.
    pub ratio: f64,
    /// Chance of a line like this anywhere in the band.
    pub p_value: f64,
}

impl SwingLine {
    /// Length of a thread whose load swings so under a vehicle that moves with it; `load` is the load's mass
    /// over the vehicle's. f = sqrt(g (1 + load) / L) / (2 pi).
    #[must_use]
    pub fn length_m(&self, load: f64) -> f64 {
        G_MPS2 * (1.0 + load) / (TAU * self.frequency_hz).powi(2)
    }
}

/// Frequencies of the spectra.
#[must_use]
pub fn frequencies_hz() -> Vec<f64> {
    let count = ((HIGHEST_HZ - LOWEST_HZ) / STEP_HZ).round() as usize;
    (0..=count).map(|i| LOWEST_HZ + STEP_HZ * i as f64).collect()
}

impl SwingSpectrum {
    /// Spectrum over the steady stretches of a flight.
    pub(super) fn from_demand(t_s: &[f64], motors: &[Vec<f64>; 4], stretches: &[Range<usize>]) -> Self {
        let duration_s = |s: &Range<usize>| t_s[s.end - 1] - t_s[s.start];
        let long: Vec<&Range<usize>> = stretches.iter().filter(|s| duration_s(s) >= SHORTEST_S).collect();
        if long.is_empty() {
            return Self::default();
        }
        let mut power = vec![0.0; frequencies_hz().len()];
        for stretch in &long {
            let demand: Vec<Vector4<f64>> = (*stretch)
                .clone()
                .map(|row| mix() * Vector4::from_iterator(motors.iter().map(|m| m[row])))
                .collect();
            for axis in [1, 2] {
                let signal = DVector::from_iterator(
                    demand.len(),
                    demand.iter().map(|d| d[axis] / d[0].max(f64::MIN_POSITIVE)),
                );
                for (sum, hz) in power.iter_mut().zip(frequencies_hz()) {
                    *sum += line_power(&t_s[(*stretch).clone()], &signal, hz);
                }
            }
        }
        let logs: Vec<f64> = power.iter().map(|p| p.max(f64::MIN_POSITIVE).ln()).collect();
        let mean = logs.iter().sum::<f64>() / logs.len() as f64;
        let stretch_s = long.iter().map(|s| duration_s(s)).fold(f64::INFINITY, f64::min);
        Self { relative: logs.iter().map(|l| l - mean).collect(), stretch_s }
    }
}

/// Squared amplitude of a sine of that frequency beside an offset and a trend, least squares.
fn line_power(t_s: &[f64], signal: &DVector<f64>, hz: f64) -> f64 {
    let middle_s = 0.5 * (t_s[0] + t_s[t_s.len() - 1]);
    let columns = DMatrix::from_fn(t_s.len(), 4, |row, column| {
        let t = t_s[row] - middle_s;
        match column {
            0 => 1.0,
            1 => t,
            2 => (2.0 * PI * hz * t).cos(),
            _ => (2.0 * PI * hz * t).sin(),
        }
    });
    let normal = columns.transpose() * &columns;
    let Some(inverse) = normal.try_inverse() else { return 0.0 };
    let fitted = inverse * (columns.transpose() * signal);
    fitted[2].powi(2) + fitted[3].powi(2)
}

/// The strongest line of the suspect flights against the normal ones: Student's t at each frequency, each
/// flight one observation, times the number of frequencies that the shortest stretch tells apart. `None` with
/// fewer than two flights on a side.
#[must_use]
pub fn strongest_line(normal: &[&SwingSpectrum], suspect: &[&SwingSpectrum]) -> Option<SwingLine> {
    let usable = |spectra: &[&SwingSpectrum]| {
        spectra.iter().filter(|s| !s.relative.is_empty()).map(|s| s.relative.clone()).collect::<Vec<_>>()
    };
    let (a, b) = (usable(normal), usable(suspect));
    if a.len() < 2 || b.len() < 2 {
        return None;
    }
    let shortest_s = normal
        .iter()
        .chain(suspect)
        .filter(|s| s.stretch_s > 0.0)
        .map(|s| s.stretch_s)
        .fold(f64::INFINITY, f64::min);
    let looks = ((HIGHEST_HZ - LOWEST_HZ) * shortest_s).ceil();
    let (n, m) = (a.len() as f64, b.len() as f64);
    let student = StudentsT::new(0.0, 1.0, n + m - 2.0).ok()?;
    let at = |i: usize, hz: f64| {
        let mean = |spectra: &[Vec<f64>]| spectra.iter().map(|s| s[i]).sum::<f64>() / spectra.len() as f64;
        let squares =
            |spectra: &[Vec<f64>], mean: f64| spectra.iter().map(|s| (s[i] - mean).powi(2)).sum::<f64>();
        let (normal, suspect) = (mean(&a), mean(&b));
        let variance = (squares(&a, normal) + squares(&b, suspect)) / (n + m - 2.0);
        let t = (suspect - normal) / (variance * (1.0 / n + 1.0 / m)).sqrt().max(f64::MIN_POSITIVE);
        // only more power than normal is a swing
        let p_value = (looks * (1.0 - student.cdf(t))).min(1.0);
        SwingLine { frequency_hz: hz, ratio: (suspect - normal).exp(), p_value }
    };
    frequencies_hz()
        .iter()
        .enumerate()
        .map(|(i, hz)| at(i, *hz))
        .min_by(|a, b| a.p_value.total_cmp(&b.p_value).then(b.ratio.total_cmp(&a.ratio)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten seconds of noisy roll demand with a swing of that share of the thrust.
    fn spectrum(seed: u64, swing: f64, hz: f64) -> SwingSpectrum {
        let t_s: Vec<f64> = (0..1000).map(|i| f64::from(i) * 0.01).collect();
        let noise = |i: usize| ((i as f64 + 1.0) * (12.9898 + seed as f64)).sin() * 43_758.547;
        let roll = |i: usize| {
            0.01 * (noise(i) - noise(i).floor() - 0.5) + swing * (TAU * hz * t_s[i] + seed as f64).sin()
        };
        let side = |sign: f64| (0..1000).map(|i| 40_000.0 * (1.0 + sign * roll(i))).collect::<Vec<f64>>();
        SwingSpectrum::from_demand(
            &t_s,
            &[side(-1.0), side(-1.0), side(1.0), side(1.0)],
            std::slice::from_ref(&(0..1000)),
        )
    }

    #[test]
    fn a_swing_is_a_line_whose_frequency_gives_the_thread() {
        let normal: Vec<SwingSpectrum> = (1..6).map(|seed| spectrum(seed, 0.0, 1.0)).collect();
        let swinging: Vec<SwingSpectrum> = (11..15).map(|seed| spectrum(seed, 0.003, 0.65)).collect();
        let line =
            strongest_line(&normal.iter().collect::<Vec<_>>(), &swinging.iter().collect::<Vec<_>>()).unwrap();
        assert!(line.p_value < 1e-3 && (line.frequency_hz - 0.65).abs() < 0.06, "{line:?}");
        assert!((line.length_m(0.05) - 0.62).abs() < 0.12, "{line:?}");
        let quiet: Vec<SwingSpectrum> = (21..25).map(|seed| spectrum(seed, 0.0, 1.0)).collect();
        let line =
            strongest_line(&normal.iter().collect::<Vec<_>>(), &quiet.iter().collect::<Vec<_>>()).unwrap();
        assert!(line.p_value > 0.05, "{line:?}");
    }

    #[test]
    fn one_flight_is_no_comparison() {
        let (a, b) = (spectrum(1, 0.0, 1.0), spectrum(2, 0.01, 1.0));
        assert_eq!(strongest_line(&[&a, &a], &[&b]), None);
    }
}
