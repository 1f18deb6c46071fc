//! A swinging load: a line in the spectrum of the roll and pitch demands that normal flights do not have.

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use nalgebra::{DMatrix, DVector, Vector4};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::SWING_RATE;
use super::demand::mix;

/// Pendulums of 0.1 to 1.6 m on a vehicle at hand.
const LOWEST_HZ: f64 = 0.4;
const HIGHEST_HZ: f64 = 2.0;
const STEP_HZ: f64 = 0.05;
/// A shorter stretch does not contain two swings of the slowest pendulum.
const SHORTEST_S: f64 = 3.0;
/// A line is inside the band so far from its ends, in widths that the shortest stretch resolves: the flank of a
/// line beyond the band reaches as far.
const EDGE: f64 = 1.8;
const G_MPS2: f64 = 9.81;

/// Logarithm of the power of the roll and pitch demands, less a smooth background: how loud a flight is and how
/// slowly it wanders cancel. Empty if the flight is too short.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SwingSpectrum {
    /// Logarithm of the power less its background, at each of [`frequencies_hz`].
    pub relative: Vec<f64>,
    /// Length of a stretch, which bounds the resolution of frequencies.
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
    /// It is a peak, and away from the ends of the band.
    pub is_inside: bool,
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
        for stretch in long.iter().map(|stretch| (*stretch).clone()) {
            let demand = |row: usize| mix() * Vector4::from_iterator(motors.iter().map(|m| m[row]));
            let demand: Vec<Vector4<f64>> = stretch.clone().map(demand).collect();
            for axis in [1, 2] {
                let signal = demand.iter().map(|d| d[axis] / d[0].max(f64::MIN_POSITIVE));
                let signal = DVector::from_vec(signal.collect());
                for (sum, hz) in power.iter_mut().zip(frequencies_hz()) {
                    *sum += line_power(&t_s[stretch.clone()], &signal, hz);
                }
            }
        }
        let logs: Vec<f64> = power.iter().map(|p| p.max(f64::MIN_POSITIVE).ln()).collect();
        let stretch_s = long.iter().map(|s| duration_s(s)).fold(f64::INFINITY, f64::min);
        Self { relative: less_background(&logs), stretch_s }
    }
}

/// Subtracts a parabola over the logarithm of the frequency from a spectrum: slow drift has no line.
fn less_background(logs: &[f64]) -> Vec<f64> {
    let octaves: Vec<f64> = frequencies_hz().iter().map(|hz| hz.log2()).collect();
    let columns = DMatrix::from_fn(logs.len(), 3, |row, power| octaves[row].powi(power as i32));
    let values = DVector::from_column_slice(logs);
    let normal = columns.transpose() * &columns;
    let Some(inverse) = normal.try_inverse() else { return logs.to_vec() };
    let fit = |values: DVector<f64>| &columns * (&inverse * (columns.transpose() * values));
    let mut background = fit(values.clone());
    // a line does not bend its background
    for _ in 0..4 {
        background = fit(values.zip_map(&background, |value, under| value.min(under + 1.0)));
    }
    (values - background).as_slice().to_vec()
}

/// Squared amplitude of a sine of that frequency beside an offset and a trend: least squares with the weights of
/// a Hann window, so that a strong line has no side lobes.
fn line_power(t_s: &[f64], signal: &DVector<f64>, hz: f64) -> f64 {
    let (start_s, length_s) = (t_s[0], t_s[t_s.len() - 1] - t_s[0]);
    let taper = |row: usize| (PI * (t_s[row] - start_s) / length_s).sin();
    let columns = DMatrix::from_fn(t_s.len(), 4, |row, column| {
        let t = t_s[row] - start_s - 0.5 * length_s;
        let value = match column {
            0 => 1.0,
            1 => t,
            2 => (2.0 * PI * hz * t).cos(),
            _ => (2.0 * PI * hz * t).sin(),
        };
        taper(row) * value
    });
    let tapered = DVector::from_fn(t_s.len(), |row, _| taper(row) * signal[row]);
    let normal = columns.transpose() * &columns;
    let Some(inverse) = normal.try_inverse() else { return 0.0 };
    let fitted = inverse * (columns.transpose() * tapered);
    fitted[2].powi(2) + fitted[3].powi(2)
}

