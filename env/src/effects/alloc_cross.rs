//! Axes turned against each other.

use super::{Call, Effect, Hooks, Param, Scope, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct AllocCross;

impl Effect<1, 0> for AllocCross {
    const NAME: &'static str = "alloc_cross";
    const ABOUT: &'static str = "Roll and pitch torques act about axes turned by this angle";
    const SOURCE: &'static str = "A flight controller mounted askew: motor allocation in a frame turned about z; torque as in 5.1, feedback included";
    const PARAMS: [Param; 1] = [param("angle_deg", "deg", 0.0, [-45.0, 45.0]).about("right-handed about z")];
    const HOOKS: Hooks = Hooks::PUSH;
    const SCOPE: Scope = Scope::IdentifiedLoops;
    const PHYSICS_HZ: u32 = 300;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[angle_deg] = cx.params;
        let (sin, cos) = (angle_deg * R::from_f64(std::f64::consts::PI / 180.0)).sin_cos();
        let lost = R::from_f64(1.0) - cos;
        let [roll, pitch] = cx.body.tilt_torque_radps2(cx.x, u);
        out.ang_radps2[0] -= lost * roll + sin * pitch;
        out.ang_radps2[1] += sin * roll - lost * pitch;
    }
}
