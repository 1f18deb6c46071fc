//! Landing: the set-point's height goes to the floor, slower the nearer, and the motors are cut when the legs touch.

use super::batch::rows;
use super::edited::RowEdit;
use super::{ControllerContext, Mode};
use crazyflie_env::action::ACTION;
use crazyflie_env::lanes::{LaneMask, Lanes};
use crazyflie_env::observation::{OBSERVATION, index};
use crazyflie_env::scalar::Scalar;

/// Sinking speed per metre of height, and its limits.
pub(super) const SINK_PS: f64 = 1.5;
pub(super) const SINK_MPS: [f64; 2] = [0.15, 0.7];
/// Motors off below this.
pub(super) const TOUCH_M: f64 = 0.01;
/// The set-point goes on this far below the floor: an estimate that hangs above it has to be brought down as
/// well.
pub(super) const BELOW_M: f64 = 0.1;

/// The landing of one drone, or of lanes.
#[derive(Debug, Clone)]
pub(super) struct Landing<R: Scalar> {
    mode: Mode,
    tick_s: f64,
    /// The set-point's height during the landing.
    height_m: R,
    sinking: R::Mask,
    /// Landed: motors off.
    pub idle: R::Mask,
}

impl<R: Scalar> Landing<R> {
    pub(super) fn new(mode: Mode, tick_s: f64) -> Self {
        Landing { mode, tick_s, height_m: R::zero(), sinking: R::nothing(), idle: R::nothing() }
    }

    pub(super) fn set_mode(&mut self, mode: Mode) {
        self.mode = mode;
    }

    /// Returns the height set-point, given that of the task; lanes of `fresh` begin an episode.
    #[inline(always)]
    pub(super) fn target(&mut self, fresh: R::Mask, wanted_m: R, height_m: R) -> R {
        self.idle = self.idle & !fresh;
        self.sinking = self.sinking & !fresh;
        if self.mode != Mode::Landing {
            self.sinking = R::nothing();
            self.idle = R::nothing();
            return wanted_m;
        }
        let from = R::select(self.sinking, self.height_m, height_m);
        self.sinking = !R::nothing();
        let sink = (R::from_f64(SINK_PS) * from).clamp(R::from_f64(SINK_MPS[0]), R::from_f64(SINK_MPS[1]));
        self.height_m = (from - sink * R::from_f64(self.tick_s)).max(R::from_f64(-BELOW_M));
        self.idle = self.idle | height_m.le(R::from_f64(TOUCH_M));
        self.height_m
    }
}

/// Lands a controller that only follows set-points: it lowers the set-point, and cuts the motors on the floor.
#[derive(Clone)]
pub(super) struct SetpointLanding {
    landing: Landing<Lanes>,
    fresh: LaneMask,
    /// The action that sets every channel to zero.
    off: [f32; ACTION],
}

impl SetpointLanding {
    pub(super) fn new(site: &ControllerContext<'_>) -> Self {
        let zero = |[low, high]: [f64; 2]| ((-low / (high - low)).clamp(0.0, 1.0) * 2.0 - 1.0) as f32;
        SetpointLanding {
            landing: Landing::new(site.mode, site.tick_s),
            fresh: !Lanes::nothing(),
            off: site.interface.ranges().map(zero),
        }
    }
}

impl RowEdit for SetpointLanding {
    fn set_mode(&mut self, mode: Mode) {
        self.landing.set_mode(mode);
    }

    fn reset(&mut self, mask: LaneMask) {
        self.fresh = self.fresh | mask;
    }

    fn edit(&mut self, seen: &mut [f32]) {
        let o = rows(seen);
        let height = self.landing.target(self.fresh, o[index::SETPOINT_Z], o[index::MARKER_Z]);
        self.fresh = Lanes::nothing();
        for (row, height) in seen.chunks_exact_mut(OBSERVATION).zip(height.array()) {
            row[index::SETPOINT_Z] = *height;
        }
    }

    fn finish(&self, actions: &mut [f32]) {
        for (lane, row) in actions.chunks_exact_mut(ACTION).enumerate() {
            if self.landing.idle.bits() >> lane & 1 == 1 {
                row.copy_from_slice(&self.off);
            }
        }
    }
}
