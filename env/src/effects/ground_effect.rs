//! More thrust near the floor.

use super::{Call, Effect, Hooks, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct GroundEffect;

impl Effect<2, 0> for GroundEffect {
    const NAME: &'static str = "ground_effect";
    const ABOUT: &'static str = "Thrust grows near the floor as 1 / (1 - coefficient (R / 4z)^2)";
    const SOURCE: &'static str = "Cheeseman and Bennett 1955, R&M 3021 (coefficient 1 for one rotor); for quadrotors with fitted coefficient: Li et al. 2015";
    const PARAMS: [Param; 2] = [
        param("coefficient", "1", 0.0, [0.0, 40.0])
            .about("1 for a single rotor; about 4 to 14 fitted on small quadrotors"),
        param("rotor_height_m", "m", 0.0, [-0.05, 0.2])
            .about("rotor plane above the point whose height is z; legs and frame")
            .constant(),
    ];
    const HOOKS: Hooks = Hooks::PUSH;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 2>, _: &mut [R; 0], u: &Command<R>, out: &mut Accelerations<R>) {
        let &[coefficient, rotor_height_m] = cx.params;
        let height = (cx.x.pos_m[2] + rotor_height_m).max(R::from_f64(1e-3));
        let near = cx.body.rotor_radius_m / (R::from_f64(4.0) * height);
        // the law has a pole below about a quarter radius, where it was never measured: no more than twice
        // the thrust
        let share = (coefficient * near * near).min(R::from_f64(0.5));
        out.acc_mps2[2] += cx.body.thrust_mps2(u, out) * share / (R::from_f64(1.0) - share);
    }
}
