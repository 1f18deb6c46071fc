//! Turning mixes roll and pitch.

use super::{Cx, Effect, Hooks, Param, param};
use crate::plant::{Command, Push, State};
use crate::real::Real;

pub struct EulerKinematics;

impl Effect<1, 0> for EulerKinematics {
    const NAME: &'static str = "euler_kinematics";
    const ABOUT: &'static str = "A turning, tilted vehicle trades roll for pitch";
    const SOURCE: &'static str = "Euler angle kinematics to first order (roll' = p + r pitch, pitch' = q - r roll), as the torque that has the same result in 5.1";
    const PARAMS: [Param; 1] = [
        param("amount", "1", 0.0, [0.0, 1.0], "1 for the true kinematics"),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const PHYSICS_HZ: u32 = 300;

    #[inline(always)]
    fn push<R: Real>(&[amount]: &[R; 1], _: &mut [R; 0], cx: &Cx<R>, x: &State<R>, _: &Command<R>, out: &mut Push<R>) {
        let turn = amount * x.rate_radps[2];
        // with angle' = rate + d the rate of the angle obeys 5.1 with the push damping d + d'
        out.ang_radps2[0] += turn * (cx.body.tilt_damping_ps[0] * x.att_rad[1] + x.rate_radps[1]);
        out.ang_radps2[1] -= turn * (cx.body.tilt_damping_ps[1] * x.att_rad[0] + x.rate_radps[0]);
    }
}
