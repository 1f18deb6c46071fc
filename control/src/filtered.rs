//! Better localisation for any controller: the marker's pose in its observation is replaced by the filter's.

use super::batch::{rows, write};
use super::edited::RowEdit;
use crazyflie_env::estimator::Estimator;
use crazyflie_env::lanes::{LaneMask, Lanes};
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::scalar::Scalar;

/// Puts the filter's estimate, new at every tick, where the marker's last pose was.
impl RowEdit for Estimator<Lanes> {
    fn reset(&mut self, mask: LaneMask) {
        Estimator::reset(self, mask);
    }

    fn edit(&mut self, seen: &mut [f32]) {
        let e = self.update(&rows(seen));
        let [x, y, z] = e.pos_m;
        // the estimate replaces a camera fix without age
        write(&[x, y, z, e.yaw_rad, Lanes::zero(), Lanes::from_f64(1.0)], seen, OBSERVATION);
    }
}
