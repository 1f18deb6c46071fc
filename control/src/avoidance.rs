//! Collision avoidance: a layer between the set-points of a mission and the controller that flies the drone.

use serde::{Deserialize, Serialize};

use crazyflie_env::coupling::NEIGHBOUR;
use crazyflie_env::error::Result;
use crazyflie_env::error::check_range;
use crazyflie_env::scalar::Scalar;

/// An artificial potential (Khatib 1986, Int. J. Robotics Research 5(1)) about where two drones will be nearest, with
/// a vortex about each of the others so that all pass on the same side instead of blocking each other face to face
/// (De Luca and Oriolo 1994). The fields move a set-point of the drone's own, which follows the mission's at a
/// limited speed: that is what the controller flies to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CollisionAvoidance {
    /// Speed of the set-point.
    pub speed_mps: f64,
    /// The set-point is never farther from the drone than this.
    pub leash_m: f64,
    /// Others are felt within this.
    pub range_m: f64,
    /// Strength of the push away, and of the turn aside, at no distance.
    pub push_mps: f64,
    /// Speed at which they turn aside, at no distance.
    pub vortex_mps: f64,
    /// So far the motion of both is extended.
    pub horizon_s: f64,
}

impl Default for CollisionAvoidance {
    fn default() -> Self {
        CollisionAvoidance {
            speed_mps: 0.5,
            leash_m: 0.5,
            range_m: 0.8,
            push_mps: 1.0,
            vortex_mps: 0.6,
            horizon_s: 1.0,
        }
    }
}

impl CollisionAvoidance {
    /// # Errors
    /// [`crazyflie_env::Error::Range`].
    pub fn check(&self) -> Result<()> {
        check_range("avoid.speed_mps", self.speed_mps, 0.01, 10.0)?;
        check_range("avoid.leash_m", self.leash_m, 0.05, 10.0)?;
        check_range("avoid.range_m", self.range_m, 0.05, 10.0)?;
        check_range("avoid.push_mps", self.push_mps, 0.0, 10.0)?;
        check_range("avoid.vortex_mps", self.vortex_mps, 0.0, 10.0)?;
        check_range("avoid.horizon_s", self.horizon_s, 0.0, 10.0).map(drop)
    }

    /// Move the set-point `at_m` on by `dt_s`, towards `target_m`, for a drone at `own_m`; `others` are the
    /// observation's blocks of neighbours.
    #[inline(always)]
    pub fn advance<R: Scalar>(
        &self,
        at_m: &mut [R; 3],
        own_m: [R; 3],
        target_m: [R; 3],
        dt_s: f64,
        others: impl Iterator<Item = [R; NEIGHBOUR]>,
    ) {
        // as fast as it may be, but not past the target
        let mut speed_mps =
            limited([0, 1, 2].map(|i| (target_m[i] - at_m[i]) * R::from_f64(1.0 / dt_s)), self.speed_mps);
        for other in others {
            for (speed, more) in speed_mps.iter_mut().zip(self.field(other)) {
                *speed += more;
            }
        }
        let speed_mps = limited(speed_mps, self.speed_mps);
        let led =
            limited([0, 1, 2].map(|i| at_m[i] + speed_mps[i] * R::from_f64(dt_s) - own_m[i]), self.leash_m);
        for i in 0..3 {
            at_m[i] = own_m[i] + led[i];
        }
    }

    /// Returns the contribution of one of the others.
    #[inline(always)]
    fn field<R: Scalar>(&self, [x, y, z, vx, vy, vz, _, valid]: [R; NEIGHBOUR]) -> [R; 3] {
        let closing = -(x * vx + y * vy + z * vz);
        let speed2 = vx * vx + vy * vy + vz * vz + R::from_f64(1e-4);
        let soon_s = (closing / speed2).clamp(R::zero(), R::from_f64(self.horizon_s));
        let [cx, cy, cz] = [x + soon_s * vx, y + soon_s * vy, z + soon_s * vz];
        let now_m = (x * x + y * y + z * z).sqrt();
        let then_m = (cx * cx + cy * cy + cz * cz).sqrt();
        // who is near now counts, and who will be
        let felt = (R::from_f64(0.5) * (now_m + then_m)).min(R::from_f64(self.range_m));
        let near = valid * (R::from_f64(1.0) - felt * R::from_f64(1.0 / self.range_m));
        let away = near * R::from_f64(self.push_mps) / now_m.max(R::from_f64(0.05));
        let aside = near * R::from_f64(self.vortex_mps) / now_m.max(R::from_f64(0.05));
        [aside * y - away * x, -aside * x - away * y, -away * z]
    }
}

/// A vector of at most this length.
#[inline(always)]
fn limited<R: Scalar>([x, y, z]: [R; 3], most: f64) -> [R; 3] {
    let length = (x * x + y * y + z * z + R::from_f64(1e-12)).sqrt();
    let share = (R::from_f64(most) / length).min(R::from_f64(1.0));
    [x * share, y * share, z * share]
}
