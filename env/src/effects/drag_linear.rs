//! Air drag in proportion to speed.

use super::{Call, Effect, Hooks, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct DragLinear;

impl Effect<1, 0> for DragLinear {
    const NAME: &'static str = "drag_linear";
    const ABOUT: &'static str = "Horizontal drag in proportion to speed: acc = -rate v";
    const SOURCE: &'static str = "The -k1/m of thesis 4.15; rotor drag (Mahony, Kumar, Corke 2012)";
    const PARAMS: [Param; 1] = [param("rate_ps", "1/s", 0.0, [0.0, 3.0]).about("drag per mass and speed")];
    const HOOKS: Hooks = Hooks::PUSH;
    const FEELS_AIR: bool = true;
    const MODEL_NUMBER: Option<&'static str> = Some("lateral.drag");

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], _: &Command<R>, out: &mut Accelerations<R>) {
        let &[rate_ps] = cx.params;
        for i in 0..2 {
            out.acc_mps2[i] -= rate_ps * cx.x.vel_mps[i];
        }
    }
}
