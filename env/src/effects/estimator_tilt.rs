//! An on-board estimator that takes drag for tilt.

use super::{Cx, Effect, Hooks, Param, Reading, param};
use crate::plant::{Command, State};
use crate::real::Real;

pub struct EstimatorTilt;

impl Effect<1, 0> for EstimatorTilt {
    const NAME: &'static str = "estimator_tilt";
    const ABOUT: &'static str = "The tilt that the vehicle estimates is off in proportion to its velocity: it leans towards where it flies by kappa v more than it thinks; it obeys commands and reports its tilt by the estimate";
    const SOURCE: &'static str = "An accelerometer feels drag as it would a tilt (Martin and Salaun 2010, ICRA: The true role of accelerometer feedback in quadrotor control); 0.029 measured on a Crazyflie under motion capture";
    const PARAMS: [Param; 1] = [
        param("kappa_radspm", "rad s/m", 0.0, [-0.05, 0.1], "true minus estimated tilt towards the velocity, per speed"),
    ];
    const HOOKS: Hooks = Hooks::COMMAND_AND_SENSE;

    #[inline(always)]
    fn command<R: Real>(&[kappa]: &[R; 1], _: &mut [R; 0], cx: &Cx<R>, x: &State<R>, u: &mut Command<R>) {
        let excess = excess_tilt_rad(kappa, x);
        for (i, angle) in [&mut u.roll_rad, &mut u.pitch_rad].into_iter().enumerate() {
            // 5.1 with the estimate in place of the angle: gain u - stiffness (angle - excess)
            *angle += excess[i] * cx.body.tilt_stiffness_ps2[i] / cx.body.tilt_gain_ps2[i];
        }
    }

    #[inline(always)]
    fn sense<R: Real>(&[kappa]: &[R; 1], _: &mut [R; 0], _: &Cx<R>, x: &State<R>, _: &Command<R>, y: &mut Reading<R>) {
        let excess = excess_tilt_rad(kappa, x);
        y.att_rad[0] -= excess[0];
        y.att_rad[1] -= excess[1];
    }
}

/// True less estimated roll and pitch: +pitch leans forward, +roll to the right.
#[inline(always)]
fn excess_tilt_rad<R: Real>(kappa: R, x: &State<R>) -> [R; 2] {
    let (sin, cos) = x.att_rad[2].sin_cos();
    let front = cos * x.vel_mps[0] + sin * x.vel_mps[1];
    let right = sin * x.vel_mps[0] - cos * x.vel_mps[1];
    [kappa * right, kappa * front]
}
