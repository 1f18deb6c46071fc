//! A weight on a thread.

use super::{Cx, Effect, Hooks, Param, param};
use crate::plant::{Command, Push, State};
use crate::real::Real;

pub struct SlungLoad;

impl Effect<2, 4> for SlungLoad {
    const NAME: &'static str = "slung_load";
    const ABOUT: &'static str = "A weight swings on a thread below the centre of mass: a pendulum that the vehicle drags, and that pulls it";
    const SOURCE: &'static str = "Two bodies and a taut thread, small swings: load'' = -w^2 r, vehicle'' = ratio w^2 r, w^2 = thrust / ((1 + ratio) length)";
    const PARAMS: [Param; 2] = [
        param("mass_ratio", "1", 0.0, [0.0, 0.6], "weight of the load over that of the vehicle"),
        param("length_m", "m", 0.5, [0.1, 3.0], "from the centre of mass to the load").starting_from(&[0.25, 0.5, 1.0]),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const LAGS: usize = 4;
    /// Metres and metres per second: a swing is small.
    const LAG_SD: f64 = 0.3;

    /// It hangs straight down and moves along.
    #[inline(always)]
    fn start<R: Real>(_: &[R; 2], _: &Cx<R>, x: &State<R>, _: &Command<R>) -> [R; 4] {
        [R::zero(), R::zero(), x.vel_mps[0], x.vel_mps[1]]
    }

    /// `load` is where it is from the vehicle, and its own velocity: the vehicle's acceleration is not needed then.
    #[inline(always)]
    fn push<R: Real>(&[mass_ratio, length_m]: &[R; 2], load: &mut [R; 4], cx: &Cx<R>, x: &State<R>, u: &Command<R>, out: &mut Push<R>) {
        let carried = cx.body.thrust_mps2(u, out) - cx.body.heave_ps * x.vel_mps[2];
        // the thread's tension per mass of the load; a thread does not push
        let tension_mps2 = carried.max(R::zero()) / (R::of(1.0) + mass_ratio);
        out.acc_mps2[2] -= mass_ratio * tension_mps2;
        let (h, half) = (R::of(cx.h_s), R::of(0.5 * cx.h_s));
        for i in 0..2 {
            // leapfrog: the pull of the middle of the step
            let apart_m = load[i] + half * (load[2 + i] - x.vel_mps[i]);
            let pull_mps2 = tension_mps2 * apart_m / length_m;
            load[2 + i] -= h * pull_mps2;
            load[i] = apart_m + half * (load[2 + i] - x.vel_mps[i]);
            out.acc_mps2[i] += mass_ratio * pull_mps2;
        }
    }
}
