//! Angles that are smaller or larger than commanded.

use super::{Call, Effect, Hooks, Param, Scope, param};
use crate::plant::Command;
use crate::scalar::Scalar;

pub struct AttitudeGain;

impl Effect<1, 0> for AttitudeGain {
    const NAME: &'static str = "attitude_gain";
    const ABOUT: &'static str = "Commanded roll and pitch act scaled by this gain";
    const SOURCE: &'static str =
        "Gain of 5.1 differs between vehicles; the roll fit of 5.1.1 differs from the pitch fit";
    const PARAMS: [Param; 1] =
        [param("gain", "1", 1.0, [0.2, 3.0]).about("angle obeyed over angle commanded").at_least(0.04)];
    const HOOKS: Hooks = Hooks::COMMAND;
    const SCOPE: Scope = Scope::Angles;

    #[inline(always)]
    fn command<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], u: &mut Command<R>) {
        let &[gain] = cx.params;
        u.roll_rad = gain * u.roll_rad;
        u.pitch_rad = gain * u.pitch_rad;
    }
}
