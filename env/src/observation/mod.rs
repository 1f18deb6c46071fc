//! The view of an agent and a controller: the measurements of the rig, as one row of numbers.

mod choice;
mod sight;

use crate::action::ACTION;
use crate::effects::Reading;
use crate::scalar::{Scalar, each, wrap};

pub use choice::{
    ALL_FIELDS, CHOICES, EST_POS, EST_PUSH, EST_VEL, EST_YAW, LONGEST_HISTORY, NamedChoice, OBSERVABLE,
    ObservationChoice, find_field,
};
pub(crate) use choice::{YAW_ERROR, is_of_surroundings};
pub(crate) use sight::{NOTHING_NEAR_M, Observable, Surroundings, need_estimate, need_truth};

/// Numbers per observation.
pub const OBSERVATION: usize = 24;

/// One block of an observation row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Field {
    /// Key in lists of the layout, with the unit as its suffix.
    pub name: &'static str,
    /// Index of its first number within the row.
    pub first: usize,
    /// Count of its numbers.
    pub length: usize,
    /// Symbols of the units; "1" for a pure number.
    pub unit: &'static str,
    /// Bounds; a reading outside is cut off, as the sensor's range or the clock's display would.
    pub low: f64,
    /// Upper bound, in the same unit.
    pub high: f64,
    /// Description for users, without a full stop.
    pub about: &'static str,
}

const PI: f64 = std::f64::consts::PI;

impl Field {
    pub(crate) const fn about(self, about: &'static str) -> Field {
        Field { about, ..self }
    }

    /// The place behind its last number.
    pub const fn end(&self) -> usize {
        self.first + self.length
    }

    /// Its numbers within the row.
    pub const fn range(&self) -> std::ops::Range<usize> {
        self.first..self.first + self.length
    }
}

/// Position over the marker.
pub const MARKER_POS: Field = field("marker_pos_m", 0, 3, "m", [-10.0, 10.0])
    .about("position over the marker, from the last camera frame that showed it");
/// Heading over the marker.
pub const MARKER_YAW: Field =
    field("marker_yaw_rad", 3, 1, "rad", [-PI, PI]).about("heading from the same frame");
/// Age of the marker's pose.
pub const MARKER_AGE: Field =
    field("marker_age_s", 4, 1, "s", [0.0, 60.0]).about("time since that frame was captured");
/// Flag of the newest camera frame.
pub const MARKER_VALID: Field =
    field("marker_valid", 5, 1, "1", [0.0, 1.0]).about("1 while the newest frame showed the marker");
/// Attitude by the IMU.
pub const ATTITUDE: Field =
    field("attitude_rad", 6, 3, "rad", [-PI, PI]).about("roll, pitch, yaw by the IMU");
/// Rates by the gyroscope.
pub const GYRO: Field = field("gyro_radps", 9, 3, "rad/s", [-34.9, 34.9])
    .about("rates by the IMU; range of the MPU-9250, 2000 deg/s");
/// Specific force by the accelerometer.
pub const ACC: Field = field("acc_mps2", 12, 3, "m/s^2", [-157.0, 157.0])
    .about("specific force along the body axes; range of the MPU-9250, 16 g");
/// Voltage of the battery.
pub const VBAT: Field = field("vbat_v", 15, 1, "V", [0.0, 5.0]).about("battery voltage");
/// Target position and heading in the world frame.
pub const SETPOINT: Field =
    field("setpoint", 16, 4, "m, rad", [-10.0, 10.0]).about("where to be now: x, y, z, yaw");
/// Action of the tick before.
pub const LAST_ACTION: Field = field("last_action", 20, 4, "1", [-1.0, 1.0]).about("the previous action");

/// The layout of an observation row.
pub const FIELDS: [Field; 10] =
    [MARKER_POS, MARKER_YAW, MARKER_AGE, MARKER_VALID, ATTITUDE, GYRO, ACC, VBAT, SETPOINT, LAST_ACTION];

