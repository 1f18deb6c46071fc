//! An IMU that is not level.

use super::{Call, Effect, Hooks, Param, Reading, Scope, param};
use crate::plant::Command;
use crate::scalar::Scalar;

pub struct ImuTilt;

impl Effect<2, 0> for ImuTilt {
    const NAME: &'static str = "imu_tilt";
    const ABOUT: &'static str =
        "The attitude that the IMU reports, and that the vehicle controls, is off by a constant";
    const SOURCE: &'static str = "Mounting and calibration of the IMU: a level reading still accelerates";
    const PARAMS: [Param; 2] = [
        param("roll_deg", "deg", 0.0, [-10.0, 10.0]).about("reported minus true roll"),
        param("pitch_deg", "deg", 0.0, [-10.0, 10.0]).about("reported minus true pitch"),
    ];
    const HOOKS: Hooks = Hooks::COMMAND_AND_SENSE;
    const SCOPE: Scope = Scope::Angles;

    #[inline(always)]
    fn command<R: Scalar>(cx: Call<R, 2>, _: &mut [R; 0], u: &mut Command<R>) {
        for (i, angle) in [&mut u.roll_rad, &mut u.pitch_rad].into_iter().enumerate() {
            // the loop controls the reported angle, so the true angle is off by the error
            *angle -= cx.body.command_for_tilt_rad(i, in_rad(cx.params[i]));
        }
    }

    #[inline(always)]
    fn sense<R: Scalar>(cx: Call<R, 2>, _: &mut [R; 0], y: &mut Reading<R>) {
        let error_deg = cx.params;
        y.att_rad[0] += in_rad(error_deg[0]);
        y.att_rad[1] += in_rad(error_deg[1]);
    }
}

#[inline(always)]
fn in_rad<R: Scalar>(angle_deg: R) -> R {
    angle_deg * R::from_f64(std::f64::consts::PI / 180.0)
}
