//! Commands too small to move anything.

use super::{Call, Effect, Hooks, Param, Scope, param};
use crate::plant::Command;
use crate::scalar::Scalar;

pub struct CmdDeadband;

impl Effect<1, 0> for CmdDeadband {
    const NAME: &'static str = "cmd_deadband";
    const ABOUT: &'static str =
        "Roll and pitch commands smaller than this do nothing, larger ones act by what they exceed it";
    const SOURCE: &'static str =
        "Static friction of the trim and quantisation of the radio link; the dead zone of control textbooks";
    const PARAMS: [Param; 1] =
        [param("tilt_deg", "deg", 0.0, [0.0, 10.0]).about("width of the dead band to each side")];
    const HOOKS: Hooks = Hooks::COMMAND;
    const SCOPE: Scope = Scope::Angles;

    #[inline(always)]
    fn command<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], u: &mut Command<R>) {
        let &[tilt_deg] = cx.params;
        let width = tilt_deg * R::from_f64(std::f64::consts::PI / 180.0);
        for angle in [&mut u.roll_rad, &mut u.pitch_rad] {
            *angle -= angle.clamp(-width, width);
        }
    }
}
