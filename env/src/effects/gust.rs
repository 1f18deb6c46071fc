//! Turbulence.

use super::{Call, Effect, GaussMarkovSignal, Hooks, Observability, Param, param};
use crate::plant::{Accelerations, Command};
use crate::scalar::{Scalar, each};

pub struct Gust;

impl Effect<2, 2> for Gust {
    const NAME: &'static str = "gust";
    const ABOUT: &'static str = "Random horizontal force with a correlation time";
    const SOURCE: &'static str = "First-order Gauss-Markov gusts, the longitudinal Dryden spectrum (MIL-F-8785C) at fixed length over speed";
    const PARAMS: [Param; 2] = [
        param("sigma_mps2", "m/s^2", 0.0, [0.0, 3.0]).about("standard deviation on each axis"),
        param("tau_s", "s", 1.0, [0.05, 20.0]).about("correlation time"),
    ];
    const HOOKS: Hooks = Hooks::PUSH;
    const OBSERVABILITY: Observability = Observability::GaussMarkov(GaussMarkovSignal::Force);

    #[inline(always)]
    fn start<R: Scalar>(cx: Call<R, 2>, _: &Command<R>) -> [R; 2] {
        let &[sigma_mps2, _] = cx.params;
        // the stationary distribution; other channels than the first tick's
        each(cx.draw.normals(Self::NOISE.wrapping_add(1)), |n| sigma_mps2 * n)
    }

    #[inline(always)]
    fn push<R: Scalar>(cx: Call<R, 2>, acc: &mut [R; 2], _: &Command<R>, out: &mut Accelerations<R>) {
        let &[sigma_mps2, tau_s] = cx.params;
        if cx.first {
            let keep = (R::from_f64(-cx.tick_s) / tau_s).exp();
            let spread = sigma_mps2 * (R::from_f64(1.0) - keep * keep).sqrt();
            for (acc, n) in acc.iter_mut().zip(cx.draw.normals(Self::NOISE)) {
                *acc = keep * *acc + spread * n;
            }
        }
        for i in 0..2 {
            out.acc_mps2[i] += acc[i];
        }
    }
}
