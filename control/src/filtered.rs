//! Better localisation for any controller: the marker's pose in its observation is replaced by the filter's.

use super::batch::{check, mask, rows, write};
use super::{Beside, Controller, ControllerContext, Mode, Needs};
use crazyflie_env::error::Result;
use crazyflie_env::estimator::Estimator;
use crazyflie_env::estimator::SensorNoise;
use crazyflie_env::lanes::{LANES, Lanes};
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::scalar::Scalar;

/// A controller that sees the filter's estimate, new at every tick, where the marker's last pose was.
pub(super) struct FilteredController {
    tiles: Vec<Estimator<Lanes>>,
    inner: Box<dyn Controller>,
    envs: usize,
    rows: Vec<f32>,
}

impl FilteredController {
    pub(super) fn new(
        inner: Box<dyn Controller>,
        site: &ControllerContext<'_>,
        belief: &SensorNoise,
    ) -> Self {
        let estimator = Estimator::new(site.model, site.interface.input, site.tick_s, belief);
        FilteredController {
            tiles: vec![estimator; site.envs.div_ceil(LANES)],
            inner,
            envs: site.envs,
            rows: vec![0.0; site.envs * OBSERVATION],
        }
    }
}

impl Controller for FilteredController {
    fn set_mode(&mut self, mode: Mode) {
        self.inner.set_mode(mode);
    }

    fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        for (tile, estimator) in self.tiles.iter_mut().enumerate() {
            estimator.reset(mask(tile, self.envs, of));
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
        check(self.envs, observations, actions)?;
        self.rows.copy_from_slice(observations);
        for (estimator, seen) in self.tiles.iter_mut().zip(self.rows.chunks_mut(LANES * OBSERVATION)) {
            let e = estimator.update(&rows(seen));
            let [x, y, z] = e.pos_m;
            // as good as a fix of this very moment
            write(&[x, y, z, e.yaw_rad, Lanes::zero(), Lanes::from_f64(1.0)], seen, OBSERVATION);
        }
        self.inner.act(&self.rows, actions)
    }
}
