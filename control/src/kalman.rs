//! Better localisation for any controller: the marker's pose in its observation is replaced by the filter's.

use super::batch::{check, mask, rows, write};
use super::belief::Belief;
use super::estimator::Estimator;
use super::{Controller, Mode, Site};
use crazyflie_env::error::Result;
use crazyflie_env::lanes::{LANES, Lanes};
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::real::Real;

/// A controller that sees the filter's estimate, new at every tick, where the marker's last pose was.
pub(super) struct Filtered {
    tiles: Vec<Estimator<Lanes>>,
    inner: Box<dyn Controller>,
    envs: usize,
    rows: Vec<f32>,
}

impl Filtered {
    pub(super) fn new(inner: Box<dyn Controller>, site: &Site<'_>, belief: &Belief) -> Self {
        let estimator = Estimator::new(site.model, site.interface.input, site.tick_s, belief);
        Filtered { tiles: vec![estimator; site.envs.div_ceil(LANES)], inner, envs: site.envs, rows: vec![0.0; site.envs * OBSERVATION] }
    }
}

impl Controller for Filtered {
    fn set_mode(&mut self, mode: Mode) {
        self.inner.set_mode(mode);
    }

    fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        for (tile, estimator) in self.tiles.iter_mut().enumerate() {
            estimator.reset(mask(tile, self.envs, of));
        }
        self.inner.reset(of);
    }

    fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        check(self.envs, observations, actions)?;
        self.rows.copy_from_slice(observations);
        for (estimator, seen) in self.tiles.iter_mut().zip(self.rows.chunks_mut(LANES * OBSERVATION)) {
            let e = estimator.update(&rows(seen));
            let [x, y, z] = e.pos_m;
            // as good as a fix of this very moment
            write(&[x, y, z, e.yaw_rad, Lanes::zero(), Lanes::of(1.0)], seen, OBSERVATION);
        }
        self.inner.act(&self.rows, actions)
    }
}
