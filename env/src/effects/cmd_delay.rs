//! Commands that arrive late.

use super::{Cx, Effect, Hooks, Param, param};
use crate::plant::{Command, State};
use crate::real::Real;

pub struct CmdDelay;

impl Effect<1, 32> for CmdDelay {
    const NAME: &'static str = "cmd_delay";
    const ABOUT: &'static str = "Pure delay between the command and the vehicle";
    const SOURCE: &'static str = "The delayed held command is averaged over the physics step, which is exact for the integral of the command";
    const PARAMS: [Param; 1] = [
        param("delay_s", "s", 0.0, [0.0, 0.14], "from command to effect; at most seven control ticks of 20 ms"),
    ];
    const HOOKS: Hooks = Hooks::COMMAND;

    #[inline(always)]
    fn start<R: Real>(_: &[R; 1], _: &Cx<R>, _: &State<R>, u: &Command<R>) -> [R; 32] {
        let one = [u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift];
        std::array::from_fn(|i| one[i % 4])
    }

    #[inline(always)]
    fn command<R: Real>(&[delay_s]: &[R; 1], past: &mut [R; 32], cx: &Cx<R>, _: &State<R>, u: &mut Command<R>) {
        // a ring of eight commands; all lanes tick together
        let slot = |k: usize| 4 * ((cx.clock + 8 - k) % 8);
        if cx.first {
            past[slot(0)..slot(0) + 4].copy_from_slice(&[u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift]);
        }
        // command k (0 is the newest) was given from -k ticks to -k + 1 ticks; this step sees the span [begin, begin + h)
        let begin = R::of(cx.since_tick_s) - delay_s;
        let end = begin + R::of(cx.h_s);
        let mut sum = [R::zero(); 4];
        for k in 0..8 {
            let given = R::of(-(k as f64) * cx.tick_s);
            let overlap = (end.min(given + R::of(cx.tick_s)) - begin.max(given)).max(R::zero());
            let share = overlap * R::of(1.0 / cx.h_s);
            for (sum, past) in sum.iter_mut().zip(&past[slot(k)..slot(k) + 4]) {
                *sum += share * *past;
            }
            // rounding may leave the begin of a delay of whole ticks a little early
            if R::all(given.le(begin + R::of(1e-6))) {
                break;
            }
        }
        [u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift] = sum;
    }
}
