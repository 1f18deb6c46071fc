//! Tests of the residuals of a model: whether anything is left in them (whiteness), whether the input still
//! explains some of it (independence), and whether another parameter was worth its place (AIC, BIC).
//!
//! Several flights are several segments: products are only taken within a segment, sums over all of them. The
//! bounds are those of MATLAB's `resid`, at 99 %.

use statrs::distribution::{ChiSquared, ContinuousCDF, Normal, StudentsT};
use thiserror::Error;

/// Lags that MATLAB's `resid` looks at.
pub const LAGS: usize = 25;
/// Share of correct models that a test passes.
pub const CONFIDENCE: f64 = 0.99;

/// Why there is no test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[allow(missing_docs, reason = "each variant's message says what went wrong")]
pub enum StatisticsError {
    #[error("{samples} samples are too few for correlations to lag {lags}: expected at least {least}")]
    TooShort { samples: usize, lags: usize, least: usize },
    #[error("the {signal} is constant, so nothing correlates with it")]
    Constant { signal: &'static str },
    #[error("segment {segment} has {residuals} residuals and {inputs} inputs: they must be equal")]
    LengthMismatch { segment: usize, residuals: usize, inputs: usize },
    #[error("the {signal} contains a value that is not finite")]
    NotFinite { signal: &'static str },
}

/// The autocorrelation of residuals. White residuals leave nothing to predict; an output-error fit to
/// coloured measurement noise is right and still fails, so this test informs and [`Independence`] decides.
#[derive(Debug, Clone, PartialEq)]
pub struct Whiteness {
    /// At lags 1, 2, ...; at lag 0 it is 1.
    pub correlation: Vec<f64>,
    /// A white sequence stays within plus and minus this, at each lag with a probability of 99 %.
    pub bound: f64,
    /// Lags outside the bound.
    pub outside: usize,
    /// N (N + 2) sum r_k^2 / (N - k)   (Ljung and Box 1978)
    pub ljung_box: f64,
    /// Lags less parameters that were fitted.
    pub freedom: usize,
    /// Probability that white residuals have a larger [`Whiteness::ljung_box`].
    pub p_value: f64,
    /// Number of residuals over all segments.
    pub samples: usize,
}

impl Whiteness {
    /// Returns whether the Ljung-Box test finds nothing at 99 %.
    pub fn is_white(&self) -> bool {
        self.p_value > 1.0 - CONFIDENCE
    }
}

/// The correlation of residuals with the input before and after them.
#[derive(Debug, Clone, PartialEq)]
pub struct Independence {
    /// From `-lags` to `lags`. At a positive lag the input is earlier: the model should have explained the
    /// correlation there. At a negative lag the residual is earlier: a controller answers it, which is feedback and
    /// no fault of the model.
    pub lags: Vec<isize>,
    /// Correlation at each of [`Independence::lags`], between -1 and 1.
    pub correlation: Vec<f64>,
    /// An input that has nothing to do with the residuals stays within, at each lag with a probability of 99
    /// %. Wider than for white signals where both are coloured.
    pub bound: f64,
    /// Joint bound for all lags from 0 on, like [`Independence::bound`] (Bonferroni, over the number of independent
    /// lags).
    pub joint_bound: f64,
    /// Lags from 0 on outside [`Independence::bound`].
    pub outside: usize,
    /// Negative lags outside it: reported, not judged.
    pub feedback: usize,
    /// Number of residuals over all segments.
    pub samples: usize,
}

impl Independence {
    /// Returns whether no lag from 0 on leaves the joint bound: the test at 99 % over all of them.
    pub fn is_independent(&self) -> bool {
        self.lags.iter().zip(&self.correlation).all(|(lag, r)| *lag < 0 || r.abs() <= self.joint_bound)
    }
}

/// Autocorrelation up to a lag, and the Ljung-Box test with the freedom that `parameters` fitted ones leave.
///
/// # Errors
/// [`StatisticsError`]: too short, constant, not finite.
pub fn whiteness(residuals: &[&[f64]], lags: usize, parameters: usize) -> Result<Whiteness, StatisticsError> {
    let e = centre_segments(residuals, "residual", lags)?;
    let samples = count(&e);
    let power = products(&e, &e, 0);
    let correlation: Vec<f64> = (1..=lags).map(|lag| products(&e, &e, lag as isize) / power).collect();
    let n = samples as f64;
    let ljung_box = correlation.iter().enumerate().map(|(i, r)| r * r / (n - (i + 1) as f64)).sum::<f64>()
        * n
        * (n + 2.0);
    let bound = quantile(0.5 * (1.0 + CONFIDENCE)) / n.sqrt();
    let freedom = lags.saturating_sub(parameters).max(1);
    let p_value = ChiSquared::new(freedom as f64).map_or(f64::NAN, |chi| chi.sf(ljung_box));
    let outside = correlation.iter().filter(|r| r.abs() > bound).count();
    Ok(Whiteness { correlation, bound, outside, ljung_box, freedom, p_value, samples })
}

/// Correlation of the input `lag` samples before a residual with that residual.
///
/// # Errors
/// [`StatisticsError`]: unequal lengths, too short, constant, not finite.
pub fn independence(
    input: &[&[f64]],
    residuals: &[&[f64]],
    lags: usize,
) -> Result<Independence, StatisticsError> {
    for (segment, (e, u)) in residuals.iter().zip(input).enumerate() {
        if e.len() != u.len() {
            return Err(StatisticsError::LengthMismatch { segment, residuals: e.len(), inputs: u.len() });
        }
    }
    let (e, u) = (centre_segments(residuals, "residual", lags)?, centre_segments(input, "input", lags)?);
    let samples = count(&e);
    let scale = (products(&e, &e, 0) * products(&u, &u, 0)).sqrt();
    let all: Vec<isize> = (-(lags as isize)..=lags as isize).collect();
    let correlation: Vec<f64> = all.iter().map(|lag| products(&e, &u, *lag) / scale).collect();
    // the variance of a correlation of independent signals is the sum of the products of their
    // autocorrelations (Bartlett 1935)
    let spread = (1..=3 * lags as isize).map(|lag| {
        let taper = 1.0 - lag as f64 / (3 * lags + 1) as f64;
        taper * products(&e, &e, lag) / products(&e, &e, 0) * products(&u, &u, lag) / products(&u, &u, 0)
    });
    let spread = (1.0 + 2.0 * spread.sum::<f64>()).max(0.1);
    let sd = (spread / samples as f64).sqrt();
    let bound = quantile(0.5 * (1.0 + CONFIDENCE)) * sd;
    // neighbouring lags of coloured signals say nearly the same: so many are left that do not
    let tests = ((lags + 1) as f64 / spread).clamp(1.0, (lags + 1) as f64);
    let joint_bound = quantile(1.0 - 0.5 * (1.0 - CONFIDENCE) / tests) * sd;
    let outside = |judged: bool| {
        all.iter().zip(&correlation).filter(|(lag, r)| (**lag >= 0) == judged && r.abs() > bound).count()
    };
    let (outside, feedback) = (outside(true), outside(false));
    Ok(Independence { lags: all, correlation, bound, joint_bound, outside, feedback, samples })
}

/// Information criteria of a model: its likelihood with a penalty for its parameters; the smaller the better. Only
/// differences between models of the same data mean anything. Residuals that are not white contain less information
/// than their number: both then favour too many parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Criteria {
    /// N ln(sum e^2 / N) + 2 p, the first term summed over the outputs   (Akaike 1974)
    pub aic: f64,
    /// N ln(sum e^2 / N) + p ln N   (Schwarz 1978)
    pub bic: f64,
}

/// Computes the criteria of a fit with normal errors of unknown size, per output: sums of squared residuals, and
/// their number.
pub fn criteria(outputs: &[(f64, usize)], parameters: usize) -> Criteria {
    let (n, p) = (outputs.iter().map(|(_, samples)| *samples as f64).sum::<f64>(), parameters as f64);
    let likelihood: f64 =
        outputs.iter().map(|(squares, samples)| *samples as f64 * (squares / *samples as f64).ln()).sum();
    Criteria { aic: likelihood + 2.0 * p, bic: likelihood + p * n.ln() }
}

/// Student's paired t test: the two-sided p value of differences whose mean is zero; `None` for fewer than
/// two, or where they do not vary.
pub fn paired_p_value(differences: &[f64]) -> Option<f64> {
    let n = differences.len() as f64;
    if n < 2.0 {
        return None;
    }
    let mean = differences.iter().sum::<f64>() / n;
    let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let student = StudentsT::new(0.0, 1.0, n - 1.0).ok().filter(|_| variance > 0.0)?;
    Some(2.0 * student.cdf(-(mean / (variance / n).sqrt()).abs()))
}

/// The mean of so many differences, in its standard errors, beyond which [`paired_p_value`] is below `level`;
/// `None` for fewer than two.
pub fn paired_bound(differences: usize, level: f64) -> Option<f64> {
    let freedom = differences.checked_sub(1).filter(|freedom| *freedom > 0)?;
    Some(StudentsT::new(0.0, 1.0, freedom as f64).ok()?.inverse_cdf(1.0 - 0.5 * level))
}

/// Returns a quantile of the standard normal distribution.
fn quantile(share: f64) -> f64 {
    Normal::standard().inverse_cdf(share)
}

fn count(segments: &[Vec<f64>]) -> usize {
    segments.iter().map(Vec::len).sum()
}

/// The segments less their common mean.
fn centre_segments(
    segments: &[&[f64]],
    signal: &'static str,
    lags: usize,
) -> Result<Vec<Vec<f64>>, StatisticsError> {
    let samples: usize = segments.iter().map(|s| s.len()).sum();
    let least = 4 * lags.max(1);
    if samples < least {
        return Err(StatisticsError::TooShort { samples, lags, least });
    }
    let values = || segments.iter().flat_map(|s| s.iter());
    if values().any(|v| !v.is_finite()) {
        return Err(StatisticsError::NotFinite { signal });
    }
    if values().all(|v| Some(v) == values().next()) {
        return Err(StatisticsError::Constant { signal });
    }
    let mean = values().sum::<f64>() / samples as f64;
    Ok(segments.iter().map(|s| s.iter().map(|v| v - mean).collect()).collect())
}

/// Sum of `a(t) b(t - lag)` within segments.
fn products(a: &[Vec<f64>], b: &[Vec<f64>], lag: isize) -> f64 {
    let shift = lag.unsigned_abs();
    let sum =
        |late: &[f64], early: &[f64]| late.iter().skip(shift).zip(early).map(|(x, y)| x * y).sum::<f64>();
    a.iter().zip(b).map(|(a, b)| if lag >= 0 { sum(a, b) } else { sum(b, a) }).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Normal numbers: twelve uniform ones of a linear congruential generator, summed.
    fn noise(seed: u64, count: usize) -> Vec<f64> {
        let mut state = seed;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..count).map(|_| (0..12).map(|_| uniform()).sum::<f64>() - 6.0).collect()
    }

