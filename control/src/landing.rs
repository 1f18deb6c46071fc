//! Landing: the set-point's height goes to the floor, slower the nearer, and the motors are cut when the legs touch.

use super::batch::{check, mask};
use super::observing::{Beside, Needs};
use super::{Controller, ControllerContext, Mode};
use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::error::Result;
use crazyflie_env::lanes::{LANES, LaneMask, Lanes};
use crazyflie_env::observation::{OBSERVATION, index};
use crazyflie_env::plant::Command;
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
pub(super) struct LandingController {
    inner: Box<dyn Controller>,
    interface: Interface,
    mode: Mode,
    tiles: Vec<Landing<Lanes>>,
    fresh: Vec<LaneMask>,
    rows: Vec<f32>,
}

impl LandingController {
    pub(super) fn new(inner: Box<dyn Controller>, site: &ControllerContext<'_>) -> Self {
        let tiles = site.envs.div_ceil(LANES);
        LandingController {
            inner,
            interface: site.interface,
            mode: site.mode,
            tiles: vec![Landing::new(site.mode, site.tick_s); tiles],
            fresh: vec![!Lanes::nothing(); tiles],
            rows: vec![0.0; site.envs * OBSERVATION],
        }
    }

    /// Environments of the whole batch.
    fn envs(&self) -> usize {
        self.rows.len() / OBSERVATION
    }

    /// Lowers the set-points.
    fn sink(&mut self) {
        let tiles = self.tiles.iter_mut().zip(&mut self.fresh).zip(self.rows.chunks_mut(LANES * OBSERVATION));
        for ((landing, fresh), rows) in tiles {
            let column = |at: usize| {
                let mut lanes = Lanes::zero();
                for (slot, row) in lanes.array_mut().iter_mut().zip(rows.chunks_exact(OBSERVATION)) {
                    *slot = row[at];
                }
                lanes
            };
            let height = landing.target(*fresh, column(index::SETPOINT_Z), column(index::MARKER_Z));
            *fresh = Lanes::nothing();
            for (row, height) in rows.chunks_exact_mut(OBSERVATION).zip(height.array()) {
                row[index::SETPOINT_Z] = *height;
            }
        }
    }
}

impl Controller for LandingController {
    fn set_mode(&mut self, mode: Mode) {
        self.mode = mode;
        self.tiles.iter_mut().for_each(|landing| landing.set_mode(mode));
        self.inner.set_mode(mode);
    }

    fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        let envs = self.envs();
        for (tile, fresh) in self.fresh.iter_mut().enumerate() {
            *fresh = *fresh | mask(tile, envs, of);
        }
        self.inner.reset(of);
    }

    fn needs(&self) -> Needs {
        self.inner.needs()
    }

    fn tell(&mut self, beside: Beside<'_>) {
        self.inner.tell(beside);
    }

    fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        check(self.envs(), observations, actions)?;
        self.rows.copy_from_slice(observations);
        self.sink();
        self.inner.act(&self.rows, actions)?;
        if self.mode == Mode::Landing {
            let off = self.interface.action(&Command::level(0.0)).map(|number: f64| number as f32);
            for (landing, rows) in self.tiles.iter().zip(actions.chunks_mut(LANES * ACTION)) {
                for (lane, row) in rows.chunks_exact_mut(ACTION).enumerate() {
                    if landing.idle.bits() >> lane & 1 == 1 {
                        row.copy_from_slice(&off);
                    }
                }
            }
        }
        Ok(())
    }
}
