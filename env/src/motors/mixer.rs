//! Four motors on the diagonals of the frame: the torques that each gives besides its thrust.

use crate::plant::{Accelerations, VehicleConstants};
use crate::scalar::Scalar;

/// Moments of inertia of roll and pitch, and of yaw (Foerster 2015).
pub(crate) const TILT_INERTIA_KGM2: f64 = 1.657e-5;
pub(crate) const YAW_INERTIA_KGM2: f64 = 2.926e-5;
/// Torque about the vertical per thrust (Foerster 2015).
pub(crate) const YAW_LEVER_M: f64 = 5.96e-3;
/// Motors 1 to 4: +1 where it is in front, +1 where it is on the left. Numbers 1 and 3 turn counter-clockwise
/// and push the frame clockwise.
pub const MOTORS: [[f64; 2]; 4] = [[1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]];

/// From the centre to the line between the motors of a side, per length of an arm.
pub const SIDE_PER_ARM: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// From the centre to the line between the motors of a side.
#[inline(always)]
pub(crate) fn side_m<R: Scalar>(body: &VehicleConstants<R>) -> R {
    body.arm_m * R::from_f64(SIDE_PER_ARM)
}

/// Takes thrust from a motor, and the torques due to it; `lost_mps2` is per mass of the vehicle, `tilt_share` the
/// share of the roll and pitch torque, `yaw_lever` a multiple of [`YAW_LEVER_M`].
#[inline(always)]
pub(crate) fn weaken<R: Scalar>(
    body: &VehicleConstants<R>,
    [front, left]: [R; 2],
    lost_mps2: R,
    [tilt_share, yaw_lever]: [R; 2],
    out: &mut Accelerations<R>,
) {
    let lost_n = lost_mps2 * body.mass_kg;
    let tilt_radps2 = lost_n * (tilt_share * side_m(body)) * R::from_f64(1.0 / TILT_INERTIA_KGM2);
    out.acc_mps2[2] -= lost_mps2;
    out.ang_radps2[0] -= left * tilt_radps2;
    out.ang_radps2[1] += front * tilt_radps2;
    out.ang_radps2[2] -= front * left * lost_n * R::from_f64(YAW_LEVER_M / YAW_INERTIA_KGM2) * yaw_lever;
}

/// All four motors at their limit, over the weight: 0.16 N each on 33.2 g (Foerster 2015).
pub(crate) const THRUST_TO_WEIGHT: f64 = 1.96;

/// Thrust and torques demanded of four motors: thrusts per mass of the vehicle and motor, torques as angular
/// accelerations.
pub(crate) struct Demand<R> {
    level_mps2: R,
    per_tilt: R,
    per_turn: R,
    torque_radps2: [R; 3],
}

impl<R: Scalar> Demand<R> {
    #[inline(always)]
    pub fn new(body: &VehicleConstants<R>, level_mps2: R, torque_radps2: [R; 3]) -> Self {
        Demand {
            level_mps2,
            per_tilt: R::from_f64(0.25 * TILT_INERTIA_KGM2) / (side_m(body) * body.mass_kg),
            per_turn: R::from_f64(0.25 * YAW_INERTIA_KGM2 / YAW_LEVER_M) / body.mass_kg,
            torque_radps2,
        }
    }

    /// Returns the thrust that the mixer demands of a motor.
    #[inline(always)]
    pub fn thrust_mps2(&self, [front, left]: [R; 2]) -> R {
        let [roll, pitch, yaw] = self.torque_radps2;
        self.level_mps2 + self.per_tilt * (left * roll - front * pitch) + self.per_turn * front * left * yaw
    }

    /// The push that takes away what motors between nothing and `most_mps2` fail to give.
    #[inline(always)]
    pub fn push_beyond_limits(&self, body: &VehicleConstants<R>, most_mps2: R) -> Accelerations<R> {
        let mut lost = Accelerations::none();
        // the usual case costs little: each motor is asked for the level, more or less the spread at most
        let [roll, pitch, yaw] = self.torque_radps2;
        let spread_mps2 = self.per_tilt * (roll.abs() + pitch.abs()) + self.per_turn * yaw.abs();
        if R::all(spread_mps2.le(self.level_mps2) & (self.level_mps2 + spread_mps2).le(most_mps2)) {
            return lost;
        }
        for motor in MOTORS {
            let place = motor.map(R::from_f64);
            let asked_mps2 = self.thrust_mps2(place);
            weaken(
                body,
                place,
                asked_mps2 - asked_mps2.clamp(R::zero(), most_mps2),
                [R::from_f64(1.0); 2],
                &mut lost,
            );
        }
        lost
    }
}
