//! A payload.

use super::{Call, Effect, Hooks, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct MassChange;

impl Effect<1, 0> for MassChange {
    const NAME: &'static str = "mass_change";
    const ABOUT: &'static str = "Extra mass that the declared model does not know";
    const SOURCE: &'static str = "Newton: the same thrust and the same damping of climb on a larger mass";
    const PARAMS: [Param; 1] =
        [param("added_kg", "kg", 0.0, [-0.02, 0.05]).about("payload").at_least(0.0006)];
    const HOOKS: Hooks = Hooks::PUSH;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[added_kg] = cx.params;
        let lift = cx.body.thrust_mps2(u, out) - cx.body.heave_ps * cx.x.vel_mps[2];
        out.acc_mps2[2] -= lift * added_kg / (cx.body.mass_kg + added_kg);
    }
}
