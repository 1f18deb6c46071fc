//! Heteroscedastic noise of fixes: a camera sees a marker worse from some places. The scatter itself shows how much
//! worse.

use crazyflie_statistics::quantile;
use nalgebra::{Cholesky, DMatrix, DVector};

/// Neighbouring third differences share measurements: their squares correlate by 0.75^2, 0.3^2 and 0.05^2, to
/// both sides.
const SQUARE_CORRELATION: f64 = 2.3;
/// A square beyond this many times its expectation (one in a hundred) counts as that.
const MOST_SQUARE: f64 = 6.6;
/// The mean of squares clipped so, whose mean was one.
const CLIPPED_MEAN: f64 = 0.97;
const ROUNDS: usize = 30;
/// A logarithm of a variance moves no further in a round.
const MOST_LOG_STEP: f64 = 1.0;
/// Chi-squared of the features that one in ten thousand exceeds by chance.
const LEAST_CHI_SQUARED: f64 = 25.7;
/// The scatter must differ by this much (standard deviation of its logarithm) to be worth following.
const LEAST_LOG_SD: f64 = 0.15;
/// Fewer fixes than this are not fitted.
const FEWEST_FIXES: usize = 100;

/// A marker's frame has the marker at its origin, and a pinhole's noise grows with powers of the distance;
/// but a camera may look at another place.
fn features(place_m: &[f64; 3]) -> [f64; 6] {
    let [x, y, z] = *place_m;
    let aside = x * x + y * y;
    [1.0, (aside + z * z).max(1e-4).ln(), aside, x, y, z]
}

/// Computes how the scatter of fixes varies with the place: a factor for each, 1 throughout if it does not vary
/// beyond chance. `third_differences` has the third differences that begin with the fix of that index, scaled to the
/// variance of one fix.
pub fn noise_scales(places_m: &[[f64; 3]], third_differences: &[(usize, f64)]) -> Vec<f64> {
    fit_noise_scales(places_m, third_differences).unwrap_or_else(|| vec![1.0; places_m.len()])
}

fn fit_noise_scales(places_m: &[[f64; 3]], third_differences: &[(usize, f64)]) -> Option<Vec<f64>> {
    let n = third_differences.len();
    if n < FEWEST_FIXES {
        return None;
    }
    // one of the two fixes in the middle of four
    let rows: Vec<[f64; 6]> = third_differences.iter().map(|(i, _)| features(&places_m[i + 1])).collect();
    let scale = feature_scales(&rows);
    let standardise =
        |row: &[f64; 6]| std::array::from_fn::<f64, 6, _>(|j| (row[j] - scale[j].0) / scale[j].1);
    let design = DMatrix::from_fn(n, 6, |i, j| standardise(&rows[i])[j]);
    let information = Cholesky::new(design.transpose() * &design + DMatrix::identity(6, 6) * 1e-3)?;
    let squares: Vec<f64> = third_differences.iter().map(|(_, d)| d * d).collect();
    let mut coefficients = DVector::zeros(6);
    coefficients[0] = quantile(&squares, 0.5).unwrap_or(0.0).max(1e-12).ln();
    // Fisher scoring: squares are gamma distributed about their expectation, whose logarithm is linear in the
    // features
    for _ in 0..ROUNDS {
        let expected = &design * &coefficients;
        let excess = DVector::from_fn(n, |i, _| {
            (squares[i] * (-expected[i]).exp()).min(MOST_SQUARE) / CLIPPED_MEAN - 1.0
        });
        let step = information.solve(&(design.transpose() * excess));
        let furthest = (&design * &step).amax();
        coefficients += &step * (MOST_LOG_STEP / furthest.max(MOST_LOG_STEP));
    }
    let (slopes, varied) = (coefficients.rows(1, 5).into_owned(), &design * &coefficients);
    let slope_covariance =
        information.inverse().view((1, 1), (5, 5)).into_owned() * (2.0 * SQUARE_CORRELATION);
    let surprise = slopes.dot(&Cholesky::new(slope_covariance)?.solve(&slopes));
    if !(surprise > LEAST_CHI_SQUARED && 0.5 * varied.variance().sqrt() > LEAST_LOG_SD) {
        return None;
    }
    let factor = |place_m: &[f64; 3]| {
        let log_variance: f64 =
            standardise(&features(place_m)).iter().zip(&coefficients).map(|(f, a)| f * a).sum();
        // nothing is known beyond the places that differences were taken at
        (0.5 * (log_variance.clamp(varied.min(), varied.max()) - varied.mean())).exp()
    };
    Some(places_m.iter().map(factor).collect())
}

/// Mean and standard deviation by which to scale each feature; the constant stays.
fn feature_scales(rows: &[[f64; 6]]) -> [(f64, f64); 6] {
    std::array::from_fn(|j| {
        let n = rows.len() as f64;
        let mean = rows.iter().map(|r| r[j]).sum::<f64>() / n;
        let sd = (rows.iter().map(|r| (r[j] - mean).powi(2)).sum::<f64>() / n).sqrt();
        if j == 0 { (0.0, 1.0) } else { (mean, sd.max(1e-9)) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64Mcg;

    /// A scaled third difference.
    fn third_difference(s: &[f64]) -> f64 {
        (s[3] - 3.0 * s[2] + 3.0 * s[1] - s[0]) / 20.0_f64.sqrt()
    }

    /// A flight around a marker, with noise that grows by a power of the distance, and how its fixes scatter
    /// by the estimate.
    fn simulate_fixes(power: f64, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let place = |i: usize| {
            let t = i as f64 / 30.0;
            [1.2 * (0.9 * t).sin(), 0.8 * (1.3 * t).sin(), 0.7 + 0.3 * (0.4 * t).sin()]
        };
        let places: Vec<[f64; 3]> = (0..600).map(place).collect();
        let truth: Vec<f64> =
            places.iter().map(|p| (p.iter().map(|x| x * x).sum::<f64>().sqrt() / 0.7).powf(power)).collect();
        let seen: Vec<f64> = truth.iter().map(|s| 0.005 * s * rng.sample::<f64, _>(StandardNormal)).collect();
        let third_differences: Vec<(usize, f64)> =
            seen.windows(4).map(third_difference).enumerate().collect();
        (truth, noise_scales(&places, &third_differences))
    }

    #[test]
    fn noise_that_grows_with_distance_is_followed() {
        let (truth, found) = simulate_fixes(3.0, 1);
        let ratios: Vec<f64> = truth.iter().zip(&found).map(|(t, f)| (t / f).ln()).collect();
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        let rms = (ratios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / ratios.len() as f64).sqrt();
        let of_truth = truth.iter().map(|t| t.ln()).sum::<f64>() / truth.len() as f64;
        let before =
            (truth.iter().map(|t| (t.ln() - of_truth).powi(2)).sum::<f64>() / truth.len() as f64).sqrt();
        assert!(rms < 0.15 && before > 0.5, "{rms} of {before}");
    }

    #[test]
    fn even_noise_stays_even() {
        for seed in 0..20 {
            assert!(simulate_fixes(0.0, seed).1.iter().all(|s| *s == 1.0), "seed {seed}");
        }
    }
}
