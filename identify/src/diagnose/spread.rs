//! Spread of hover trims between flights and set-ups of a vehicle without a fault.

use super::trim::Trim;

/// Relative trim: logarithm of the thrust, then roll, pitch and yaw as shares of it.
pub type RelativeTrim = [f64; 4];

/// Standard deviations before any flight is seen, as shares of the hover thrust: thrust, roll, pitch, yaw. Between
/// set-ups a battery lies elsewhere and has another charge. From the folders of CrazyPAD's vehicle E8, and thrust
/// from its set-ups that differ by 4 %.
const BETWEEN: [f64; 4] = [0.022, 0.014, 0.014, 0.005];
/// The same between the flights of a set-up.
const WITHIN: [f64; 4] = [0.008, 0.01, 0.01, 0.008];
/// Degrees of freedom that these are worth.
const KNOWN_FREEDOM: f64 = 6.0;

/// Variances between set-ups and between flights without a fault, with their degrees of freedom.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NormalSpread {
    between: [f64; 4],
    within: [f64; 4],
    between_freedom: [f64; 4],
    within_freedom: [f64; 4],
}

/// Weights of the two variances in that of a mean over set-ups.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SampleSize {
    /// The variance of the mean is that between set-ups over this number, and
    pub set_ups: f64,
    /// this share of that within a set-up.
    pub within_share: f64,
}

impl SampleSize {
    /// Computes the numbers of flights grouped by set-up.
    pub(super) fn from_groups<T>(groups: &[Vec<T>]) -> Self {
        let set_ups = groups.len() as f64;
        let inverse: f64 = groups.iter().map(|g| 1.0 / g.len() as f64).sum();
        Self { set_ups, within_share: inverse / (set_ups * set_ups) }
    }
}

/// Noise of a difference of trims: Student's t.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Noise {
    pub sd: f64,
    pub freedom: f64,
}

impl Noise {
    /// Chance of less than z standard deviations. Freedom is rounded to an even number, for which it is a sum.
    fn chance_below(&self, z: f64) -> f64 {
        let half = (0.5 * self.freedom).round().clamp(1.0, 15.0);
        let square = 1.0 + 0.5 * z * z / half;
        let (mut sum, mut term) = (0.0, 1.0);
        for k in 1..=half as u32 {
            sum += term;
            term *= (1.0 - 0.5 / f64::from(k)) / square;
        }
        0.5 + 0.5 * z / (2.0 * half * square).sqrt() * sum
    }

    /// Density of a value whose mean lies anywhere in a range.
    pub(crate) fn density(&self, value: f64, range: [f64; 2]) -> f64 {
        /// A range that is narrower is a point, in standard deviations.
        const POINT: f64 = 0.02;
        let middle = 0.5 * (range[0] + range[1]);
        let half = (0.5 * (range[1] - range[0]).abs()).max(0.5 * POINT * self.sd);
        let at = |mean: f64| self.chance_below((value - mean) / self.sd);
        ((at(middle - half) - at(middle + half)) / (2.0 * half)).max(f64::MIN_POSITIVE)
    }
}

/// The trim in numbers whose differences are shares of the thrust.
#[must_use]
pub(crate) fn relative_trim(trim: &Trim) -> RelativeTrim {
    let [roll, pitch, yaw] = trim.shares;
    [trim.thrust.ln(), roll, pitch, yaw]
}

/// Mean of some trims.
#[must_use]
pub(crate) fn mean_trim(trims: &[RelativeTrim]) -> RelativeTrim {
    std::array::from_fn(|i| trims.iter().map(|t| t[i]).sum::<f64>() / trims.len() as f64)
}

/// Mean of the means of set-ups: many flights of one set-up do not outweigh another.
#[must_use]
pub(crate) fn mean_of_set_ups(set_ups: &[Vec<RelativeTrim>]) -> RelativeTrim {
    mean_trim(&set_ups.iter().map(|s| mean_trim(s)).collect::<Vec<_>>())
}

