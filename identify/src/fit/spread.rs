//! Where a camera sees a marker worse, its fixes scatter more: how much more, from the scatter itself.

use nalgebra::{Cholesky, DMatrix, DVector};

/// Neighbouring third differences share measurements: their squares correlate by 0.75^2, 0.3^2 and 0.05^2, to both sides.
const SHARED: f64 = 2.3;
/// A square beyond this many times its expectation (one in a hundred) counts as that.
const MOST: f64 = 6.6;
/// What is then left of a mean square of one.
const KEPT: f64 = 0.97;
const ROUNDS: usize = 30;
/// A logarithm of a variance moves no further in a round.
const STRIDE: f64 = 1.0;
/// Chi-squared of the features that one in ten thousand exceeds by chance.
const CHANCE: f64 = 25.7;
/// The scatter must differ by this much (standard deviation of its logarithm) to be worth following.
const LEAST: f64 = 0.15;
/// Fewer fixes do not tell.
const FEWEST: usize = 100;

/// A marker's frame has the marker at its origin, and a pinhole's noise grows with powers of the distance; but a camera may look at another place.
fn features(place_m: &[f64; 3]) -> [f64; 6] {
    let [x, y, z] = *place_m;
    let aside = x * x + y * y;
    [1.0, (aside + z * z).max(1e-4).ln(), aside, x, y, z]
}

/// How the scatter of fixes varies with the place: a factor for each, 1 throughout where it does not vary beyond chance. `thirds` holds the third
/// differences that begin with the fix of that index, scaled to the variance of one fix.
pub fn spread(places_m: &[[f64; 3]], thirds: &[(usize, f64)]) -> Vec<f64> {
    fitted(places_m, thirds).unwrap_or_else(|| vec![1.0; places_m.len()])
}

fn fitted(places_m: &[[f64; 3]], thirds: &[(usize, f64)]) -> Option<Vec<f64>> {
    let n = thirds.len();
    if n < FEWEST {
        return None;
    }
    // one of the two fixes in the middle of four
    let rows: Vec<[f64; 6]> = thirds.iter().map(|(i, _)| features(&places_m[i + 1])).collect();
    let scale = standardised(&rows);
    let of = |row: &[f64; 6]| std::array::from_fn::<f64, 6, _>(|j| (row[j] - scale[j].0) / scale[j].1);
    let design = DMatrix::from_fn(n, 6, |i, j| of(&rows[i])[j]);
    let information = Cholesky::new(design.transpose() * &design + DMatrix::identity(6, 6) * 1e-3)?;
    let squares: Vec<f64> = thirds.iter().map(|(_, d)| d * d).collect();
    let mut at = DVector::zeros(6);
    at[0] = crate::replay::measured::median(&squares).max(1e-12).ln();
    // Fisher scoring: squares are gamma distributed about their expectation, whose logarithm is linear in the features
    for _ in 0..ROUNDS {
        let expected = &design * &at;
        let excess = DVector::from_fn(n, |i, _| (squares[i] * (-expected[i]).exp()).min(MOST) / KEPT - 1.0);
        let step = information.solve(&(design.transpose() * excess));
        let furthest = (&design * &step).amax();
        at += &step * (STRIDE / furthest.max(STRIDE));
    }
    let (slopes, varied) = (at.rows(1, 5).into_owned(), &design * &at);
    let of_slopes = information.inverse().view((1, 1), (5, 5)).into_owned() * (2.0 * SHARED);
    let surprise = slopes.dot(&Cholesky::new(of_slopes)?.solve(&slopes));
    if !(surprise > CHANCE && 0.5 * varied.variance().sqrt() > LEAST) {
        return None;
    }
    let factor = |place_m: &[f64; 3]| {
        let log_variance: f64 = of(&features(place_m)).iter().zip(&at).map(|(f, a)| f * a).sum();
        // nothing is known beyond the places that differences were taken at
        (0.5 * (log_variance.clamp(varied.min(), varied.max()) - varied.mean())).exp()
    };
    Some(places_m.iter().map(factor).collect())
}

/// Mean and standard deviation by which to scale each feature; the constant stays.
fn standardised(rows: &[[f64; 6]]) -> [(f64, f64); 6] {
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
    fn third(s: &[f64]) -> f64 {
        (s[3] - 3.0 * s[2] + 3.0 * s[1] - s[0]) / 20.0_f64.sqrt()
    }

    /// A flight around a marker, with noise that grows by a power of the distance, and how its fixes scatter by the estimate.
    fn flown(power: f64, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let place = |i: usize| {
            let t = i as f64 / 30.0;
            [1.2 * (0.9 * t).sin(), 0.8 * (1.3 * t).sin(), 0.7 + 0.3 * (0.4 * t).sin()]
        };
        let places: Vec<[f64; 3]> = (0..600).map(place).collect();
        let truth: Vec<f64> = places.iter().map(|p| (p.iter().map(|x| x * x).sum::<f64>().sqrt() / 0.7).powf(power)).collect();
        let seen: Vec<f64> = truth.iter().map(|s| 0.005 * s * rng.sample::<f64, _>(StandardNormal)).collect();
        let thirds: Vec<(usize, f64)> = seen.windows(4).map(third).enumerate().collect();
        (truth, spread(&places, &thirds))
    }

    #[test]
    fn noise_that_grows_with_distance_is_followed() {
        let (truth, found) = flown(3.0, 1);
        let ratios: Vec<f64> = truth.iter().zip(&found).map(|(t, f)| (t / f).ln()).collect();
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        let rms = (ratios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / ratios.len() as f64).sqrt();
        let of_truth = truth.iter().map(|t| t.ln()).sum::<f64>() / truth.len() as f64;
        let before = (truth.iter().map(|t| (t.ln() - of_truth).powi(2)).sum::<f64>() / truth.len() as f64).sqrt();
        assert!(rms < 0.15 && before > 0.5, "{rms} of {before}");
    }

    #[test]
    fn even_noise_stays_even() {
        for seed in 0..20 {
            assert!(flown(0.0, seed).1.iter().all(|s| *s == 1.0), "seed {seed}");
        }
    }
}