/// Finds the strongest line of the suspect flights against the normal ones: Student's t at each frequency, each
/// flight one observation, times the number of frequencies that the shortest stretch resolves. A line inside the band
/// goes first, because one at the edge may be the flank of something slower. `None` with fewer than two flights on a
/// side.
#[must_use]
pub fn strongest_line(normal: &[SwingSpectrum], suspect: &[SwingSpectrum]) -> Option<SwingLine> {
    let usable = |spectra: &[SwingSpectrum]| {
        spectra.iter().filter(|s| !s.relative.is_empty()).cloned().collect::<Vec<_>>()
    };
    let (a, b) = (usable(normal), usable(suspect));
    if a.len() < 2 || b.len() < 2 {
        return None;
    }
    let shortest_s = a.iter().chain(&b).map(|s| s.stretch_s).fold(f64::INFINITY, f64::min);
    let looks = ((HIGHEST_HZ - LOWEST_HZ) * shortest_s).ceil();
    let n_of = |of: &[SwingSpectrum]| of.len() as f64;
    let (n, m) = (n_of(&a), n_of(&b));
    let mean = |of: &[SwingSpectrum], i: usize| of.iter().map(|s| s.relative[i]).sum::<f64>() / n_of(of);
    let squares = |of: &[SwingSpectrum], i: usize| {
        of.iter().map(|s| (s.relative[i] - mean(of, i)).powi(2)).sum::<f64>()
    };
    let frequencies = frequencies_hz();
    // chance bends the spectrum of normal flights: where a line is, the suspect ones say alone
    let loud: Vec<f64> = (0..frequencies.len()).map(|i| mean(&b, i)).collect();
    let excess: Vec<f64> = (0..frequencies.len()).map(|i| mean(&b, i) - mean(&a, i)).collect();
    let variances: Vec<f64> =
        (0..frequencies.len()).map(|i| (squares(&a, i) + squares(&b, i)) / (n + m - 2.0)).collect();
    // the logarithm of noise's power varies alike at every frequency
    let pooled = variances.iter().sum::<f64>() / variances.len() as f64;
    let student = StudentsT::new(0.0, 1.0, (n + m - 2.0) * looks).ok()?;
    let line = |i: usize| {
        let variance = variances[i].max(pooled) * (1.0 / n + 1.0 / m);
        let t = excess[i] / variance.sqrt().max(f64::MIN_POSITIVE);
        // only more power than normal is a swing
        let p_value = (looks * (1.0 - student.cdf(t))).min(1.0);
        let is_peak = excess.get(i.wrapping_sub(1)..i + 2).is_some_and(|e| e[1] >= e[0] && e[1] >= e[2]);
        let summit = uphill(&loud, i);
        let edge_hz = (frequencies[summit] - LOWEST_HZ).min(HIGHEST_HZ - frequencies[summit]);
        let (is_inside, peak) = match loud.get(summit.wrapping_sub(1)..summit + 2) {
            Some([low, at, high]) if is_peak && edge_hz * shortest_s >= EDGE => {
                (true, 0.5 * (low - high) / (low - 2.0 * at + high).min(-f64::MIN_POSITIVE))
            }
            _ => (false, 0.0),
        };
        let frequency_hz = frequencies[summit] + peak * STEP_HZ;
        SwingLine { frequency_hz, ratio: excess[i].exp(), p_value, is_inside }
    };
    let strongest = |lines: &[SwingLine]| {
        lines.iter().copied().min_by(|a, b| a.p_value.total_cmp(&b.p_value).then(b.ratio.total_cmp(&a.ratio)))
    };
    let lines: Vec<SwingLine> = (0..frequencies.len()).map(line).collect();
    let inside: Vec<SwingLine> = lines.iter().filter(|l| l.is_inside).copied().collect();
    strongest(&inside).filter(|l| l.p_value <= SWING_RATE).or_else(|| strongest(&lines))
}