impl NormalSpread {
    /// Spread about the mean of each vehicle, and what is known before. Roll and pitch share one: a battery is
    /// put in askew either way.
    ///
    /// `vehicles` has for each vehicle its set-ups, for each set-up its flights.
    #[must_use]
    pub fn from_set_ups(vehicles: &[Vec<Vec<RelativeTrim>>]) -> Self {
        let (mut squares, mut freedom) = ([[0.0; 4]; 2], [0.0; 2]);
        let mut shares = 0.0;
        for set_ups in vehicles {
            let middle = mean_of_set_ups(set_ups);
            for set_up in set_ups {
                let mean = mean_trim(set_up);
                for i in 0..4 {
                    squares[0][i] += (mean[i] - middle[i]).powi(2);
                    squares[1][i] += set_up.iter().map(|t| (t[i] - mean[i]).powi(2)).sum::<f64>();
                }
                freedom[1] += set_up.len() as f64 - 1.0;
            }
            let [k, size] = [set_ups.len() as f64, SampleSize::from_groups(set_ups).within_share];
            freedom[0] += k - 1.0;
            // the means of set-ups differ by their flights too
            shares += (k - 1.0) * k * size;
        }
        let pooled = |s: [f64; 4]| [s[0], s[1] + s[2], s[1] + s[2], s[3]];
        let looks = [1.0, 2.0, 2.0, 1.0];
        let squares = squares.map(pooled);
        let known = |sd: f64, squares: f64, freedom: f64| {
            (KNOWN_FREEDOM * sd * sd + squares.max(0.0)) / (KNOWN_FREEDOM + freedom)
        };
        let freedoms = freedom.map(|f| looks.map(|n| n * f));
        let within: [f64; 4] = std::array::from_fn(|i| known(WITHIN[i], squares[1][i], freedoms[1][i]));
        let between = std::array::from_fn(|i| {
            known(BETWEEN[i], squares[0][i] - looks[i] * shares * within[i], freedoms[0][i])
        });
        let [between_freedom, within_freedom] = freedoms.map(|of| of.map(|f| f + KNOWN_FREEDOM));
        Self { between, within, between_freedom, within_freedom }
    }

    /// Noise of the difference between the mean of suspect set-ups and that of normal ones; its freedom is
    /// Satterthwaite's (1946).
    #[must_use]
    pub fn difference(&self, normal: SampleSize, suspect: SampleSize) -> [Noise; 4] {
        std::array::from_fn(|i| {
            let between = self.between[i] * (1.0 / suspect.set_ups + 1.0 / normal.set_ups);
            let within = self.within[i] * (suspect.within_share + normal.within_share);
            let variance = between + within;
            let freedom = variance * variance
                / (between * between / self.between_freedom[i] + within * within / self.within_freedom[i]);
            Noise { sd: variance.sqrt(), freedom }
        })
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64;
    use statrs::distribution::{ContinuousCDF, StudentsT};

    use super::*;

    /// Set-ups whose flights differ by 1 % and whose means differ by so much.
    fn set_ups(random: &mut Pcg64, set_ups: usize, flights: usize, between: f64) -> Vec<Vec<RelativeTrim>> {
        let mut draw = |sd: f64| Normal::new(0.0, sd).unwrap().sample(random);
        let mut set_up = || {
            let own: [f64; 4] = std::array::from_fn(|_| draw(between));
            (0..flights).map(|_| own.map(|o| o + draw(0.01))).collect()
        };
        (0..set_ups).map(|_| set_up()).collect()
    }

    #[test]
    fn the_chance_of_a_normal_set_up_is_what_it_says() {
        for (between, seldom) in [(0.003, 0.0), (0.01, 0.0), (0.02, 0.02)] {
            let mut random = Pcg64::seed_from_u64(7);
            let mut rates = [0.0; 4];
            let trials = 2000;
            for _ in 0..trials {
                let normal = set_ups(&mut random, 5, 3, between);
                let suspect = set_ups(&mut random, 1, 3, between);
                let noise = NormalSpread::from_set_ups(std::slice::from_ref(&normal))
                    .difference(SampleSize::from_groups(&normal), SampleSize::from_groups(&suspect));
                let (own, middle) = (mean_of_set_ups(&suspect), mean_of_set_ups(&normal));
                for i in 0..4 {
                    let z = (own[i] - middle[i]).abs() / noise[i].sd;
                    rates[i] += f64::from(u8::from(noise[i].chance_below(z) > 0.975)) / f64::from(trials);
                }
            }
            // prior knowledge makes alarms rarer for similar set-ups, in yaw more frequent for others
            assert!(rates[..3].iter().all(|rate| (seldom..0.09).contains(rate)), "{between}: {rates:?}");
            assert!(rates[3] < 0.2, "{between}: {rates:?}");
        }
    }

    #[test]
    fn the_chance_is_that_of_students_t() {
        for half in [1.0, 3.0, 9.0] {
            let noise = Noise { sd: 2.0, freedom: 2.0 * half };
            let student = StudentsT::new(0.0, 1.0, noise.freedom).unwrap();
            for z in [-7.0, -1.3, 0.0, 0.4, 3.0] {
                assert!((noise.chance_below(z) - student.cdf(z)).abs() < 1e-6, "{half} {z}");
            }
            let of_a_point = noise.density(1.0, [0.0; 2]);
            assert!((of_a_point * 0.02 - (student.cdf(0.505) - student.cdf(0.495))).abs() < 1e-4);
        }
    }
}
