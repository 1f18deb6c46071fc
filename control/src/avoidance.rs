//! Collision avoidance: a filter of set-points between a mission and the controller that flies the drone.

use serde::{Deserialize, Serialize};

use crazyflie_env::coupling::NEIGHBOUR;
use crazyflie_env::error::Result;
use crazyflie_env::error::check_range;
use crazyflie_env::scalar::Scalar;

/// A filter of least intervention: a set-point passes unchanged unless the drone would come too near another.
///
/// A drone on a course of collision gives way: its set-point comes near, and moves away and aside from where both
/// drones will be nearest, all to the same side (De Luca and Oriolo 1994), so that no two block each other. The
/// set-point is then projected into the half spaces in which both drones can still brake: barriers as of Wang, Ames
/// and Egerstedt 2017 (IEEE Trans. Robotics 33(3)), cut in the middle as the buffered Voronoi cells of Zhou et al. 2017
/// (IEEE Robotics and Automation Letters 2(2)).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CollisionAvoidance {
    /// Two drones whose predicted nearest distance is below this give way.
    pub clearance_m: f64,
    /// Their motion is extended so far.
    pub horizon_s: f64,
    /// Others farther than this count less, by their distance.
    pub reach_m: f64,
    /// Distance of the set-point from a drone that gives way fully.
    pub leash_m: f64,
    /// Shift of the set-point away from another drone on a course of full collision.
    pub push_m: f64,
    /// Shift of the set-point aside.
    pub vortex_m: f64,
    /// Set-points lead no two drones nearer than this.
    pub least_m: f64,
    /// Deceleration that a drone surely reaches.
    pub braking_mps2: f64,
    /// Time until it brakes.
    pub delay_s: f64,
}

impl Default for CollisionAvoidance {
    fn default() -> Self {
        CollisionAvoidance {
            clearance_m: 0.33,
            horizon_s: 1.3,
            reach_m: 0.85,
            leash_m: 0.95,
            push_m: 1.3,
            vortex_m: 0.8,
            least_m: 0.12,
            braking_mps2: 3.0,
            delay_s: 0.12,
        }
    }
}

/// Projections into all half spaces, one after the other.
const SWEEPS: usize = 2;

impl CollisionAvoidance {
    /// # Errors
    /// [`crazyflie_env::Error::Range`].
    pub fn check(&self) -> Result<()> {
        check_range("avoid.clearance_m", self.clearance_m, 0.05, 10.0)?;
        check_range("avoid.horizon_s", self.horizon_s, 0.0, 10.0)?;
        check_range("avoid.reach_m", self.reach_m, 0.05, 10.0)?;
        check_range("avoid.leash_m", self.leash_m, 0.05, 10.0)?;
        check_range("avoid.push_m", self.push_m, 0.0, 10.0)?;
        check_range("avoid.vortex_m", self.vortex_m, 0.0, 10.0)?;
        check_range("avoid.least_m", self.least_m, 0.0, 10.0)?;
        check_range("avoid.braking_mps2", self.braking_mps2, 0.1, 100.0)?;
        check_range("avoid.delay_s", self.delay_s, 0.0, 10.0).map(drop)
    }

    /// Returns the change of the set-point that lies at `target_m` from the drone, zeros where nothing is near; `others`
    /// are the observation's blocks of neighbours.
    #[inline(always)]
    pub fn filter<R: Scalar>(&self, target_m: [R; 3], others: &[[R; NEIGHBOUR]]) -> [R; 3] {
        let mut lead_m = limited(target_m, self.leash_m);
        for other in others {
            for (lead, shift) in lead_m.iter_mut().zip(self.give_way(other)) {
                *lead += shift;
            }
        }
        for _ in 0..SWEEPS {
            for other in others {
                self.project(&mut lead_m, other);
            }
        }
        [lead_m[0] - target_m[0], lead_m[1] - target_m[1], lead_m[2] - target_m[2]]
    }

    /// Returns the shift of the set-point because of one of the others.
    #[inline(always)]
    fn give_way<R: Scalar>(&self, [x, y, z, vx, vy, vz, _, valid]: &[R; NEIGHBOUR]) -> [R; 3] {
        let (x, y, z, vx, vy, vz) = (*x, *y, *z, *vx, *vy, *vz);
        let speed2 = vx * vx + vy * vy + vz * vz + R::from_f64(1e-4);
        let soon_s = (-(x * vx + y * vy + z * vz) / speed2).clamp(R::zero(), R::from_f64(self.horizon_s));
        let [cx, cy, cz] = [x + soon_s * vx, y + soon_s * vy, z + soon_s * vz];
        let then_m = (cx * cx + cy * cy + cz * cz).sqrt();
        let per_m = R::from_f64(1.0) / distance([x, y, z]);
        let nearness = (R::from_f64(self.reach_m) * per_m).min(R::from_f64(1.0));
        let short = (R::from_f64(1.0) - then_m * R::from_f64(1.0 / self.clearance_m)).max(R::zero());
        let danger = *valid * nearness * short;
        let (away, aside) =
            (danger * per_m * R::from_f64(self.push_m), danger * per_m * R::from_f64(self.vortex_m));
        [aside * y - away * x, -aside * x - away * y, -away * z]
    }

    /// Projects the set-point into the half space in which the drone and one of the others can still brake.
    #[inline(always)]
    fn project<R: Scalar>(&self, lead_m: &mut [R; 3], [x, y, z, vx, vy, vz, _, valid]: &[R; NEIGHBOUR]) {
        let gap_m = distance([*x, *y, *z]);
        let per_m = R::from_f64(1.0) / gap_m;
        let [nx, ny, nz] = [*x * per_m, *y * per_m, *z * per_m];
        let closing = (-(nx * *vx + ny * *vy + nz * *vz)).max(R::zero());
        let braking_m =
            closing * (closing * R::from_f64(0.5 / self.braking_mps2) + R::from_f64(self.delay_s));
        let free_m = R::from_f64(0.5) * (gap_m - braking_m - R::from_f64(self.least_m));
        let over_m = *valid * (nx * lead_m[0] + ny * lead_m[1] + nz * lead_m[2] - free_m).max(R::zero());
        for (lead, n) in lead_m.iter_mut().zip([nx, ny, nz]) {
            *lead -= over_m * n;
        }
    }
}

/// The length of a vector, at least 1 mm.
#[inline(always)]
fn distance<R: Scalar>([x, y, z]: [R; 3]) -> R {
    (x * x + y * y + z * z).sqrt().max(R::from_f64(1e-3))
}

/// A vector of at most this length.
#[inline(always)]
fn limited<R: Scalar>(v: [R; 3], most: f64) -> [R; 3] {
    let share = (R::from_f64(most) / distance(v)).min(R::from_f64(1.0));
    [v[0] * share, v[1] * share, v[2] * share]
}
