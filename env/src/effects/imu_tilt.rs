//! An IMU that is not level.

use super::{Effect, HookContext, Hooks, Param, param};
use crate::plant::{Accelerations, Command, State};
use crate::scalar::Scalar;

pub struct ImuTilt;

impl Effect<2, 0> for ImuTilt {
    const NAME: &'static str = "imu_tilt";
    const ABOUT: &'static str =
        "The attitude that the IMU reports, and that the vehicle controls, is off by a constant";
    const SOURCE: &'static str = "Mounting and calibration of the IMU: a level reading still accelerates";
    const PARAMS: [Param; 2] = [
        param("roll_deg", "deg", 0.0, [-10.0, 10.0], "reported minus true roll"),
        param("pitch_deg", "deg", 0.0, [-10.0, 10.0], "reported minus true pitch"),
    ];
    const HOOKS: Hooks = Hooks::PUSH;

    #[inline(always)]
    fn push<R: Scalar>(
        &[roll_deg, pitch_deg]: &[R; 2],
        _: &mut [R; 0],
        cx: &HookContext<R>,
        x: &State<R>,
        _: &Command<R>,
        out: &mut Accelerations<R>,
    ) {
        // the state holds the reported angles: the thrust leans by the error less
        let strength = cx.body.gravity_mps2 * R::from_f64(std::f64::consts::PI / 180.0);
        let (front, right) = (-strength * pitch_deg, -strength * roll_deg);
        let (sin, cos) = x.att_rad[2].sin_cos();
        out.acc_mps2[0] += cos * front + sin * right;
        out.acc_mps2[1] += sin * front - cos * right;
    }
}