/// Indices of an observation row, by name: no other code counts them.
pub mod index {
    /// Position over the marker, m.
    pub const MARKER_X: usize = super::MARKER_POS.first;
    /// See [`MARKER_X`].
    pub const MARKER_Y: usize = MARKER_X + 1;
    /// See [`MARKER_X`].
    pub const MARKER_Z: usize = MARKER_X + 2;
    /// Heading over the marker, rad.
    pub const MARKER_YAW: usize = super::MARKER_YAW.first;
    /// Age of the marker's pose, s.
    pub const MARKER_AGE: usize = super::MARKER_AGE.first;
    /// 1 while the newest frame showed the marker.
    pub const MARKER_VALID: usize = super::MARKER_VALID.first;
    /// Attitude by the IMU, rad.
    pub const ROLL: usize = super::ATTITUDE.first;
    /// See [`ROLL`].
    pub const PITCH: usize = ROLL + 1;
    /// See [`ROLL`].
    pub const YAW: usize = ROLL + 2;
    /// Rates by the gyroscope, rad/s.
    pub const ROLL_RATE: usize = super::GYRO.first;
    /// See [`ROLL_RATE`].
    pub const PITCH_RATE: usize = ROLL_RATE + 1;
    /// See [`ROLL_RATE`].
    pub const YAW_RATE: usize = ROLL_RATE + 2;
    /// Specific force along the body axes, m/s^2.
    pub const ACC_X: usize = super::ACC.first;
    /// See [`ACC_X`].
    pub const ACC_Y: usize = ACC_X + 1;
    /// See [`ACC_X`].
    pub const ACC_Z: usize = ACC_X + 2;
    /// Set-point, m.
    pub const SETPOINT_X: usize = super::SETPOINT.first;
    /// See [`SETPOINT_X`].
    pub const SETPOINT_Y: usize = SETPOINT_X + 1;
    /// See [`SETPOINT_X`].
    pub const SETPOINT_Z: usize = SETPOINT_X + 2;
    /// Heading to have, rad.
    pub const SETPOINT_YAW: usize = SETPOINT_X + 3;
    /// The previous action: roll, pitch, yaw rate, lift.
    pub const LAST_ACTION: usize = super::LAST_ACTION.first;
}

/// A block of numbers; its description follows.
pub(crate) const fn field(
    name: &'static str,
    first: usize,
    length: usize,
    unit: &'static str,
    range: [f64; 2],
) -> Field {
    Field { name, first, length, unit, low: range[0], high: range[1], about: "" }
}

/// Set-point: position within the room and yaw within [-pi, pi], which the tasks guarantee.
#[derive(Debug, Clone, Copy)]
pub struct Setpoint<R> {
    /// Position in the world frame, with the marker at the origin.
    pub pos_m: [R; 3],
    /// Heading, right-handed about the upward axis.
    pub yaw_rad: R,
}

impl<R: Scalar> Setpoint<R> {
    /// The origin.
    pub fn origin() -> Self {
        Setpoint { pos_m: [R::zero(); 3], yaw_rad: R::zero() }
    }
}

#[inline(always)]
fn cut<R: Scalar>(v: R, limit: f64) -> R {
    v.clamp(R::from_f64(-limit), R::from_f64(limit))
}

/// Wraps an angle and cuts it: as `f32` pi exceeds pi a little, and a wrapped angle may exceed even that by a
/// rounding.
#[inline(always)]
fn angle<R: Scalar>(a: R) -> R {
    cut(wrap(a), PI as f32 as f64)
}

/// The observation row of a reading.
#[inline(always)]
pub fn observe<R: Scalar>(
    y: &Reading<R>,
    now_s: R,
    setpoint: &Setpoint<R>,
    action: &[R; ACTION],
) -> [R; OBSERVATION] {
    let m = &y.marker;
    let [px, py, pz] = each(
        m.pos_m,
        #[inline(always)]
        |p| cut(p, 10.0),
    );
    let age = (now_s - m.t_s).min(R::from_f64(60.0));
    let [ar, ap, ay] =
        [cut(y.att_rad[0], PI as f32 as f64), cut(y.att_rad[1], PI as f32 as f64), angle(y.att_rad[2])];
    let [gx, gy, gz] = each(
        y.gyro_radps,
        #[inline(always)]
        |g| cut(g, 34.9),
    );
    let [ax, ay_, az] = each(
        y.acc_mps2,
        #[inline(always)]
        |a| cut(a, 157.0),
    );
    let vbat = y.vbat_v.clamp(R::zero(), R::from_f64(5.0));
    let [sx, sy, sz] = setpoint.pos_m;
    let [a0, a1, a2, a3] = *action;
    let m_yaw = angle(m.yaw_rad);
    let s_yaw = setpoint.yaw_rad;
    [
        px, py, pz, m_yaw, age, m.valid, ar, ap, ay, gx, gy, gz, ax, ay_, az, vbat, sx, sy, sz, s_yaw, a0,
        a1, a2, a3,
    ]
}
