//! Collision avoidance: a filter of set-points between a mission and the controller that flies the drone.

use serde::{Deserialize, Serialize};

use crazyflie_env::coupling::NEIGHBOUR;
use crazyflie_env::error::Result;
use crazyflie_env::error::check_range;
use crazyflie_env::scalar::Scalar;

/// A filter of least intervention: a set-point passes unchanged unless the drone would come too near another.
///
/// A set-point that is far comes nearer, with damping, which a set-point that moves with the drone would take from the
/// controller. On a course of collision it moves away and aside from the other drone, all to the same side (De Luca and
/// Oriolo 1994), so that no two block each other. It is then projected into the half spaces in which both drones can
/// still brake: barriers as of Wang, Ames and Egerstedt 2017 (IEEE Trans. Robotics 33(3)), cut in the middle as the
/// buffered Voronoi cells of Zhou et al. 2017 (IEEE Robotics and Automation Letters 2(2)).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CollisionAvoidance {
    /// Two drones whose predicted nearest distance is below this give way.
    pub clearance_m: f64,
    /// Their motion is extended so far.
    pub horizon_s: f64,
    /// Others farther than this count less, by their distance.
    pub reach_m: f64,
    /// The set-point leads the drone sideways by no more than this.
    pub leash_m: f64,
    /// The height of the set-point changes by no more than this.
    pub climb_m: f64,
    /// The set-point of a drone that gives way, or that is led, falls back by its velocity times this.
    pub damping_s: f64,
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

/// Found by searches over swap, formation, follow and carry by LQR and by the thesis's PID on the seeds from 1, 5000 and
/// 20000: no collisions first, then arrivals and returns. `python_client/bench_avoidance.py` judges on others.
impl Default for CollisionAvoidance {
    fn default() -> Self {
        CollisionAvoidance {
            clearance_m: 0.25,
            horizon_s: 0.35,
            reach_m: 0.67,
            leash_m: 0.9,
            climb_m: 0.35,
            damping_s: 0.5,
            push_m: 1.0,
            vortex_m: 0.9,
            least_m: 0.2,
            braking_mps2: 0.66,
            delay_s: 0.14,
        }
    }
}

/// Projections into all half spaces, one after the other.
const SWEEPS: usize = 2;
/// Full damping at this danger, and from this distance beyond the leash.
const DAMPED_DANGER: f64 = 0.125;
const DAMPED_M: f64 = 0.2;
/// Time constant of the drone's velocity.
const VELOCITY_S: f64 = 0.15;
/// A measured position that jumps farther between two ticks is another flight or another fix.
const JUMP_M: f64 = 0.3;

/// The motion of one drone, or of lanes, by its measured positions.
#[derive(Debug, Clone, Copy)]
pub struct MeasuredMotion<R: Scalar> {
    pos_m: [R; 3],
    vel_mps: [R; 3],
    fresh: R::Mask,
}

impl<R: Scalar> MeasuredMotion<R> {
    pub(super) fn new() -> Self {
        MeasuredMotion { pos_m: [R::zero(); 3], vel_mps: [R::zero(); 3], fresh: !R::nothing() }
    }

    pub(super) fn reset(&mut self, mask: R::Mask) {
        self.fresh = self.fresh | mask;
    }

    /// Takes the next position.
    #[inline(always)]
    fn update(&mut self, pos_m: [R; 3], dt_s: f64) {
        let step_m = [0, 1, 2].map(|i| pos_m[i] - self.pos_m[i]);
        let known = distance(step_m).lt(R::from_f64(JUMP_M)) & !self.fresh;
        let share = R::from_f64(dt_s / VELOCITY_S);
        for (vel, step) in self.vel_mps.iter_mut().zip(step_m) {
            let next = *vel + share * (step * R::from_f64(1.0 / dt_s) - *vel);
            *vel = R::select(known, next, R::zero());
        }
        (self.pos_m, self.fresh) = (pos_m, R::nothing());
    }
}

impl CollisionAvoidance {
    /// # Errors
    /// [`crazyflie_env::Error::Range`].
    pub fn check(&self) -> Result<()> {
        check_range("avoid.clearance_m", self.clearance_m, 0.05, 10.0)?;
        check_range("avoid.horizon_s", self.horizon_s, 0.0, 10.0)?;
        check_range("avoid.reach_m", self.reach_m, 0.05, 10.0)?;
        check_range("avoid.leash_m", self.leash_m, 0.05, 10.0)?;
        check_range("avoid.climb_m", self.climb_m, 0.0, 10.0)?;
        check_range("avoid.damping_s", self.damping_s, 0.0, 10.0)?;
        check_range("avoid.push_m", self.push_m, 0.0, 10.0)?;
        check_range("avoid.vortex_m", self.vortex_m, 0.0, 10.0)?;
        check_range("avoid.least_m", self.least_m, 0.0, 10.0)?;
        check_range("avoid.braking_mps2", self.braking_mps2, 0.1, 100.0)?;
        check_range("avoid.delay_s", self.delay_s, 0.0, 10.0).map(drop)
    }

