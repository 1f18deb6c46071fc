//! Results of every identification, of a transfer function or of the whole vehicle: numbers with their
//! errors, predictions beside measurements.

use nalgebra::{DMatrix, SymmetricEigen};
use serde::Serialize;

use crate::fit::solve::Solution;
use crate::metrics::Fit;
use crate::{Error, Result};
use crazyflie_statistics::{
    Independence, LAGS, StatisticsError, Whiteness, independence, quantile, whiteness,
};

/// With fewer flights, clusters are too few for a variance, and windows take their place.
const LEAST_FLIGHTS: usize = 8;
/// Smallest eigenvalue of an information matrix with unit diagonal that is not rounding.
const LEAST_INFORMATION: f64 = 1e-10;

/// A number found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParameterEstimate {
    /// Path in the model, parameter of an effect, or coefficient of a transfer function.
    pub name: String,
    /// Unit of the value and of its standard error.
    pub unit: String,
    /// Fitted value.
    pub value: f64,
    /// Standard error of the value, see [`Clusters`].
    pub standard_error: f64,
    /// The fit would have gone on, but the number must not.
    pub at_bound: bool,
}

/// The groups that standard errors take for independent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clusters {
    /// Whole flights, this many.
    Flights(usize),
    /// Windows of the fit, this many, for lack of flights.
    Windows(usize),
    /// One window: the errors are those of white noise.
    None,
}

impl std::fmt::Display for Clusters {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Flights(n) => write!(f, "clustered by {n} flights"),
            Self::Windows(n) => write!(f, "clustered by {n} windows"),
            Self::None => write!(f, "those of white noise: one window cannot be clustered"),
        }
    }
}

/// One signal of one log, measured and predicted.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Name of the log.
    pub log: String,
    /// Measured quantity, such as `roll` or `vx`.
    pub signal: &'static str,
    /// Unit of [`Comparison::measured`].
    pub unit: &'static str,
    /// Times of the samples, on the clock of the log.
    pub t_s: Vec<f64>,
    /// Measured values, SI units and radians.
    pub measured: Vec<f64>,
    /// From free initial states, window by window.
    pub predicted: Vec<f64>,
    /// In force at the same times.
    pub input: Vec<f64>,
    /// Fit of the windows.
    pub fit: Fit,
    /// Fit of one run over the whole flight, with a fitted initial state.
    pub whole: Option<Fit>,
}

impl Comparison {
    /// Computes measured less predicted value for each sample.
    pub fn residuals(&self) -> Vec<f64> {
        self.measured.iter().zip(&self.predicted).map(|(y, p)| y - p).collect()
    }
}

/// Tests of the residuals of some logs together.
#[derive(Debug, Clone, PartialEq)]
pub struct ResidualTests {
    /// Autocorrelation of the residuals, or why there is none.
    pub whiteness: Result<Whiteness, StatisticsError>,
    /// Correlation of the residuals with the input, or why there is none.
    pub independence: Result<Independence, StatisticsError>,
}

impl ResidualTests {
    /// Tests comparisons of one signal, after fitting so many parameters to it (none, to a held-out flight).
    pub fn new(all: &[&Comparison], parameters: usize) -> Self {
        let residuals: Vec<Vec<f64>> = all.iter().map(|c| c.residuals()).collect();
        let residuals: Vec<&[f64]> = residuals.iter().map(Vec::as_slice).collect();
        let input: Vec<&[f64]> = all.iter().map(|c| c.input.as_slice()).collect();
        ResidualTests {
            whiteness: whiteness(&residuals, LAGS, parameters),
            independence: independence(&input, &residuals, LAGS),
        }
    }
}

/// The covariance of the shared numbers, and by what it is clustered.
///
/// # Errors
/// [`Error::Logs`] names a number, or a combination, that the data does not determine.
pub(crate) fn covariance(
    solution: &Solution,
    flight_of: &[usize],
    names: &[String],
    bounds: &[[f64; 2]],
) -> Result<(DMatrix<f64>, Clusters)> {
    let h = solution.information();
    let free: Vec<usize> = (0..names.len()).filter(|i| !at_bound(solution.shared[*i], bounds[*i])).collect();
    if let Some(i) = free.iter().find(|i| h[(**i, **i)].is_nan() || h[(**i, **i)] <= 0.0) {
        return Err(Error::singular(&names[*i], "the prediction does not depend on it"));
    }
    let scaled = DMatrix::from_fn(free.len(), free.len(), |i, j| {
        let (a, b) = (free[i], free[j]);
        h[(a, b)] / (h[(a, a)] * h[(b, b)]).sqrt()
    });
    let eigen = SymmetricEigen::new(scaled);
    if let Some(least) = (0..free.len()).find(|i| eigen.eigenvalues[*i] < LEAST_INFORMATION) {
        let direction = eigen.eigenvectors.column(least);
        let largest = direction.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
        let strong = free.iter().zip(direction.iter()).filter(|(_, v)| v.abs() > 0.3 * largest);
        let part: Vec<&str> = strong.map(|(i, _)| names[*i].as_str()).collect();
        let together = part.len() > 1;
        let reason =
            if together { "only a combination of them shows" } else { "the prediction hardly depends on it" };
        return Err(Error::singular(&part.join(", "), reason));
    }
    let mut flights = flight_of.to_vec();
    flights.dedup();
    let (cluster_of, clusters) = match (flights.len(), flight_of.len()) {
        (n, _) if n >= LEAST_FLIGHTS => (flight_of.to_vec(), Clusters::Flights(n)),
        (_, 1) => (vec![0], Clusters::None),
        (_, n) => ((0..n).collect(), Clusters::Windows(n)),
    };
    let covariance = solution
        .covariance(&cluster_of)
        .ok_or_else(|| Error::singular(&names.join(", "), "their information cannot be inverted"))?;
    Ok((covariance, clusters))
}

pub(crate) fn at_bound(value: f64, [low, high]: [f64; 2]) -> bool {
    value <= low || value >= high
}

/// The standard deviation of normal numbers about zero, by the median of their sizes: outliers hardly count.
pub(crate) fn robust_sd(values: impl Iterator<Item = f64>) -> f64 {
    // the median of |normal| is 0.6745 standard deviations
    quantile(&values.map(f64::abs).collect::<Vec<_>>(), 0.5).unwrap_or(0.0) / 0.6745
}
