//! Thrust that answers the PWM more or less steeply.

use super::{Call, Effect, Hooks, Param, Ubiquity, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct ThrustSlope;

impl Effect<1, 0> for ThrustSlope {
    const NAME: &'static str = "thrust_slope";
    const ABOUT: &'static str = "Gain of thrust about hover";
    const SOURCE: &'static str = "Thrust over PWM is not a line through the origin (Foerster 2015): its slope at hover differs from thrust over PWM";
    const PARAMS: [Param; 1] = [param("slope", "1", 1.0, [0.2, 3.0])
        .about("slope at hover over that of a line through the origin")
        .at_least(0.01)];
    const HOOKS: Hooks = Hooks::PUSH;
    const UBIQUITY: Ubiquity = Ubiquity::All;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[slope] = cx.params;
        out.acc_mps2[2] +=
            cx.body.gravity_mps2 * (cx.body.thrust_ratio(u) - R::from_f64(1.0)) * (slope - R::from_f64(1.0));
    }
}
