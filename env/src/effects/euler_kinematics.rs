//! Turning mixes roll and pitch.

use super::{Call, Effect, Geometry, Hooks, Param, Scope, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct EulerKinematics;

impl Effect<2, 0> for EulerKinematics {
    const NAME: &'static str = "euler_kinematics";
    const ABOUT: &'static str =
        "A turning, tilted vehicle trades roll for pitch, and a rolled one that pitches turns";
    const SOURCE: &'static str = "Euler angle kinematics (roll' = p + r pitch, pitch' = q - r roll, yaw' = r + q roll + r (pitch^2 - roll^2) / 2), as the torque that has \
                                  the same result in 5.1 and 5.2";
    const PARAMS: [Param; 2] = [
        param("amount", "1", 0.0, [0.0, 1.0]).about("1 for the true kinematics"),
        param("heading_kept", "1", 0.0, [0.0, 1.0])
            .about("1 leaves yaw' = r, as models of roll and pitch alone do")
            .choice(),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const SCOPE: Scope = Scope::IdentifiedLoops;
    const MODEL_FORM: Geometry = Geometry::Part;
    const PHYSICS_HZ: u32 = 150;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 2>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[amount, heading_kept] = cx.params;
        let ([roll, pitch, _], [p, q, r]) = (cx.x.att_rad, cx.x.rate_radps);
        let turn = amount * r;
        // with angle' = rate + d the rate of the angle obeys 5.1 with the push damping d + d'
        out.ang_radps2[0] += turn * (cx.body.tilt_damping_ps[0] * pitch + q);
        out.ang_radps2[1] -= turn * (cx.body.tilt_damping_ps[1] * roll + p);
        let [_, q_dot] = cx.body.tilt_torque_radps2(cx.x, u);
        let d = q * roll + R::from_f64(0.5) * r * (pitch * pitch - roll * roll);
        let d_dot = q_dot * roll + q * p + r * (pitch * q - roll * p);
        out.ang_radps2[2] +=
            amount * (R::from_f64(1.0) - heading_kept) * (cx.body.yaw_damping_ps * d + d_dot);
    }
}
