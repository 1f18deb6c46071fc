//! Commands that cannot jump.

use super::{Call, Effect, Hooks, Param, Scope, param};
use crate::plant::Command;
use crate::scalar::Scalar;

pub struct CmdRateLimit;

/// Rate of a stick from end to end within a control tick, which means no limit.
const UNLIMITED_DEGPS: f64 = 2000.0;

impl Effect<1, 2> for CmdRateLimit {
    const NAME: &'static str = "cmd_rate_limit";
    const ABOUT: &'static str =
        "Roll and pitch commands are obeyed no faster than at a largest rate of change";
    const SOURCE: &'static str = "Slew-rate limit of set-points in the firmware; the obeyed ramp is averaged over the physics step, which is exact";
    const PARAMS: [Param; 1] = [param("tilt_degps", "deg/s", UNLIMITED_DEGPS, [1.0, UNLIMITED_DEGPS])
        .about("largest rate of change of roll and pitch commands; 2000 for no limit")];
    const HOOKS: Hooks = Hooks::COMMAND;
    const SCOPE: Scope = Scope::Angles;

    #[inline(always)]
    fn start<R: Scalar>(_: Call<R, 1>, u: &Command<R>) -> [R; 2] {
        [u.roll_rad, u.pitch_rad]
    }

    #[inline(always)]
    fn command<R: Scalar>(cx: Call<R, 1>, reached: &mut [R; 2], u: &mut Command<R>) {
        let &[tilt_degps] = cx.params;
        let limited = tilt_degps.lt(R::from_f64(UNLIMITED_DEGPS));
        let most = tilt_degps * R::from_f64(cx.h_s * std::f64::consts::PI / 180.0);
        for (angle, reached) in [&mut u.roll_rad, &mut u.pitch_rad].into_iter().zip(reached) {
            let behind = *angle - *reached;
            let moved = behind.clamp(-most, most);
            // the missing angle falls linearly, until it is zero or the step ends
            let mean = *angle - (behind - moved) - moved * moved.abs() / (R::from_f64(2.0) * most);
            *reached = R::select(limited, *reached + moved, *angle);
            *angle = R::select(limited, mean, *angle);
        }
    }
}
