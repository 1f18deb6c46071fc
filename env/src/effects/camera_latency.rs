//! Marker poses that arrive late.

use super::{Cx, Effect, Frame, Hooks, Param, Reading, param};
use crate::plant::{Command, State};
use crate::real::Real;

pub struct CameraLatency;

impl Effect<2, 24> for CameraLatency {
    const NAME: &'static str = "camera_latency";
    const ABOUT: &'static str = "Time from the exposure of a frame to the pose at the controller";
    const SOURCE: &'static str = "Exposure, transmission and detection; a queue of four frames";
    const PARAMS: [Param; 2] = [
        param("latency_s", "s", 0.0, [0.0, 0.12], "from capture to arrival; at most four frames of 33 ms are under way").constant(),
        param("undeclared_s", "s", 0.0, [-0.05, 0.12], "how much later than the capture the time stamp is"),
    ];
    const HOOKS: Hooks = Hooks::FRAME_AND_SENSE;

    #[inline(always)]
    fn start<R: Real>(_: &[R; 2], _: &Cx<R>, _: &State<R>, _: &Command<R>) -> [R; 24] {
        let mut queue = [R::zero(); 24];
        for slot in queue.chunks_exact_mut(6) {
            slot[4] = R::of(EMPTY_S);
        }
        queue
    }

    /// Put the new frame first in the queue and keep it from arriving now.
    #[inline(always)]
    fn frame<R: Real>(&[_, undeclared_s]: &[R; 2], queue: &mut [R; 24], _: &Cx<R>, _: &State<R>, f: &mut Frame<R>) {
        f.t_s += undeclared_s;
        let new = [f.pos_m[0], f.pos_m[1], f.pos_m[2], f.yaw_rad, f.t_s, f.markers];
        for i in (0..24).rev() {
            let value = if i < 6 { new[i] } else { queue[i - 6] };
            queue[i] = R::select(f.captured, value, queue[i]);
        }
        f.captured = R::nothing();
    }

    /// Deliver what is due, oldest first, so that the newest due frame stays.
    #[inline(always)]
    fn sense<R: Real>(&[latency_s, undeclared_s]: &[R; 2], queue: &mut [R; 24], cx: &Cx<R>, _: &State<R>, _: &Command<R>, y: &mut Reading<R>) {
        // a frame due exactly now is not lost to rounding
        let due = cx.t_s - latency_s + undeclared_s + R::of(1e-4);
        for slot in queue.chunks_exact_mut(6).rev() {
            let arrived = slot[4].le(due);
            y.marker.deliver(arrived, [slot[0], slot[1], slot[2]], slot[3], slot[4], slot[5]);
            slot[4] = R::select(arrived, R::of(EMPTY_S), slot[4]);
        }
    }
}

/// Capture time of a slot with nothing in it: never due.
const EMPTY_S: f64 = 1e9;
