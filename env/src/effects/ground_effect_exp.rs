//! More thrust near the floor, exponential law.

use super::{Call, Effect, Hooks, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct GroundEffectExp;

impl Effect<3, 0> for GroundEffectExp {
    const NAME: &'static str = "ground_effect_exp";
    const ABOUT: &'static str = "Thrust grows near the floor as 1 / (1 - amount exp(-decay (z - rest) / R))";
    const SOURCE: &'static str = "He, Kou, Calaf and Leang 2019, J. Dyn. Sys. Meas. Control 141(7): exponential in-ground-effect model";
    const PARAMS: [Param; 3] = [
        param("amount", "1", 0.0, [0.0, 0.5]).about("share at the floor"),
        param("decay", "1", 0.5, [0.05, 5.0])
            .about("per rotor radius of height; 0.54 fits a scale of 42 mm, measured in a hover near the floor"),
        param("rest_m", "m", 0.0, [-0.1, 0.5])
            .about("z of the vehicle at rest on the floor, from which the height counts: a marker's origin lies where a session puts it")
            .constant(),
    ];
    const HOOKS: Hooks = Hooks::PUSH;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 3>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[amount, decay, rest_m] = cx.params;
        let share =
            amount * (-decay * (cx.x.pos_m[2] - rest_m).max(R::zero()) / cx.body.rotor_radius_m).exp();
        out.acc_mps2[2] += cx.body.thrust_mps2(u, out) * share / (R::from_f64(1.0) - share);
    }
}
