//! Marker poses that arrive late.

use super::{Effect, Frame, HookContext, Hooks, Param, Reading, param};
use crate::plant::{Command, State};
use crate::scalar::Scalar;

pub struct CameraLatency;

const LONGEST_S: f64 = 0.12;
/// Numbers of a frame under way: pose, stamp, markers.
const FRAME: usize = 6;
/// Frames that are under way at most: one per control tick for the longest latency at 500 Hz, and the newest.
const SLOTS: usize = 61;
const NUMBERS: usize = FRAME * SLOTS;

/// Numbers of all frames that can be under way; a tick brings one at most.
#[inline(always)]
fn numbers(tick_s: f64) -> usize {
    // a whole number of ticks may come out a little longer
    FRAME * ((LONGEST_S / tick_s - 1e-9).ceil() as usize + 1).min(SLOTS)
}

impl Effect<2, NUMBERS> for CameraLatency {
    const NAME: &'static str = "camera_latency";
    const ABOUT: &'static str = "Time from the exposure of a frame to the pose at the controller";
    const SOURCE: &'static str = "Exposure, transmission and detection; a queue of frames";
    const PARAMS: [Param; 2] = [
        param(
            "latency_s",
            "s",
            0.0,
            [0.0, LONGEST_S],
            "from capture to arrival; above 500 frames a second at most 60 frames are under way",
        )
        .constant(),
        param(
            "undeclared_s",
            "s",
            0.0,
            [-0.05, LONGEST_S],
            "how much later than the capture the time stamp is",
        ),
    ];
    const HOOKS: Hooks = Hooks::FRAME_AND_SENSE;

    fn states_in_use(tick_s: f64) -> usize {
        numbers(tick_s)
    }

    #[inline(always)]
    fn start<R: Scalar>(_: &[R; 2], _: &HookContext<R>, _: &State<R>, _: &Command<R>) -> [R; NUMBERS] {
        let mut queue = [R::zero(); NUMBERS];
        for slot in queue.chunks_exact_mut(FRAME) {
            slot[4] = R::from_f64(EMPTY_S);
        }
        queue
    }

    /// Put the new frame first in the queue and keep it from arriving now.
    #[inline(always)]
    fn frame<R: Scalar>(
        &[_, undeclared_s]: &[R; 2],
        queue: &mut [R; NUMBERS],
        cx: &HookContext<R>,
        _: &State<R>,
        f: &mut Frame<R>,
    ) {
        f.t_s += undeclared_s;
        let new = [f.pos_m[0], f.pos_m[1], f.pos_m[2], f.yaw_rad, f.t_s, f.markers];
        for i in (0..numbers(cx.tick_s)).rev() {
            let value = if i < FRAME { new[i] } else { queue[i - FRAME] };
            queue[i] = R::select(f.captured, value, queue[i]);
        }
        f.captured = R::nothing();
    }

    /// Deliver what is due, oldest first, so that the newest due frame stays.
    #[inline(always)]
    fn sense<R: Scalar>(
        &[latency_s, undeclared_s]: &[R; 2],
        queue: &mut [R; NUMBERS],
        cx: &HookContext<R>,
        _: &State<R>,
        _: &Command<R>,
        y: &mut Reading<R>,
    ) {
        // a frame due exactly now is not lost to rounding
        let due = cx.t_s - latency_s + undeclared_s + R::from_f64(1e-4);
        for slot in queue[..numbers(cx.tick_s)].chunks_exact_mut(FRAME).rev() {
            let arrived = slot[4].le(due);
            if R::any(arrived) {
                y.marker.deliver(arrived, [slot[0], slot[1], slot[2]], slot[3], slot[4], slot[5]);
                slot[4] = R::select(arrived, R::from_f64(EMPTY_S), slot[4]);
            }
        }
    }
}

/// Capture time of a slot with nothing in it: never due.
const EMPTY_S: f64 = 1e9;
