//! Thrust that changes in flight.

use super::time::step_share;
use super::{Call, Effect, Hooks, Observability, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct ThrustStep;

impl Effect<2, 0> for ThrustStep {
    const NAME: &'static str = "thrust_step";
    const ABOUT: &'static str = "From a time on the thrust is scaled";
    const SOURCE: &'static str = "A propeller that chips or a motor that overheats in flight; the step is a ramp of 0.2 s centred on its time";
    const PARAMS: [Param; 2] = [
        param("scale", "1", 1.0, [0.5, 1.5]).about("thrust after over thrust before"),
        param("t_s", "s", 1.0, [0.0, 600.0]).about("since the flight began"),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const OBSERVABILITY: Observability = Observability::Located;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 2>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[scale, t_s] = cx.params;
        out.acc_mps2[2] += cx.body.thrust_mps2(u, out) * (scale - R::from_f64(1.0)) * step_share(t_s, &cx);
    }
}
