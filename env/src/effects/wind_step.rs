//! Wind that sets in.

use super::time::step_share;
use super::{Call, Effect, Hooks, Observability, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct WindStep;

impl Effect<3, 0> for WindStep {
    const NAME: &'static str = "wind_step";
    const ABOUT: &'static str = "From a time on a constant force per mass";
    const SOURCE: &'static str = "A fan that is switched on, or the edge of its stream; the step is a ramp of 0.2 s centred on its time";
    const PARAMS: [Param; 3] = [
        param("x_mps2", "m/s^2", 0.0, [-5.0, 5.0]).about("along world x"),
        param("y_mps2", "m/s^2", 0.0, [-5.0, 5.0]).about("along world y"),
        param("t_s", "s", 1.0, [0.0, 600.0]).about("since the flight began"),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const OBSERVABILITY: Observability = Observability::Located;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 3>, _: &mut [R; 0], _: &Command<R>, out: &mut Accelerations<R>) {
        let &[x_mps2, y_mps2, t_s] = cx.params;
        let share = step_share(t_s, &cx);
        out.acc_mps2[0] += x_mps2 * share;
        out.acc_mps2[1] += y_mps2 * share;
    }
}
