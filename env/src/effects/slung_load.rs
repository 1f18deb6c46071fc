//! A weight on a thread.

use super::{Call, Effect, Hooks, Observability, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::Scalar;

pub struct SlungLoad;

impl Effect<4, 4> for SlungLoad {
    const NAME: &'static str = "slung_load";
    const ABOUT: &'static str = "A weight swings on a thread below the centre of mass: a pendulum that the vehicle drags, and that pulls it";
    const SOURCE: &'static str = "Two bodies and a taut thread, small swings: load'' = -w^2 r, vehicle'' = g lean + ratio (w^2 r + g lean), w^2 = g / length: the declared g lean turns both as one body, but the vehicle leans alone";
    const PARAMS: [Param; 4] = [
        param("mass_ratio", "1", 0.0, [0.0, 0.6])
            .about("weight of the load over that of the vehicle")
            .at_least(0.02),
        param("length_m", "m", 0.5, [0.2, 3.0])
            .about("from the centre of mass to the load")
            .starting_from(&[0.25, 1.0]),
        param("damping_ps", "1/s", 0.1, [0.0, 2.0])
            .about("of the swing: what air and knot take from its speed")
            .companion(&[0.1]),
        param("declared", "1", 0.0, [0.0, 2.0])
            .about("1 where the declared weight, or hover thrust, holds the load already: it swings, but lowers nothing; 2 where besides its pull adds to the declared sideways acceleration, as in simulators that leave out what follows from two bodies")
            .choice(),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const OBSERVABILITY: Observability = Observability::Resonant;
    const MOTION_STATES: usize = 4;
    /// Metres and metres per second: a swing is small.
    const LAG_SD: f64 = 0.3;

    /// It hangs straight down and moves along.
    #[inline(always)]
    fn start<R: Scalar>(cx: Call<R, 4>, _: &Command<R>) -> [R; 4] {
        [R::zero(), R::zero(), cx.x.vel_mps[0], cx.x.vel_mps[1]]
    }

    /// `load` is where it is from the vehicle, and its own velocity: the vehicle's acceleration is not needed
    /// then.
    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 4>, load: &mut [R; 4], u: &Command<R>, out: &mut Accelerations<R>) {
        let x = cx.x;
        let &[mass_ratio, length_m, damping_ps, declared] = cx.params;
        let leans_alone = R::select(declared.gt(R::from_f64(1.5)), R::zero(), R::from_f64(1.0));
        let carried_mps2 = cx.body.thrust_mps2(u, out) - cx.body.heave_ps * x.vel_mps[2];
        let undeclared = mass_ratio * (R::from_f64(1.0) - declared).max(R::zero());
        // the thread's tension per mass of the load; a thread does not push
        let tension_mps2 = carried_mps2.max(R::zero()) / (R::from_f64(1.0) + undeclared);
        out.acc_mps2[2] -= undeclared * tension_mps2;
        let (sin, cos) = x.att_rad[2].sin_cos();
        let [roll, pitch, _] = x.att_rad;
        let lean = [cos * pitch + sin * roll, sin * pitch - cos * roll];
        let (h, half) = (R::from_f64(cx.h_s), R::from_f64(0.5 * cx.h_s));
        for i in 0..2 {
            // leapfrog: the pull of the middle of the step
            let apart_mps = load[2 + i] - x.vel_mps[i];
            let apart_m = load[i] + half * apart_mps;
            let pull_mps2 = tension_mps2 * apart_m / length_m;
            load[2 + i] -= h * (pull_mps2 + damping_ps * apart_mps);
            load[i] = apart_m + half * (load[2 + i] - x.vel_mps[i]);
            // the declared thrust per mass pushes what swings along: here it pushes the vehicle alone
            out.acc_mps2[i] += mass_ratio * (pull_mps2 + leans_alone * tension_mps2 * lean[i]);
        }
    }
}
