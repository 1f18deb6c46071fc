//! Commands that arrive late.

use super::{Effect, HookContext, Hooks, Param, param};
use crate::plant::{Command, State};
use crate::scalar::Scalar;

pub struct CmdDelay;

const LONGEST_S: f64 = 0.14;
/// Commands that are remembered at most: the longest delay at 500 Hz, and the newest.
const SLOTS: usize = 71;
const NUMBERS: usize = 4 * SLOTS;

/// Commands that are remembered: the longest delay in control ticks, and the newest.
#[inline(always)]
fn slots(tick_s: f64) -> usize {
    // a whole number of ticks may come out a little longer
    ((LONGEST_S / tick_s - 1e-9).ceil() as usize + 1).min(SLOTS)
}

impl Effect<1, NUMBERS> for CmdDelay {
    const NAME: &'static str = "cmd_delay";
    const ABOUT: &'static str = "Pure delay between the command and the vehicle";
    const SOURCE: &'static str = "The delayed held command is averaged over the physics step, which is exact for the integral of the command";
    const PARAMS: [Param; 1] = [param(
        "delay_s",
        "s",
        0.0,
        [0.0, LONGEST_S],
        "from command to effect; above 500 Hz control at most 70 ticks",
    )
    .at_least(0.01)];
    const HOOKS: Hooks = Hooks::COMMAND;

    fn states_in_use(tick_s: f64) -> usize {
        4 * slots(tick_s)
    }

    #[inline(always)]
    fn start<R: Scalar>(_: &[R; 1], _: &HookContext<R>, _: &State<R>, u: &Command<R>) -> [R; NUMBERS] {
        let one = [u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift];
        std::array::from_fn(|i| one[i % 4])
    }

    #[inline(always)]
    fn command<R: Scalar>(
        &[delay_s]: &[R; 1],
        past: &mut [R; NUMBERS],
        cx: &HookContext<R>,
        _: &State<R>,
        u: &mut Command<R>,
    ) {
        // a ring of commands; all lanes tick together
        let slots = slots(cx.tick_s);
        let slot = |k: usize| 4 * ((cx.clock + slots - k) % slots);
        if cx.first {
            past[slot(0)..slot(0) + 4].copy_from_slice(&[u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift]);
        }
        // command k (0 is the newest) was given from -k ticks to -k + 1 ticks; this step sees the span
        // [begin, begin + h)
        let begin = R::from_f64(cx.since_tick_s) - delay_s.min(R::from_f64((slots - 1) as f64 * cx.tick_s));
        let end = begin + R::from_f64(cx.h_s);
        let mut sum = [R::zero(); 4];
        for k in 0..slots {
            let given = R::from_f64(-(k as f64) * cx.tick_s);
            let overlap = (end.min(given + R::from_f64(cx.tick_s)) - begin.max(given)).max(R::zero());
            let share = overlap * R::from_f64(1.0 / cx.h_s);
            for (sum, past) in sum.iter_mut().zip(&past[slot(k)..slot(k) + 4]) {
                *sum += share * *past;
            }
            // rounding may leave the begin of a delay of whole ticks a little early
            if R::all(given.le(begin + R::from_f64(1e-6))) {
                break;
            }
        }
        [u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift] = sum;
    }
}
