//! Spread of hover trims between flights and set-ups of a vehicle without a fault.

use statrs::distribution::{ContinuousCDF, StudentsT};

use super::trim::Trim;

/// Relative trim: logarithm of the thrust, then roll, pitch and yaw as shares of it.
pub type RelativeTrim = [f64; 4];

/// Components of variance of one number: between set-ups and between the flights of one.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Components {
    between: f64,
    within: f64,
    /// Degrees of freedom of their sum, after Satterthwaite (1946).
    freedom: f64,
}

/// Normal trims of one vehicle or several: their means, and how far a new set-up lies from them by chance.
#[derive(Debug, Clone)]
pub(crate) struct NormalSpread {
    components: [Components; 4],
}

/// How well the mean of some flights is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SampleSize {
    pub set_ups: usize,
    pub flights: usize,
}

impl SampleSize {
    /// Of flights grouped by set-up.
    pub(super) fn from_groups<T>(groups: &[Vec<T>]) -> Self {
        Self { set_ups: groups.len(), flights: groups.iter().map(Vec::len).sum() }
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

impl NormalSpread {
    /// Spread about the mean of each vehicle. Roll and pitch share one: a battery is put in askew either way.
    /// `None` for fewer than three flights, or if nothing differs.
    ///
    /// `vehicles` holds for each vehicle its set-ups, for each set-up its flights.
    #[must_use]
    pub fn from_set_ups(vehicles: &[Vec<Vec<RelativeTrim>>]) -> Option<Self> {
        let flights: usize = vehicles.iter().flatten().map(Vec::len).sum();
        if flights < vehicles.len() + 2 {
            return None;
        }
        let [thrust, roll, pitch, yaw] = std::array::from_fn(|i| components(vehicles, i));
        let (roll, pitch) = (roll?, pitch?);
        let balance = Components {
            between: 0.5 * (roll.between + pitch.between),
            within: 0.5 * (roll.within + pitch.within),
            freedom: roll.freedom + pitch.freedom,
        };
        let components = [thrust?, balance, balance, yaw?];
        components.iter().all(|c| c.between + c.within > 0.0).then_some(Self { components })
    }

    /// Standard deviations of a flight of a new set-up.
    #[must_use]
    pub fn standard_deviations(&self) -> [f64; 4] {
        self.components.map(|c| (c.between + c.within).sqrt())
    }

    /// Degrees of freedom of the standard deviations.
    #[must_use]
    pub fn freedom(&self) -> [f64; 4] {
        self.components.map(|c| c.freedom)
    }

    /// Variances of the difference between the mean of suspect flights and that of normal ones. What a set-up
    /// has of its own may be common to all of its flights, however alike they are: each suspect set-up counts
    /// as one draw.
    #[must_use]
    pub fn difference_variances(&self, normal: SampleSize, suspect_set_ups: usize) -> [f64; 4] {
        let (k, n) = (normal.set_ups as f64, normal.flights as f64);
        self.components
            .map(|c| (c.between + c.within) / suspect_set_ups as f64 + c.between / k + c.within / n)
    }

    /// Two-sided chance of a difference of so many standard deviations in one of the four numbers.
    #[must_use]
    pub fn chance(&self, number: usize, z: f64) -> f64 {
        StudentsT::new(0.0, 1.0, self.components[number].freedom)
            .map_or(1.0, |t| 2.0 * (1.0 - t.cdf(z.abs())))
    }
}

/// Analysis of variance with unequal groups: `n0` is the effective number of flights of a set-up.
fn components(vehicles: &[Vec<Vec<RelativeTrim>>], i: usize) -> Option<Components> {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (mut within, mut within_freedom, mut between, mut between_freedom, mut n0) =
        (0.0, 0.0, 0.0, 0.0, 0.0);
    for set_ups in vehicles {
        let values: Vec<Vec<f64>> = set_ups.iter().map(|s| s.iter().map(|t| t[i]).collect()).collect();
        let all: Vec<f64> = values.concat();
        let middle = mean(&all);
        for set_up in &values {
            let m = mean(set_up);
            within += set_up.iter().map(|v| (v - m).powi(2)).sum::<f64>();
            between += set_up.len() as f64 * (m - middle).powi(2);
        }
        let n = all.len() as f64;
        within_freedom += n - values.len() as f64;
        between_freedom += values.len() as f64 - 1.0;
        n0 += n - values.iter().map(|s| (s.len() * s.len()) as f64).sum::<f64>() / n;
    }
    if within_freedom <= 0.0 && between_freedom <= 0.0 {
        return None;
    }
    if between_freedom <= 0.0 {
        let within = within / within_freedom;
        return Some(Components { between: 0.0, within, freedom: within_freedom });
    }
    let n0 = n0 / between_freedom;
    let mean_between = between / between_freedom;
    if within_freedom <= 0.0 {
        return Some(Components { between: mean_between, within: 0.0, freedom: between_freedom });
    }
    let within = within / within_freedom;
    let parts = [mean_between / n0, (1.0 - 1.0 / n0) * within];
    let sum = parts[0] + parts[1];
    let freedom = sum * sum / (parts[0] * parts[0] / between_freedom + parts[1] * parts[1] / within_freedom);
    let between = (parts[0] - within / n0).max(0.0);
    Some(Components { between, within: sum - between, freedom })
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64;

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
        for between in [0.0, 0.01, 0.03] {
            let mut random = Pcg64::seed_from_u64(7);
            let mut alarms = [0.0; 4];
            let trials = 2000;
            for _ in 0..trials {
                let normal = set_ups(&mut random, 5, 3, between);
                let suspect = mean_trim(&set_ups(&mut random, 1, 3, between)[0]);
                let spread = NormalSpread::from_set_ups(std::slice::from_ref(&normal)).unwrap();
                let variances = spread.difference_variances(SampleSize::from_groups(&normal), 1);
                let middle = mean_trim(&normal.concat());
                for i in 0..4 {
                    let z = (suspect[i] - middle[i]) / variances[i].sqrt();
                    alarms[i] += f64::from(u8::from(spread.chance(i, z) < 0.05)) / f64::from(trials);
                }
            }
            // a set-up's flights are averaged, which only makes the alarm rarer
            assert!(alarms.iter().all(|rate| *rate < 0.065), "{between}: {alarms:?}");
            assert!(between < 0.02 || alarms.iter().all(|rate| *rate > 0.02), "{between}: {alarms:?}");
        }
    }

    #[test]
    fn two_flights_say_nothing_of_a_spread() {
        let trims = vec![vec![[10.0, 0.0, 0.0, 0.1], [10.1, 0.01, 0.0, 0.1]]];
        assert!(NormalSpread::from_set_ups(&[trims]).is_none());
    }
}
