//! Commands that arrive late.

use super::time::slots;
use super::{Build, Call, Effect, Hooks, Param, Stage, param, stage};
use crate::plant::Command;
use crate::scalar::Scalar;
use crate::sim_scalar::SimScalar;

/// Remembers `S / 4` commands.
pub struct CmdDelay<const S: usize>;

const LONGEST_S: f64 = 0.14;
/// Numbers of a command.
const COMMAND: usize = 4;
/// Commands that cover the longest delay, and the newest, up to 50, 100 and 500 Hz.
const SLOTS: [usize; 3] = [8, 15, 71];

impl CmdDelay<{ COMMAND * SLOTS[0] }> {
    pub const NEW: Self = CmdDelay;
}

impl<const S: usize> Effect<1, S> for CmdDelay<S> {
    const NAME: &'static str = "cmd_delay";
    const ABOUT: &'static str = "Pure delay between the command and the vehicle";
    const SOURCE: &'static str = "The delayed held command is averaged over the physics step, which is exact for the integral of the command";
    const PARAMS: [Param; 1] = [param("delay_s", "s", 0.0, [0.0, LONGEST_S])
        .about("from command to effect; above 500 Hz control at most 70 ticks")
        .at_least(0.015)];
    const HOOKS: Hooks = Hooks::COMMAND;
    const DELAYS: bool = true;
    const RING: usize = COMMAND;

    fn wider<R: SimScalar>(build: Build) -> Option<Box<dyn Stage<R>>> {
        let needed = slots(LONGEST_S, build.tick_s).min(SLOTS[2]);
        (S / COMMAND < needed).then(|| {
            if needed <= SLOTS[1] {
                stage::boxed(&CmdDelay::<{ COMMAND * SLOTS[1] }>, build)
            } else {
                stage::boxed(&CmdDelay::<{ COMMAND * SLOTS[2] }>, build)
            }
        })
    }

    #[inline(always)]
    fn start<R: Scalar>(_: Call<R, 1>, u: &Command<R>) -> [R; S] {
        let one = [u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift];
        std::array::from_fn(|i| one[i % COMMAND])
    }

    #[inline(always)]
    fn command<R: Scalar>(cx: Call<R, 1>, past: &mut [R; S], u: &mut Command<R>) {
        let &[delay_s] = cx.params;
        // a ring of commands; all lanes tick together
        let slots = S / COMMAND;
        let slot = |k: usize| COMMAND * ((cx.clock + slots - k) % slots);
        if cx.first {
            past[slot(0)..slot(0) + COMMAND].copy_from_slice(&[
                u.roll_rad,
                u.pitch_rad,
                u.yaw_rate_radps,
                u.lift,
            ]);
        }
        // command k (0 is the newest) was given from -k ticks to -k + 1 ticks; this step sees the span
        // [begin, begin + h)
        let begin = R::from_f64(cx.since_tick_s) - delay_s.min(R::from_f64((slots - 1) as f64 * cx.tick_s));
        let end = begin + R::from_f64(cx.h_s);
        let mut sum = [R::zero(); COMMAND];
        for k in 0..slots {
            let sent_s = R::from_f64(-(k as f64) * cx.tick_s);
            let overlap = (end.min(sent_s + R::from_f64(cx.tick_s)) - begin.max(sent_s)).max(R::zero());
            let share = overlap * R::from_f64(1.0 / cx.h_s);
            for (sum, past) in sum.iter_mut().zip(&past[slot(k)..slot(k) + COMMAND]) {
                *sum += share * *past;
            }
            // rounding may leave the begin of a delay of whole ticks a little early
            if R::all(sent_s.le(begin + R::from_f64(1e-6))) {
                break;
            }
        }
        [u.roll_rad, u.pitch_rad, u.yaw_rate_radps, u.lift] = sum;
    }
}
