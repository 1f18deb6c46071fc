//! A heading that creeps.

use super::{Cx, Effect, Hooks, Param, param};
use crate::plant::{Command, State};
use crate::real::Real;

pub struct YawDrift;

impl Effect<1, 0> for YawDrift {
    const NAME: &'static str = "yaw_drift";
    const ABOUT: &'static str = "The vehicle turns slowly although no turn is commanded";
    const SOURCE: &'static str = "Gyro bias in the yaw-rate loop";
    const PARAMS: [Param; 1] = [
        param("rate_degps", "deg/s", 0.0, [-20.0, 20.0], "right-handed"),
    ];
    const HOOKS: Hooks = Hooks::COMMAND;

    #[inline(always)]
    fn command<R: Real>(&[rate_degps]: &[R; 1], _: &mut [R; 0], cx: &Cx<R>, _: &State<R>, u: &mut Command<R>) {
        u.yaw_rate_radps += cx.body.yaw_sign * rate_degps * R::of(std::f64::consts::PI / 180.0);
    }
}
