//! More inertia than thought.

use super::{Call, Effect, Hooks, Param, Scope, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct InertiaScale;

impl Effect<1, 0> for InertiaScale {
    const NAME: &'static str = "inertia_scale";
    const ABOUT: &'static str =
        "Roll, pitch and yaw accelerate as if the inertia were this many times the declared";
    const SOURCE: &'static str = "Euler: the same torque on a larger inertia; torques as in 5.1 and 5.2";
    const PARAMS: [Param; 1] = [param("scale", "1", 1.0, [0.3, 3.0])
        .about("inertia over declared inertia; published ones of one vehicle differ by a tenth")
        .at_least(0.1)
        // a fit of the second order takes a lag for more inertia
        .holding_delay()];
    const HOOKS: Hooks = Hooks::PUSH;
    const SCOPE: Scope = Scope::IdentifiedLoops;
    const PHYSICS_HZ: u32 = 300;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[scale] = cx.params;
        cx.body.add_torque(R::from_f64(1.0) / scale - R::from_f64(1.0), cx.h_s, cx.x, u, out);
    }
}
