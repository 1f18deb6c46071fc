//! Less lift in the wake of a drone above.

use super::{Call, Effect, Hooks, Observability, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct Downwash;

/// Distance at which the published forces apply: a quarter of a metre below.
const REFERENCE_M: f64 = 0.25;

impl Effect<5, 0> for Downwash {
    const NAME: &'static str = "downwash";
    const ABOUT: &'static str = "Lift lost below another drone: a turbulent jet, gone 15 cm sideways";
    const SOURCE: &'static str = "Two Crazyflies on top of each other: 12 g at 25 cm, 9 g at 30 cm, gone beyond 15 cm sideways (Shi, Hoenig, Yue, Chung 2020, Neural-Swarm, arXiv 2003.02992); form: dynamic pressure of a jet, (z + origin)^-2 and Gaussian across, from 2.5 motor distances down (Bauersfeld et al. 2024, arXiv 2403.13321)";
    const PARAMS: [Param; 5] = [
        param("force_n", "N", 0.0, [0.0, 0.5])
            .about("lift lost a quarter of a metre straight below; 0.118 measured"),
        param("origin_m", "m", 0.073, [0.0, 0.5])
            .about("the jet seems to begin so far above the drone: from the two forces")
            .constant(),
        param("near_m", "m", 0.16, [0.02, 0.5])
            .about(
                "nearer than this the jet is not formed, and the force falls to nothing at the same height",
            )
            .constant(),
        param("width_m", "m", 0.055, [0.01, 0.3])
            .about("standard deviation across at the drone: its own size")
            .constant(),
        param("spread", "1", 0.057, [0.0, 0.3])
            .about(
                "growth of the width per metre; half-velocity width 0.094 z of a round jet (Pope 2000, 5.1)",
            )
            .constant(),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const OBSERVABILITY: Observability = Observability::Neighbours;

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 5>, _: &mut [R; 0], _: &Command<R>, out: &mut Accelerations<R>) {
        let &[force_n, origin_m, near_m, width_m, spread] = cx.params;
        let per_near = R::from_f64(1.0) / near_m;
        let reference = R::from_f64(REFERENCE_M) + origin_m;
        let mut lost = R::zero();
        for (i, other) in cx.neighbours.iter().enumerate() {
            if i == cx.own {
                continue;
            }
            let [dx, dy, above] = [
                other.pos_m[0] - cx.x.pos_m[0],
                other.pos_m[1] - cx.x.pos_m[1],
                other.pos_m[2] - cx.x.pos_m[2],
            ];
            let flies = other.here * R::select(above.gt(R::zero()), R::from_f64(1.0), R::zero());
            let down = above.max(near_m) + origin_m;
            let grown = spread * down;
            let across = (dx * dx + dy * dy) / (width_m * width_m + grown * grown);
            let strength = reference / down;
            lost += flies
                * (above * per_near).min(R::from_f64(1.0))
                * strength
                * strength
                * (R::from_f64(-0.5) * across).exp();
        }
        out.acc_mps2[2] -= force_n * lost / cx.body.mass_kg;
    }
}
