//! Speed that tilts the vehicle back.

use super::{Call, Effect, Hooks, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct Flap;

impl Effect<1, 0> for Flap {
    const NAME: &'static str = "flap";
    const ABOUT: &'static str = "Torque against the motion in proportion to speed";
    const SOURCE: &'static str = "Blade flapping (Hoffmann, Huang, Waslander, Tomlin 2007)";
    const PARAMS: [Param; 1] = [param("torque_radpms", "rad/(m s)", 0.0, [-20.0, 20.0])
        .about("angular acceleration per speed")
        .at_least(0.8)];
    const HOOKS: Hooks = Hooks::PUSH;
    const FEELS_AIR: bool = true;
    const PHYSICS_HZ: u32 = 300;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], _: &Command<R>, out: &mut Accelerations<R>) {
        let &[torque_radpms] = cx.params;
        let x = cx.x;
        let (sin, cos) = x.att_rad[2].sin_cos();
        let front = cos * x.vel_mps[0] + sin * x.vel_mps[1];
        let left = cos * x.vel_mps[1] - sin * x.vel_mps[0];
        out.ang_radps2[0] += torque_radpms * left;
        out.ang_radps2[1] -= torque_radpms * front;
    }
}
