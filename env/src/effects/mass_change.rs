//! A payload.

use super::{Effect, HookContext, Hooks, Param, param};
use crate::plant::{Accelerations, Command, State};
use crate::scalar::Scalar;

pub struct MassChange;

impl Effect<1, 0> for MassChange {
    const NAME: &'static str = "mass_change";
    const ABOUT: &'static str = "Extra mass that the declared model does not know";
    const SOURCE: &'static str = "Newton: the same thrust and the same damping of climb on a larger mass";
    const PARAMS: [Param; 1] = [param("added_kg", "kg", 0.0, [-0.02, 0.05], "payload").at_least(0.0006)];
    const HOOKS: Hooks = Hooks::PUSH;

    #[inline(always)]
    fn push<R: Scalar>(
        &[added_kg]: &[R; 1],
        _: &mut [R; 0],
        cx: &HookContext<R>,
        x: &State<R>,
        u: &Command<R>,
        out: &mut Accelerations<R>,
    ) {
        let lift = cx.body.thrust_mps2(u, out) - cx.body.heave_ps * x.vel_mps[2];
        out.acc_mps2[2] -= lift * added_kg / (cx.body.mass_kg + added_kg);
    }
}
