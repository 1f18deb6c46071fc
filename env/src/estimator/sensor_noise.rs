//! The Kalman filter's assumptions about camera and IMU.

use serde::{Deserialize, Serialize};

/// The noise that the filter assumes of its sensors: standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorNoise {
    /// Horizontal position of a fix from 70 cm.
    pub xy_m: f64,
    /// Height of a fix from 70 cm.
    pub z_m: f64,
    /// Heading of a fix from 70 cm.
    pub yaw_deg: f64,
    /// White noise of the accelerations: error of the velocity after 1 s, m/s.
    pub white_mps: f64,
    /// Drift of the accelerations' bias after 1 s, m/s^2.
    pub bias_mps2: f64,
    /// Drift of the heading after 1 s.
    pub yaw_drift_deg: f64,
    /// A fix that is so many standard deviations off, over its three axes together, is an outlier.
    pub gate: f64,
}

impl Default for SensorNoise {
    fn default() -> Self {
        SensorNoise {
            xy_m: 0.005,
            z_m: 0.01,
            yaw_deg: 1.0,
            white_mps: 0.03,
            bias_mps2: 0.1,
            yaw_drift_deg: 1.0,
            gate: 4.5,
        }
    }
}

/// Meaning of each number of a [`SensorNoise`], for the registry.
pub const BELIEF: &str = "what the filter believes, as standard deviations: of a fix from 70 cm xy_m, z_m, yaw_deg; of the IMU over a second white_mps, \
     bias_mps2, yaw_drift_deg; beyond gate of them a fix is an outlier";

/// A [`SensorNoise`] as variances.
#[derive(Debug, Clone, Copy)]
pub(super) struct NoiseVariance {
    pub fix: [f64; 2],
    pub yaw: f64,
    pub white: f64,
    pub bias: f64,
    pub drift: f64,
    pub gate: f64,
}

impl NoiseVariance {
    pub(super) fn from_belief(belief: &SensorNoise) -> Self {
        let square = |v: f64| v * v;
        NoiseVariance {
            fix: [square(belief.xy_m), square(belief.z_m)],
            yaw: square(belief.yaw_deg.to_radians()),
            white: square(belief.white_mps),
            bias: square(belief.bias_mps2),
            drift: square(belief.yaw_drift_deg.to_radians()),
            gate: square(belief.gate),
        }
    }
}
