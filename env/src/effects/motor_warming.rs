//! Motors that warm up.

use super::{Call, Effect, Hooks, Observability, Param, Ubiquity, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct MotorWarming;

impl Effect<2, 0> for MotorWarming {
    const NAME: &'static str = "motor_warming";
    const ABOUT: &'static str = "Warm motors lift less: thrust times 1 - share (1 - exp(-t / time))";
    const SOURCE: &'static str = "Copper resists 0.39 % more per kelvin, so the same voltage turns the propellers slower; size and time constant measured on NanoBench flights";
    const PARAMS: [Param; 2] = [
        param("share", "1", 0.0, [-0.1, 0.3]).about("of the thrust of cold motors, lost when they are warm"),
        // flights of half a minute tell little of it, and what comes after a take-off passes for a short one
        param("time_s", "s", 15.0, [2.0, 120.0]).about("time constant, since the flight began").constant(),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    // motors are cold or warm at the start of a session
    const OBSERVABILITY: Observability = Observability::Session;
    const UBIQUITY: Ubiquity = Ubiquity::AllSlowly;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 2>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[share, time_s] = cx.params;
        let middle_s = cx.t_s + R::from_f64(0.5 * cx.h_s);
        let cold = (-middle_s / time_s).exp();
        out.acc_mps2[2] -= share * cx.body.thrust_mps2(u, out) * (R::from_f64(1.0) - cold);
    }
}
