//! Propellers that pull more or less than thought.

use super::{Cx, Effect, Hooks, Param, param};
use crate::plant::{Command, Push, State};
use crate::real::Real;

pub struct ThrustScale;

impl Effect<1, 0> for ThrustScale {
    const NAME: &'static str = "thrust_scale";
    const ABOUT: &'static str = "Thrust scaled by a constant";
    const SOURCE: &'static str = "Propeller and motor spread; offset of 5.1.3 is hard to measure";
    const PARAMS: [Param; 1] = [
        param("scale", "1", 1.0, [0.5, 1.5], "thrust over declared thrust"),
    ];
    const HOOKS: Hooks = Hooks::PUSH;

    #[inline(always)]
    fn push<R: Real>(&[scale]: &[R; 1], _: &mut [R; 0], cx: &Cx<R>, _: &State<R>, u: &Command<R>, out: &mut Push<R>) {
        out.acc_mps2[2] += cx.body.thrust_mps2(u, out) * (scale - R::of(1.0));
    }
}
