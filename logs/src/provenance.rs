//! Facts about the sources of a log's channels.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The instrument that measured the position.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PositionSource {
    /// Single fixes with white noise, late, sometimes missing.
    Camera,
    /// Fixes in every row; their error is smooth, because the system filters them.
    MotionCapture,
    /// The vehicle's own filter: nothing outside measured it.
    Estimate,
    /// A log without position.
    #[default]
    Absent,
}

/// The instrument that measured roll, pitch and yaw.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AttitudeSource {
    /// The vehicle's IMU or the filter around it.
    Imu,
    /// Motion capture: the frame of the markers may be tilted against the vehicle.
    MotionCapture,
    /// The pose of a marker seen by a camera.
    Marker,
    /// No instrument: the tilt derived from the logged acceleration or motion. It has no information of its own.
    #[default]
    Motion,
}

/// The origin of a log's channels. Decisions depend on these facts, not on the format.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Provenance {
    /// Name of the reader, see [`Reader::name`](crate::Reader); for people and reports.
    pub format: &'static str,
    /// Instrument behind the [fixes](crate::FlightLog::fixes).
    pub position: PositionSource,
    /// Instrument behind roll, pitch and yaw.
    pub attitude: AttitudeSource,
    /// Commands and on-board sensors are from another clock and were interpolated to the rows: steps of commands are
    /// ramps, and the gyro does not line up with an attitude from outside.
    pub onboard_interpolated: bool,
}

impl Provenance {
    /// On-board data is on the clock of the rows.
    pub(crate) fn new(format: &'static str, position: PositionSource, attitude: AttitudeSource) -> Self {
        Self { format, position, attitude, onboard_interpolated: false }
    }
}

/// Fixes more frequent than a camera on a small vehicle takes pictures are motion capture's.
const CAMERA_STEP_S: f64 = 0.016;

impl PositionSource {
    /// The instrument that usually measures at such steps.
    pub(crate) fn of_step(usual_s: f64) -> Self {
        if usual_s < CAMERA_STEP_S { Self::MotionCapture } else { Self::Camera }
    }
}

impl fmt::Display for PositionSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Camera => "camera",
            Self::MotionCapture => "motion capture",
            Self::Estimate => "the vehicle's own estimate",
            Self::Absent => "none",
        })
    }
}

impl fmt::Display for AttitudeSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Imu => "the vehicle's IMU",
            Self::MotionCapture => "motion capture",
            Self::Marker => "camera",
            Self::Motion => "derived from the motion",
        })
    }
}
