//! Four motors on the diagonals of the frame: the torques that each gives besides its thrust.

use super::Body;
use crate::plant::Push;
use crate::real::Real;

/// Moments of inertia of roll and pitch, and of yaw (Foerster 2015).
pub(super) const TILT_INERTIA_KGM2: f64 = 1.657e-5;
pub(super) const YAW_INERTIA_KGM2: f64 = 2.926e-5;
/// Torque about the vertical per thrust (Foerster 2015).
pub(super) const YAW_LEVER_M: f64 = 5.96e-3;
/// Motors 1 to 4: +1 where it is in front, +1 where it is on the left. Numbers 1 and 3 turn counter-clockwise and push the frame clockwise.
pub(super) const MOTORS: [[f64; 2]; 4] = [[1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]];

/// From the centre to the line between the motors of a side.
#[inline(always)]
pub(super) fn side_m<R: Real>(body: &Body<R>) -> R {
    body.arm_m * R::of(std::f64::consts::FRAC_1_SQRT_2)
}

/// Take thrust from a motor, and the torques that come with it; `lost_mps2` is per mass of the vehicle, `yaw_lever` a multiple of [`YAW_LEVER_M`].
#[inline(always)]
pub(super) fn weaken<R: Real>(body: &Body<R>, [front, left]: [R; 2], lost_mps2: R, yaw_lever: R, out: &mut Push<R>) {
    let (lost_n, side_m) = (lost_mps2 * body.mass_kg, side_m(body));
    out.acc_mps2[2] -= lost_mps2;
    out.ang_radps2[0] -= left * lost_n * side_m * R::of(1.0 / TILT_INERTIA_KGM2);
    out.ang_radps2[1] += front * lost_n * side_m * R::of(1.0 / TILT_INERTIA_KGM2);
    out.ang_radps2[2] -= front * left * lost_n * R::of(YAW_LEVER_M / YAW_INERTIA_KGM2) * yaw_lever;
}

/// What motors between nothing and `most_mps2` fail to give of a thrust and of three torques, as the push that takes it away. Thrusts are per mass of the
/// vehicle and motor.
#[inline(always)]
pub(super) fn push_beyond_limits<R: Real>(body: &Body<R>, level_mps2: R, torque_radps2: [R; 3], most_mps2: R) -> Push<R> {
    let per_tilt = R::of(0.25 * TILT_INERTIA_KGM2) / (side_m(body) * body.mass_kg);
    let per_turn = R::of(0.25 * YAW_INERTIA_KGM2 / YAW_LEVER_M) / body.mass_kg;
    let [roll, pitch, yaw] = torque_radps2;
    let mut lost = Push::none();
    for motor in MOTORS {
        let [front, left] = motor.map(R::of);
        let asked_mps2 = level_mps2 + per_tilt * (left * roll - front * pitch) + per_turn * front * left * yaw;
        weaken(body, [front, left], asked_mps2 - asked_mps2.clamp(R::zero(), most_mps2), R::of(1.0), &mut lost);
    }
    lost
}
