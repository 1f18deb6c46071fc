//! A heading that creeps.

use super::{Call, Effect, Hooks, Param, Reading, param};
use crate::scalar::Scalar;

pub struct YawDrift;

impl Effect<1, 0> for YawDrift {
    const NAME: &'static str = "yaw_drift";
    const ABOUT: &'static str = "The heading that the IMU reports creeps away from the true one";
    const SOURCE: &'static str = "Gyro bias, integrated; the thesis's vehicle has no compass";
    const PARAMS: [Param; 1] = [param("rate_degps", "deg/s", 0.0, [-20.0, 20.0])
        .about("reported minus true, right-handed, growing from zero at the start")];
    const HOOKS: Hooks = Hooks::SENSE;

    #[inline(always)]
    fn sense<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], y: &mut Reading<R>) {
        let &[rate_degps] = cx.params;
        y.att_rad[2] += rate_degps * R::from_f64(std::f64::consts::PI / 180.0) * cx.t_s;
    }
}
