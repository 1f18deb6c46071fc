//! An on-board estimator that takes drag for tilt.

use super::time::lag_shares;
use super::{Call, Effect, Hooks, Param, Reading, Scope, Ubiquity, param};
use crate::plant::{Command, State};
use crate::scalar::Scalar;

pub struct EstimatorTilt;

impl Effect<2, 4> for EstimatorTilt {
    const NAME: &'static str = "estimator_tilt";
    const ABOUT: &'static str = "The tilt that the vehicle estimates is off in proportion to its velocity: it leans towards where it flies by kappa v more than it thinks; it obeys commands and reports its tilt by the estimate";
    const SOURCE: &'static str = "An accelerometer feels drag as it would a tilt (Martin and Salaun 2010, ICRA: The true role of accelerometer feedback in quadrotor control); a filter corrected by positions takes its time to do so, and kappa is drag over gravity then; 0.029 without a lag, 0.054 with twice 0.36 s measured on a Crazyflie under motion capture";
    const PARAMS: [Param; 2] = [
        param("kappa_radspm", "rad s/m", 0.0, [0.0, 0.2])
            .about("true minus estimated tilt towards the velocity, per speed; drag over gravity, so never below zero")
            .at_least(0.01),
        param("lag_s", "s", 0.0, [0.0, 1.5])
            .about("the estimate follows the velocity through two lags of this time constant")
            .companion(&[0.35]),
    ];
    const HOOKS: Hooks = Hooks::COMMAND_AND_SENSE;
    const SCOPE: Scope = Scope::IdentifiedLoops;
    const UBIQUITY: Ubiquity = Ubiquity::All;
    // after 2 s, two lags of 0.35 s leave 2 %
    const MOTION_MEMORY_S: f64 = 2.0;

    #[inline(always)]
    fn start<R: Scalar>(cx: Call<R, 2>, _: &Command<R>) -> [R; 4] {
        let [x_mps, y_mps, _] = cx.x.vel_mps;
        [x_mps, y_mps, x_mps, y_mps]
    }

    #[inline(always)]
    fn command<R: Scalar>(cx: Call<R, 2>, followed: &mut [R; 4], u: &mut Command<R>) {
        let &[kappa, lag_s] = cx.params;
        let [left, mean] = lag_shares(lag_s, cx.h_s);
        // state of a lag at the end of the step, and its mean over the step
        let follow = |to: R, from: R| (to + (from - to) * left, to + (from - to) * mean);
        let mut over_step = [R::zero(); 2];
        for i in 0..2 {
            let first;
            (followed[i], first) = follow(cx.x.vel_mps[i], followed[i]);
            (followed[2 + i], over_step[i]) = follow(first, followed[2 + i]);
        }
        let excess = excess_tilt_rad(kappa, over_step, cx.x);
        for (i, angle) in [&mut u.roll_rad, &mut u.pitch_rad].into_iter().enumerate() {
            // 5.1 with the estimate in place of the angle: gain u - stiffness (angle - excess)
            *angle += cx.body.command_for_tilt_rad(i, excess[i]);
        }
    }

    #[inline(always)]
    fn sense<R: Scalar>(cx: Call<R, 2>, followed: &mut [R; 4], y: &mut Reading<R>) {
        let &[kappa, lag_s] = cx.params;
        // the followed acceleration is of the last physics step, without a lag of this one
        let lags = lag_s.gt(R::zero());
        let excess = excess_tilt_rad(
            kappa,
            std::array::from_fn(|i| R::select(lags, followed[2 + i], cx.x.vel_mps[i])),
            cx.x,
        );
        y.att_rad[0] -= excess[0];
        y.att_rad[1] -= excess[1];
    }
}

/// True less estimated roll and pitch by the velocity that the estimate has followed: +pitch leans forward,
/// +roll to the right.
#[inline(always)]
fn excess_tilt_rad<R: Scalar>(kappa: R, vel_mps: [R; 2], x: &State<R>) -> [R; 2] {
    let (sin, cos) = x.att_rad[2].sin_cos();
    let front = cos * vel_mps[0] + sin * vel_mps[1];
    let right = sin * vel_mps[0] - cos * vel_mps[1];
    [kappa * right, kappa * front]
}
