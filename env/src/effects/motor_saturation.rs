//! Motors that give no more.

use super::{Call, Effect, Hooks, Observability, Param, Scope, param};
use crate::motors::mixer::Demand;
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct MotorSaturation;

/// Limit beyond any vehicle, which means none.
const UNLIMITED: f64 = 8.0;

impl Effect<1, 0> for MotorSaturation {
    const NAME: &'static str = "motor_saturation";
    const ABOUT: &'static str = "Thrust, roll, pitch and yaw share four motors, each between nothing and its largest thrust; what a motor cannot give is lost to all four";
    const SOURCE: &'static str = "X mixer of thesis 4.1; torques asked as in 5.1 and 5.2; inertia and torque per thrust as weak_motor. A Crazyflie's ratio is about 1.9 (Foerster 2015)";
    const PARAMS: [Param; 1] = [param("ratio", "1", UNLIMITED, [1.0, UNLIMITED])
        .about("largest thrust of the four motors together over the weight; 8 for no limit")];
    const HOOKS: Hooks = Hooks::PUSH;
    const SCOPE: Scope = Scope::IdentifiedLoops;
    const PHYSICS_HZ: u32 = 300;
    const OBSERVABILITY: Observability = Observability::Located;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[ratio] = cx.params;
        let limited = ratio.lt(R::from_f64(UNLIMITED));
        if !R::any(limited) {
            return;
        }
        let body = cx.body;
        let quarter = R::from_f64(0.25);
        let (level_mps2, most_mps2) =
            (quarter * body.thrust_mps2(u, out), quarter * ratio * body.gravity_mps2);
        let [roll, pitch] = body.tilt_torque_radps2(cx.x, u);
        let demand = Demand::new(body, level_mps2, [roll, pitch, body.yaw_torque_radps2(cx.x, u)]);
        let lost = demand.push_beyond_limits(body, most_mps2);
        out.add(&Accelerations {
            acc_mps2: lost.acc_mps2.map(|v| R::select(limited, v, R::zero())),
            ang_radps2: lost.ang_radps2.map(|v| R::select(limited, v, R::zero())),
        });
    }
}
