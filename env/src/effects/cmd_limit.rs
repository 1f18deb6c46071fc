//! Commands cut off at a limit.

use super::{Call, Effect, Hooks, Param, Scope, param};
use crate::plant::Command;
use crate::scalar::Scalar;

pub struct CmdLimit;

impl Effect<4, 0> for CmdLimit {
    const NAME: &'static str = "cmd_limit";
    const ABOUT: &'static str = "The vehicle obeys commands only up to a limit";
    const SOURCE: &'static str =
        "Saturation in the firmware; table 7.1 has the limits of the thesis's own loops";
    const PARAMS: [Param; 4] = [
        param("tilt_deg", "deg", 90.0, [0.0, 90.0]).about("largest roll or pitch"),
        param("yaw_rate_degps", "deg/s", 2000.0, [0.0, 2000.0]).about("largest yaw rate"),
        param("pwm_min", "1", 0.0, [0.0, 65535.0]).about("smallest thrust PWM"),
        param("pwm_max", "1", 65535.0, [0.0, 65535.0]).about("largest thrust PWM"),
    ];
    const HOOKS: Hooks = Hooks::COMMAND;
    const SCOPE: Scope = Scope::Angles;

    #[inline(always)]
    fn command<R: Scalar>(cx: Call<R, 4>, _: &mut [R; 0], u: &mut Command<R>) {
        let &[tilt_deg, yaw_rate_degps, pwm_min, pwm_max] = cx.params;
        let per_deg = R::from_f64(std::f64::consts::PI / 180.0);
        let (tilt, turn) = (tilt_deg * per_deg, yaw_rate_degps * per_deg);
        u.roll_rad = u.roll_rad.clamp(-tilt, tilt);
        u.pitch_rad = u.pitch_rad.clamp(-tilt, tilt);
        u.yaw_rate_radps = u.yaw_rate_radps.clamp(-turn, turn);
        let pwm = cx.body.height_command.lt(R::from_f64(0.5));
        u.lift = R::select(pwm, u.lift.clamp(pwm_min, pwm_max), u.lift);
    }
}
