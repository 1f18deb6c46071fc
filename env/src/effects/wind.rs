//! A steady wind.

use super::{Call, Effect, Hooks, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct Wind;

impl Effect<3, 0> for Wind {
    const NAME: &'static str = "wind";
    const ABOUT: &'static str = "A constant force per mass";
    const SOURCE: &'static str = "Steady wind on a rotor with linear drag is a constant acceleration";
    const PARAMS: [Param; 3] = [
        param("x_mps2", "m/s^2", 0.0, [-5.0, 5.0]).about("along world x"),
        param("y_mps2", "m/s^2", 0.0, [-5.0, 5.0]).about("along world y"),
        param("z_mps2", "m/s^2", 0.0, [-5.0, 5.0]).about("along world z").constant(),
    ];
    const HOOKS: Hooks = Hooks::PUSH;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 3>, _: &mut [R; 0], _: &Command<R>, out: &mut Accelerations<R>) {
        let acc_mps2 = cx.params;
        for i in 0..3 {
            out.acc_mps2[i] += acc_mps2[i];
        }
    }
}
