//! One motor that pulls less.

use super::mixer::{YAW_LEVER_M, weaken};
use super::{Cx, Effect, Hooks, Param, param};
use crate::plant::{Command, Push, State};
use crate::real::Real;

pub struct WeakMotor;

impl Effect<3, 0> for WeakMotor {
    const NAME: &'static str = "weak_motor";
    const ABOUT: &'static str = "One motor (1 front right, 2 back right, 3 back left, 4 front left) loses a share of its thrust";
    const SOURCE: &'static str = "X configuration of thesis 4.1; inertia 1.657e-5 and 2.926e-5 kg m^2, torque per thrust 5.96 mm: Foerster 2015";
    const PARAMS: [Param; 3] = [
        param("motor", "1", 1.0, [1.0, 4.0], "which; front is where +pitch leads").choice(),
        param("loss", "1", 0.0, [0.0, 1.0], "share of its thrust that is lost"),
        param("yaw_m", "m", YAW_LEVER_M, [0.0, 0.03], "torque about the vertical per thrust; a cut propeller loses them in another ratio than a slow one"),
    ];
    const HOOKS: Hooks = Hooks::PUSH;

    #[inline(always)]
    fn push<R: Real>(&[motor, loss, yaw_m]: &[R; 3], _: &mut [R; 0], cx: &Cx<R>, _: &State<R>, u: &Command<R>, out: &mut Push<R>) {
        let lost_mps2 = R::of(0.25) * loss * cx.body.thrust_mps2(u, out);
        let one = R::of(1.0);
        let front = R::select(motor.lt(R::of(1.5)) | motor.gt(R::of(3.5)), one, -one);
        let left = R::select(motor.gt(R::of(2.5)), one, -one);
        weaken(cx.body, [front, left], lost_mps2, yaw_m / R::of(YAW_LEVER_M), out);
    }
}
