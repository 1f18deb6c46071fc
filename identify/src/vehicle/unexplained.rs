//! Angles that an identified model does not follow.

use serde::Serialize;

use super::ModelEstimate;
use crate::estimate::Comparison;

/// A model that leaves more than this share of an angle's variance explains less than it leaves. Stiff loops
/// fitted from the thesis's numbers left 0.56 to 1.3, the worst angle of NanoBench 0.26.
const MOST_LEFT: f64 = 0.5;
/// An angle whose command has less than this share of the variance of both commands moves by disturbances: on
/// steps along y the pitch command has 0.002 to 0.06, and its loop leaves most of the pitch.
const LEAST_COMMANDED: f64 = 0.1;

/// An angle that moves by less, 1.5 degrees, does little harm where it is not followed: hops straight ahead roll
/// by 0.6 to 1.0 degrees, stiff loops that were missed moved by 5.
const LEAST_MOVED_RAD: f64 = 0.026;

/// An angle that was commanded, and that the identified model does not follow.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UnexplainedAngle {
    /// Name of the signal: roll or pitch.
    pub angle: &'static str,
    /// Fit over all windows: 100 is perfect, 0 no better than the mean.
    pub fit_percent: f64,
}

/// Sums of squares of one angle over all flights.
#[derive(Default)]
struct AngleVariance {
    left: f64,
    measured: f64,
    commanded: f64,
    samples: usize,
}

impl ModelEstimate {
    /// Roll and pitch, where numbers of theirs were to be fitted, that the model does not follow.
    #[must_use]
    pub fn unexplained(&self) -> Vec<UnexplainedAngle> {
        let angles = ["roll", "pitch"].map(|angle| (angle, self.variance(angle)));
        let both: f64 = angles.iter().map(|(_, variance)| variance.commanded).sum();
        let is_fitted = |angle: &str| {
            let of_angle = |path: &String| path.split('.').next() == Some(angle);
            self.plan.free.as_ref().is_none_or(|free| free.iter().any(of_angle))
        };
        let unexplained = |(angle, variance): (&'static str, AngleVariance)| {
            let moved_rad = (variance.measured / variance.samples.max(1) as f64).sqrt();
            let moves = moved_rad > LEAST_MOVED_RAD && variance.commanded > LEAST_COMMANDED * both;
            let judged = moves && is_fitted(angle);
            let fit_percent = 100.0 * (1.0 - (variance.left / variance.measured).sqrt());
            (judged && variance.left > MOST_LEFT * variance.measured)
                .then_some(UnexplainedAngle { angle, fit_percent })
        };
        angles.into_iter().filter_map(unexplained).collect()
    }

    fn variance(&self, angle: &str) -> AngleVariance {
        let squares = |values: &[f64]| {
            let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
            values.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
        };
        let add = |sum: AngleVariance, c: &Comparison| AngleVariance {
            left: sum.left + c.residuals().iter().map(|e| e * e).sum::<f64>(),
            measured: sum.measured + squares(&c.measured),
            commanded: sum.commanded + squares(&c.input),
            samples: sum.samples + c.measured.len(),
        };
        self.fit.comparisons.iter().filter(|c| c.signal == angle).fold(AngleVariance::default(), add)
    }
}