    /// Returns the change of the set-point `target_m` of a drone at `own_m`, zeros where nothing is near and the set-point
    /// is not far; `others` are the observation's blocks of neighbours, `dt_s` passes between two calls.
    #[inline(always)]
    pub fn filter<R: Scalar>(
        &self,
        motion: &mut MeasuredMotion<R>,
        own_m: [R; 3],
        target_m: [R; 3],
        others: &[[R; NEIGHBOUR]],
        dt_s: f64,
    ) -> [R; 3] {
        motion.update(own_m, dt_s);
        let offset_m = [0, 1, 2].map(|i| target_m[i] - own_m[i]);
        let (mut lead_m, mut danger) = (limited_sideways(offset_m, self.leash_m), R::zero());
        for other in others {
            let (shift_m, more) = self.give_way(other);
            danger += more;
            for (lead, shift) in lead_m.iter_mut().zip(shift_m) {
                *lead += shift;
            }
        }
        let [x, y, _] = offset_m;
        let beyond_m = distance([x, y, R::zero()]) - R::from_f64(self.leash_m);
        let led =
            danger * R::from_f64(1.0 / DAMPED_DANGER) + beyond_m.max(R::zero()) * R::from_f64(1.0 / DAMPED_M);
        let back_s = led.min(R::from_f64(1.0)) * R::from_f64(self.damping_s);
        for axis in 0..2 {
            lead_m[axis] -= back_s * motion.vel_mps[axis];
        }
        let mut lead_m = limited_sideways(lead_m, self.leash_m);
        for _ in 0..SWEEPS {
            for other in others {
                self.project(&mut lead_m, other);
            }
        }
        let [x, y, z] = [0, 1, 2].map(|i| lead_m[i] - offset_m[i]);
        let climb_m = R::from_f64(self.climb_m);
        [x, y, z.clamp(-climb_m, climb_m)]
    }

    /// Returns the shift of the set-point because of one of the others, and the danger from 0 to 1.
    #[inline(always)]
    fn give_way<R: Scalar>(&self, [x, y, z, vx, vy, vz, _, valid]: &[R; NEIGHBOUR]) -> ([R; 3], R) {
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
        ([aside * y - away * x, -aside * x - away * y, -away * z], danger)
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

/// A vector whose sideways part has at most this length.
#[inline(always)]
fn limited_sideways<R: Scalar>([x, y, z]: [R; 3], most: f64) -> [R; 3] {
    let share = (R::from_f64(most) / distance([x, y, R::zero()])).min(R::from_f64(1.0));
    [x * share, y * share, z]
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.02;

    /// The change for a drone at the origin that sees one other, after it has moved along x at `speed_mps`.
    fn change(target_m: [f64; 3], speed_mps: f64, other: [f64; NEIGHBOUR]) -> [f64; 3] {
        let (avoid, mut motion) = (CollisionAvoidance::default(), MeasuredMotion::new());
        for tick in -100..0 {
            motion.update([f64::from(tick) * DT_S * speed_mps, 0.0, 0.0], DT_S);
        }
        avoid.filter(&mut motion, [0.0; 3], target_m, &[other], DT_S)
    }

    #[test]
    fn a_set_point_passes_unchanged_beside_a_drone_that_flies_along() {
        for gap_m in [0.45, 0.6, 3.0] {
            let beside = [0.0, gap_m, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
            assert_eq!(change([0.8, 0.0, 0.1], 0.7, beside), [0.0; 3], "{gap_m} m");
        }
        // an unknown neighbour changes nothing
        assert_eq!(change([0.8, 0.0, 0.1], 0.7, [0.0; NEIGHBOUR]), [0.0; 3]);
    }

    #[test]
    fn two_that_fly_at_each_other_stop_in_time_and_pass_on_the_same_side() {
        let avoid = CollisionAvoidance::default();
        for closing in [0.2, 0.5, 1.0] {
            let head_on = [0.6, 0.0, 0.0, -closing, 0.0, 0.0, 0.0, 1.0];
            let target_m = [0.8, 0.0, 0.0];
            let [x, y, z] = change(target_m, 0.5 * closing, head_on);
            let braking_m = closing * (0.5 * closing / avoid.braking_mps2 + avoid.delay_s);
            assert!(target_m[0] + x <= 0.5 * (0.6 - braking_m - avoid.least_m) + 1e-12, "{closing} m/s");
            assert!(y <= 0.0 && z == 0.0, "{closing} m/s: {y} {z}");
        }
        // to the right of where it flies, whatever that direction is: both give way to their own right
        let fast = change([0.8, 0.0, 0.0], 0.5, [0.3, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0]);
        let other = change([-0.8, 0.0, 0.0], -0.5, [-0.3, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        assert!(fast[1] < -0.1 && (fast[1] + other[1]).abs() < 1e-12, "{fast:?} {other:?}");
    }

    #[test]
    fn a_far_set_point_is_led_with_damping() {
        let (avoid, alone) = (CollisionAvoidance::default(), [0.0; NEIGHBOUR]);
        let lead = |speed_mps| 3.0 + change([3.0, 0.0, 0.0], speed_mps, alone)[0];
        assert!((lead(0.0) - avoid.leash_m).abs() < 1e-12);
        assert!((lead(1.0) - (avoid.leash_m - avoid.damping_s)).abs() < 1e-2, "{}", lead(1.0));
    }
}
