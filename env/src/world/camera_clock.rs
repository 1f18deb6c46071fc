//! Camera frames between control ticks.

use super::Tile;
use crate::effects::{Frame, PoseFix};
use crate::model::Schedule;
use crate::plant::State;
use crate::scalar::Scalar;

/// When frames are taken.
pub(super) struct CameraClock {
    pub(super) counts_per_step: u32,
    pub(super) schedule: Schedule,
    pub(super) h_s: f64,
}

impl CameraClock {
    /// Takes the frames that are due within a physics step.
    #[inline(always)]
    pub(super) fn look<R: Scalar>(
        &self,
        step: u32,
        until_frame: R,
        [from, to]: [&State<R>; 2],
        seen: &mut State<R>,
        captured: &mut R::Mask,
    ) {
        let counts = R::from_f64(f64::from(self.counts_per_step));
        // counts from the frame to the end of this step: within it if 0 <= counts < counts_per_step
        let left = R::from_f64(f64::from(self.counts_per_step * step)) - until_frame;
        let now = R::zero().le(left) & left.lt(counts);
        if R::any(now) {
            let here =
                from.look_back(to, left * R::from_f64(1.0 / f64::from(self.counts_per_step)), self.h_s);
            *seen = if R::any(*captured) { seen.merge(now, &here) } else { here };
            *captured = *captured | now;
        }
    }

    /// Gives a tick's frame to the controller and returns when the next one is due.
    #[inline(always)]
    pub(super) fn deliver<R: Scalar>(
        &self,
        captured: R::Mask,
        frame: &Frame<R>,
        t: &mut Tile<R>,
    ) -> PoseFix<R> {
        t.fix.deliver(frame.captured, frame.pos_m, frame.yaw_rad, frame.t_s, frame.markers);
        let more = R::select(captured, R::from_f64(f64::from(self.schedule.camera)), R::zero());
        t.until_frame = t.until_frame + more - R::from_f64(f64::from(self.schedule.control));
        t.fix
    }
}