/// The place of the next peak uphill.
fn uphill(values: &[f64], from: usize) -> usize {
    let mut at = from;
    while let Some(next) = [at.wrapping_sub(1), at + 1].into_iter().find(|i| values.get(*i) > values.get(at))
    {
        at = next;
    }
    at
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64;

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
        let flights = |seeds: std::ops::Range<u64>, swing: f64, hz: f64| {
            seeds.map(|seed| spectrum(seed, swing, hz)).collect::<Vec<SwingSpectrum>>()
        };
        let normal = flights(1..6, 0.0, 1.0);
        let line = strongest_line(&normal, &flights(11..15, 0.003, 0.65)).unwrap();
        assert!(line.is_inside && line.p_value < 1e-3 && (line.frequency_hz - 0.65).abs() < 0.03, "{line:?}");
        assert!((line.length_m(0.05) - 0.62).abs() < 0.06, "{line:?}");
        let line = strongest_line(&normal, &flights(21..25, 0.0, 1.0)).unwrap();
        assert!(line.p_value > 0.05, "{line:?}");
        // a swing beyond the band is no line in it
        let line = strongest_line(&normal, &flights(11..15, 0.01, 0.38)).unwrap();
        assert!(!line.is_inside || line.p_value > SWING_RATE, "{line:?}");
    }

    /// A hover of so many seconds: white noise, a wander of 0.16 Hz so many times as strong, and a swing.
    fn hover(random: &mut Pcg64, wander: f64, swing: f64, hz: f64) -> SwingSpectrum {
        let mut draw = |sd: f64| Normal::new(0.0, sd).unwrap().sample(random);
        let rows = 1400;
        let t_s: Vec<f64> = (0..rows).map(|i| f64::from(i) * 0.01).collect();
        let mut motors = [0; 4].map(|_| vec![0.0; rows as usize]);
        let phase = draw(3.0);
        for (axis, signs) in [[-1.0, -1.0, 1.0, 1.0], [1.0, -1.0, -1.0, 1.0]].into_iter().enumerate() {
            let mut slow = draw(0.0037);
            for row in 0..rows as usize {
                slow += -0.01 * slow + 0.0037 * 0.141 * draw(1.0);
                let swung = swing * (TAU * hz * t_s[row] + phase + axis as f64).sin();
                let share = draw(0.0037) + wander * slow + swung;
                (0..4).for_each(|m| motors[m][row] += 20_000.0 + 40_000.0 * share * signs[m]);
            }
        }
        SwingSpectrum::from_demand(&t_s, &motors, std::slice::from_ref(&(0..rows as usize)))
    }

    /// Shares of named lines, and of those within 5 % of the frequency: a thread within 10 %.
    fn rates(random: &mut Pcg64, wander: f64, swing: f64, band_hz: [f64; 2]) -> [f64; 2] {
        let mut found = [0.0; 2];
        let trials = 30;
        for trial in 0..trials {
            let hz = random.random_range(band_hz[0]..band_hz[1]);
            let flights = |random: &mut Pcg64, wander: f64, swing: f64, count: usize| {
                (0..count).map(|_| hover(random, wander, swing, hz)).collect::<Vec<_>>()
            };
            let normal = flights(random, 1.0, 0.0, 2 + trial % 4);
            let suspect = flights(random, wander, swing, 2 + trial % 3);
            let line = strongest_line(&normal, &suspect).unwrap();
            if line.is_inside && line.p_value <= SWING_RATE {
                found[0] += 1.0 / trials as f64;
                found[1] += f64::from(u8::from((line.frequency_hz / hz - 1.0).abs() < 0.05)) / trials as f64;
            }
        }
        found
    }

    #[test]
    fn a_thread_is_named_inside_the_band_and_never_at_its_edge() {
        let mut random = Pcg64::seed_from_u64(1);
        for wander in [1.0, 3.0] {
            assert!(rates(&mut random, wander, 0.0, [0.5, 1.0])[0] < 0.07, "a wander is no swing: {wander}");
            let [named, right] = rates(&mut random, wander, 0.012, [0.6, 1.8]);
            assert!(named > 0.85 && right > 0.85, "{wander}: {named} {right}");
            let [named, _] = rates(&mut random, wander, 0.015, [0.3, 0.4]);
            assert!(named < 0.08, "{wander}: {named}");
        }
    }

    #[test]
    fn one_flight_is_no_comparison() {
        let (a, b) = (spectrum(1, 0.0, 1.0), spectrum(2, 0.01, 1.0));
        assert_eq!(strongest_line(&[a.clone(), a], &[b]), None);
    }
}
