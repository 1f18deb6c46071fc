//! Measures of the agreement between a model's output and a measured signal.

use serde::Serialize;

use crate::{Error, Result};

/// Every figure of this module at once, for one signal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Fit {
    /// NRMSE fit in percent, see [`Fit::new`]; `None` when the measured signal is constant.
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
    /// The fit is the one that MATLAB's `compare` prints: `100 (1 - |y - yhat| / |y - mean y|)` with Euclidean norms.
    /// 100 is perfect, 0 is the error of the mean, and it has no lower limit. A constant signal has none.
    ///
    /// # Errors
    /// Unequal lengths, no samples, or a value that is not finite.
    pub fn new(measured: &[f64], model: &[f64]) -> Result<Self> {
        check(measured, model)?;
        let errors = || measured.iter().zip(model).map(|(y, yhat)| y - yhat);
        let (n, squares) = (measured.len() as f64, errors().map(|e| e * e).sum::<f64>());
        let mean = measured.iter().sum::<f64>() / n;
        let spread: f64 = measured.iter().map(|y| (y - mean).powi(2)).sum();
        // not "spread > 0": the mean of n equal values may differ from them by rounding
        let is_constant = measured.iter().all(|y| *y == measured[0]);
        Ok(Self {
            fit_percent: (!is_constant).then(|| 100.0 * (1.0 - squares.sqrt() / spread.sqrt())),
            rmse: (squares / n).sqrt(),
            mae: errors().map(f64::abs).sum::<f64>() / n,
            max_error: errors().map(f64::abs).fold(0.0, f64::max),
        })
    }
}

fn check(measured: &[f64], model: &[f64]) -> Result<()> {
    if measured.len() != model.len() {
        let lengths = format!("{} samples, the model's {}", measured.len(), model.len());
        return Error::logs(format!("the measured signal has {lengths}: they must be equal"));
    }
    if measured.is_empty() {
        return Error::logs("there are no samples to compare");
    }
    for (signal, values) in [("measured", measured), ("model", model)] {
        if let Some(index) = values.iter().position(|v| !v.is_finite()) {
            return Error::logs(format!("sample {index} of the {signal} signal is not a finite number"));
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
        let fit_percent = |model: &[f64]| Fit::new(&MEASURED, model).unwrap().fit_percent.unwrap();
        assert_eq!(fit_percent(&MEASURED), 100.0);
        assert_eq!(fit_percent(&[2.5; 4]), 0.0);
        // Errors -4 -4 -4 -4 have the norm 8: 100 (1 - 8/sqrt(5)) is far below zero.
        let far: Vec<f64> = MEASURED.iter().map(|y| y + 4.0).collect();
        assert!((fit_percent(&far) + 257.770_876_399_966_3).abs() < 1e-9);
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
        let refused = |measured: &[f64], model: &[f64]| Fit::new(measured, model).unwrap_err().to_string();
        assert!(refused(&MEASURED, &MODEL[..3]).contains("4 samples, the model's 3"));
        assert_eq!(refused(&[], &[]), "there are no samples to compare");
        assert!(refused(&[1.0, 2.0], &[1.0, f64::NAN]).contains("sample 1 of the model signal"));
    }
}
