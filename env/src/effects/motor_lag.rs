//! Motors that take time.

use super::{Cx, Effect, Hooks, Param, param};
use crate::plant::{Command, State};
use crate::real::Real;

pub struct MotorLag;

impl Effect<1, 1> for MotorLag {
    const NAME: &'static str = "motor_lag";
    const ABOUT: &'static str = "First-order lag between thrust command and thrust; what the motors do to the angles is part of the identified attitude dynamics";
    const SOURCE: &'static str = "First-order motor model (Foerster, System Identification of the Crazyflie 2.0, ETH 2015); exact mean over the physics step";
    const PARAMS: [Param; 1] = [
        param("lag_s", "s", 0.0, [0.0, 0.3], "time constant"),
    ];
    const HOOKS: Hooks = Hooks::COMMAND;

    #[inline(always)]
    fn start<R: Real>(_: &[R; 1], _: &Cx<R>, _: &State<R>, u: &Command<R>) -> [R; 1] {
        [u.lift]
    }

    #[inline(always)]
    fn command<R: Real>(&[lag_s]: &[R; 1], [motor]: &mut [R; 1], cx: &Cx<R>, _: &State<R>, u: &mut Command<R>) {
        // no lag at all would divide by zero; a microsecond leaves nothing of the past
        let left = (R::of(-cx.h_s) / lag_s.max(R::of(1e-6))).exp();
        let mean = lag_s * R::of(1.0 / cx.h_s) * (R::of(1.0) - left);
        let behind = *motor - u.lift;
        *motor = u.lift + behind * left;
        u.lift += behind * mean;
    }
}
