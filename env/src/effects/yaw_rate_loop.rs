//! A yaw rate that is too small and late.

use super::time::lag_shares;
use super::{Call, Effect, Hooks, Param, Scope, param};
use crate::plant::Command;
use crate::scalar::Scalar;

pub struct YawRateLoop;

impl Effect<2, 1> for YawRateLoop {
    const NAME: &'static str = "yaw_rate_loop";
    const ABOUT: &'static str =
        "The vehicle obeys the yaw rate times a gain, through a first-order lag beyond the declared one";
    const SOURCE: &'static str = "Rate loop without integral against the drag of the rotors: real yaw turns about 2 % slower than 5.2 and follows as second order";
    const PARAMS: [Param; 2] = [
        param("gain", "1", 1.0, [0.5, 1.5]).about("yaw rate obeyed over yaw rate commanded").at_least(0.01),
        param("lag_s", "s", 0.0, [0.0, 0.3])
            .about("time constant beyond the declared dynamics")
            .at_least(0.01),
    ];
    const HOOKS: Hooks = Hooks::COMMAND;
    const SCOPE: Scope = Scope::Angles;

    #[inline(always)]
    fn start<R: Scalar>(cx: Call<R, 2>, u: &Command<R>) -> [R; 1] {
        let &[gain, _] = cx.params;
        [gain * u.yaw_rate_radps]
    }

    #[inline(always)]
    fn command<R: Scalar>(cx: Call<R, 2>, obeyed: &mut [R; 1], u: &mut Command<R>) {
        let &[gain, lag_s] = cx.params;
        let asked = gain * u.yaw_rate_radps;
        let [left, mean] = lag_shares(lag_s, cx.h_s);
        let behind = obeyed[0] - asked;
        obeyed[0] = asked + behind * left;
        u.yaw_rate_radps = asked + behind * mean;
    }
}