    /// x(t) = share x(t - 1) + e(t)
    fn coloured_noise(seed: u64, count: usize, share: f64) -> Vec<f64> {
        let mut before = 0.0;
        let next = |e: f64| {
            before = share * before + e;
            before
        };
        noise(seed, count).into_iter().map(next).collect()
    }

    #[test]
    fn white_noise_passes_as_often_as_promised() {
        let tests: Vec<Whiteness> =
            (0..200).map(|seed| whiteness(&[&noise(seed, 600)], LAGS, 0).unwrap()).collect();
        let failed = tests.iter().filter(|w| !w.is_white()).count();
        assert!(failed <= 7, "{failed} of 200 failed a test that 1 % fail");
        // 1 % of 5000 correlations lie outside
        let outside: usize = tests.iter().map(|w| w.outside).sum();
        assert!((20..90).contains(&outside), "{outside}");
        assert!((tests[0].bound - 2.575_829 / 600_f64.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn coloured_noise_is_not_white_and_has_the_correlation_of_its_filter() {
        let test = whiteness(&[&coloured_noise(1, 4000, 0.7)], LAGS, 0).unwrap();
        assert!(!test.is_white() && test.outside > 3 && test.p_value < 1e-6, "{test:?}");
        assert!((test.correlation[0] - 0.7).abs() < 0.05 && (test.correlation[1] - 0.49).abs() < 0.06);
    }

    #[test]
    fn two_segments_are_not_joined() {
        // alternating signs within each; the seam would break the pattern
        let alternating: Vec<f64> = (0..101).map(|i| if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let joined = whiteness(&[&alternating, &alternating], LAGS, 0).unwrap();
        assert!((joined.correlation[0] + 200.0 / 202.0).abs() < 0.01, "{}", joined.correlation[0]);
    }

    #[test]
    fn parameters_cost_freedom() {
        let w = whiteness(&[&noise(3, 500)], LAGS, 4).unwrap();
        assert_eq!(w.freedom, 21);
        assert_eq!(whiteness(&[&noise(3, 500)], 5, 9).unwrap().freedom, 1);
    }

    #[test]
    fn independent_signals_pass_even_where_both_are_coloured() {
        let pass = |share: f64| {
            let seed_passes = |seed: u64| {
                let (u, e) = (
                    coloured_noise(2 * seed + 1000, 800, share),
                    coloured_noise(2 * seed + 1001, 800, share),
                );
                independence(&[&u], &[&e], LAGS).unwrap().is_independent()
            };
            (0..100).filter(|seed| seed_passes(*seed)).count()
        };
        let (white, coloured) = (pass(0.0), pass(0.9));
        assert!(white >= 96 && coloured >= 94, "{white} {coloured}");
    }

    #[test]
    fn what_the_input_still_explains_is_found_after_it_and_feedback_before_it() {
        let (u, e) = (noise(5, 1000), noise(6, 1000));
        let late = |by: usize, signal: &[f64], t: usize| if t >= by { signal[t - by] } else { 0.0 };
        let explained: Vec<f64> = (0..1000).map(|t| e[t] + 0.3 * late(4, &u, t)).collect();
        let test = independence(&[&u], &[&explained], LAGS).unwrap();
        assert!(!test.is_independent() && test.outside >= 1);
        let strongest =
            (0..51).max_by(|a, b| test.correlation[*a].abs().total_cmp(&test.correlation[*b].abs())).unwrap();
        assert_eq!(test.lags[strongest], 4);
        // a controller answers the residual four samples later
        let answered: Vec<f64> = (0..1000).map(|t| u[t] + 0.5 * late(4, &e, t)).collect();
        let test = independence(&[&answered], &[&e], LAGS).unwrap();
        assert!(test.is_independent() && test.feedback >= 1, "{} {}", test.outside, test.feedback);
    }

    #[test]
    fn a_paired_test_has_the_textbooks_value() {
        // t = mean / (sd / sqrt(5)) = 1 / (0.7906 / 2.2361) = 2.8284 at four degrees of freedom
        let p = paired_p_value(&[1.0, 2.0, 0.0, 1.5, 0.5]).unwrap();
        assert!((p - 0.047_4).abs() < 5e-4, "{p}");
        assert!(paired_p_value(&[1.0, 1.1, 0.9, 1.05, 0.95]).unwrap() < 1e-4);
        assert!(paired_p_value(&[1.0, -1.1, 0.9, -1.05, 0.3]).unwrap() > 0.5);
        assert_eq!((paired_p_value(&[1.0]), paired_p_value(&[1.0, 1.0])), (None, None));
    }

    #[test]
    fn a_useless_parameter_is_not_worth_its_place() {
        let (without, with) = (criteria(&[(100.0, 1000)], 2), criteria(&[(99.95, 1000)], 3));
        assert!(with.aic > without.aic && with.bic > without.bic);
        assert!(criteria(&[(90.0, 1000)], 3).bic < without.bic);
        assert!((without.aic - (1000.0 * 0.1_f64.ln() + 4.0)).abs() < 1e-9);
    }

    #[test]
    fn what_cannot_be_tested_is_refused() {
        assert_eq!(
            whiteness(&[&[1.0; 20]], LAGS, 0),
            Err(StatisticsError::TooShort { samples: 20, lags: LAGS, least: 100 })
        );
        assert_eq!(whiteness(&[&[0.1; 200]], LAGS, 0), Err(StatisticsError::Constant { signal: "residual" }));
        let (e, u) = (noise(1, 200), noise(2, 199));
        let unequal = StatisticsError::LengthMismatch { segment: 0, residuals: 200, inputs: 199 };
        assert_eq!(independence(&[&u], &[&e], LAGS), Err(unequal));
        let mut bad = e.clone();
        bad[7] = f64::NAN;
        assert_eq!(
            independence(&[&e], &[&bad], LAGS),
            Err(StatisticsError::NotFinite { signal: "residual" })
        );
    }
}
