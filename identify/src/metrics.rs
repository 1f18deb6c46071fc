//! Measures of the agreement between a model's output and a measured signal.

use serde::Serialize;
use thiserror::Error;

/// Why two signals could not be compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[allow(missing_docs, reason = "each variant's message says what went wrong")]
pub enum MetricError {
    #[error("the measured signal has {measured} samples, the model's {model}: they must be equal")]
    LengthMismatch { measured: usize, model: usize },
    #[error("there are no samples to compare")]
    Empty,
    #[error("sample {index} of the {signal} signal is not a finite number")]
    NotFinite { signal: &'static str, index: usize },
}

/// Every figure of this module at once, for one signal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Fit {
    /// NRMSE fit in percent, see [`fit_percent`]; `None` when the measured signal is constant.
    pub fit_percent: Option<f64>,
    /// Root mean square error, in the signal's unit.
    pub rmse: f64,
    /// Mean absolute error, in the signal's unit.
    pub mae: f64,
    /// Largest absolute error, in the signal's unit.
    pub max_error: f64,
}

impl Fit {
    /// Compares `model` with `measured`, sample by sample.
    ///
    /// # Errors
    /// Unequal lengths, no samples, or a value that is not finite.
    pub fn new(measured: &[f64], model: &[f64]) -> Result<Self, MetricError> {
        Ok(Self {
            fit_percent: fit_percent(measured, model)?,
            rmse: rmse(measured, model)?,
            mae: mae(measured, model)?,
            max_error: max_error(measured, model)?,
        })
    }
}

/// The fit that MATLAB's `compare` prints: `100 (1 - |y - yhat| / |y - mean y|)` with Euclidean norms.
///
/// 100 is perfect, 0 is no better than the mean of `measured`, and there is no lower bound. `None` when
/// `measured` is constant: the denominator is zero and the fit undefined.
///
/// # Errors
/// Unequal lengths, no samples, or a value that is not finite.
pub fn fit_percent(measured: &[f64], model: &[f64]) -> Result<Option<f64>, MetricError> {
    check(measured, model)?;
    // Not "denominator == 0": the mean of n equal values may differ from them by rounding.
    if measured.iter().all(|y| *y == measured[0]) {
        return Ok(None);
    }
    let mean = measured.iter().sum::<f64>() / measured.len() as f64;
    let spread: f64 = measured.iter().map(|y| (y - mean).powi(2)).sum();
    let error: f64 = errors(measured, model).map(|e| e * e).sum();
    Ok(Some(100.0 * (1.0 - error.sqrt() / spread.sqrt())))
}

/// Root mean square error, in the signals' unit.
///
/// # Errors
/// Unequal lengths, no samples, or a value that is not finite.
pub fn rmse(measured: &[f64], model: &[f64]) -> Result<f64, MetricError> {
    check(measured, model)?;
    let sum: f64 = errors(measured, model).map(|e| e * e).sum();
    Ok((sum / measured.len() as f64).sqrt())
}

/// Mean absolute error, in the signals' unit.
///
/// # Errors
/// Unequal lengths, no samples, or a value that is not finite.
pub fn mae(measured: &[f64], model: &[f64]) -> Result<f64, MetricError> {
    check(measured, model)?;
    let sum: f64 = errors(measured, model).map(f64::abs).sum();
    Ok(sum / measured.len() as f64)
}

/// Largest absolute error, in the signals' unit.
///
/// # Errors
/// Unequal lengths, no samples, or a value that is not finite.
pub fn max_error(measured: &[f64], model: &[f64]) -> Result<f64, MetricError> {
    check(measured, model)?;
    Ok(errors(measured, model).map(f64::abs).fold(0.0, f64::max))
}

fn errors<'a>(measured: &'a [f64], model: &'a [f64]) -> impl Iterator<Item = f64> + 'a {
    measured.iter().zip(model).map(|(y, yhat)| y - yhat)
}

fn check(measured: &[f64], model: &[f64]) -> Result<(), MetricError> {
    if measured.len() != model.len() {
        return Err(MetricError::LengthMismatch { measured: measured.len(), model: model.len() });
    }
    if measured.is_empty() {
        return Err(MetricError::Empty);
    }
    for (signal, values) in [("measured", measured), ("model", model)] {
        if let Some(index) = values.iter().position(|v| !v.is_finite()) {
            return Err(MetricError::NotFinite { signal, index });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    // y = 1 2 3 4 (mean 2.5, spread 2.25+0.25+0.25+2.25 = 5); errors 0 0 0 -2, squares sum to 4.
    const MEASURED: [f64; 4] = [1.0, 2.0, 3.0, 4.0];
    const MODEL: [f64; 4] = [1.0, 2.0, 3.0, 6.0];

    #[test]
    fn figures_match_hand_computation() {
        let fit = Fit::new(&MEASURED, &MODEL).unwrap();
        // 100 (1 - 2/sqrt(5)) = 10.5572809...
        assert!((fit.fit_percent.unwrap() - 10.557_280_900_008_412).abs() < 1e-12);
        assert_eq!(fit.rmse, 1.0);
        assert_eq!(fit.mae, 0.5);
        assert_eq!(fit.max_error, 2.0);
    }

    #[test]
    fn perfect_mean_and_worse_than_mean() {
        assert_eq!(fit_percent(&MEASURED, &MEASURED), Ok(Some(100.0)));
        assert_eq!(fit_percent(&MEASURED, &[2.5; 4]), Ok(Some(0.0)));
        // Errors -4 -4 -4 -4 have the norm 8: 100 (1 - 8/sqrt(5)) is far below zero.
        let far: Vec<f64> = MEASURED.iter().map(|y| y + 4.0).collect();
        let fit = fit_percent(&MEASURED, &far).unwrap().unwrap();
        assert!((fit + 257.770_876_399_966_3).abs() < 1e-9);
    }

    #[test]
    fn a_constant_measured_signal_has_no_fit_but_has_errors() {
        // 0.1 summed three times and divided is not exactly 0.1.
        let fit = Fit::new(&[0.1; 3], &[0.1, 0.1, 0.4]).unwrap();
        assert_eq!(fit.fit_percent, None);
        assert!((fit.mae - 0.1).abs() < 1e-12);
        assert!((fit.max_error - 0.3).abs() < 1e-12);
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let unequal = MetricError::LengthMismatch { measured: 4, model: 3 };
        assert_eq!(Fit::new(&MEASURED, &MODEL[..3]), Err(unequal));
        assert_eq!(rmse(&[], &[]), Err(MetricError::Empty));
        let bad = MetricError::NotFinite { signal: "model", index: 1 };
        assert_eq!(mae(&[1.0, 2.0], &[1.0, f64::NAN]), Err(bad));
    }
}
