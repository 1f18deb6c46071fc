//! Thrust lost to tilt.

use super::{Cx, Effect, Hooks, Param, param};
use crate::plant::{Command, Push, State};
use crate::real::Real;

pub struct TiltLoss;

impl Effect<1, 0> for TiltLoss {
    const NAME: &'static str = "tilt_loss";
    const ABOUT: &'static str = "A tilted vehicle lifts less: thrust times cos(roll) cos(pitch)";
    const SOURCE: &'static str = "Thesis 4.5";
    const PARAMS: [Param; 1] = [
        param("amount", "1", 0.0, [0.0, 1.0], "1 for the exact cosine"),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const GEOMETRY: bool = true;

    #[inline(always)]
    fn push<R: Real>(&[amount]: &[R; 1], _: &mut [R; 0], cx: &Cx<R>, x: &State<R>, u: &Command<R>, out: &mut Push<R>) {
        let upright = x.att_rad[0].sin_cos().1 * x.att_rad[1].sin_cos().1;
        out.acc_mps2[2] += amount * cx.body.thrust_mps2(u) * (upright - R::of(1.0));
    }
}
