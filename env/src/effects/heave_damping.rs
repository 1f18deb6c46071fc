//! Damping of vertical motion.

use super::{Cx, Effect, Hooks, Param, param};
use crate::plant::{Command, Push, State};
use crate::real::Real;

pub struct HeaveDamping;

impl Effect<1, 0> for HeaveDamping {
    const NAME: &'static str = "heave_damping";
    const ABOUT: &'static str = "Vertical damping beyond the declared: acc = -added vz";
    const SOURCE: &'static str = "Inflow through the rotors damps climb (Leishman, Principles of Helicopter Aerodynamics)";
    const PARAMS: [Param; 1] = [param("added_ps", "1/s", 0.0, [-1.0, 5.0], "damping per mass")];
    const HOOKS: Hooks = Hooks::PUSH;
    const MODEL_NUMBER: Option<&'static str> = Some("vertical.thrust.heave");

    #[inline(always)]
    fn push<R: Real>(&[added_ps]: &[R; 1], _: &mut [R; 0], _: &Cx<R>, x: &State<R>, _: &Command<R>, out: &mut Push<R>) {
        out.acc_mps2[2] -= added_ps * x.vel_mps[2];
    }
}
