//! Everybody to the opposite side, through the middle.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::Deserialize;

use super::{GOAL, Scene, Start, Task, jitter, on_circle, room_on_circle, start_at};
use crate::error::{Result, check_range};
use crate::observation::Setpoint;
use crate::scalar::Scalar;

/// Options of the swap.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Of the circle that they stand on.
    pub radius_m: f64,
    pub height_m: f64,
    /// Wait in place before the swap begins.
    pub wait_s: f64,
    /// Each start is off its place by at most this, and the circle is turned at random.
    pub jitter_m: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { radius_m: 1.2, height_m: 0.8, wait_s: 1.0, jitter_m: 0.05 }
    }
}

pub struct Swap(Options);

impl Task for Swap {
    const NAME: &'static str = "swap";
    const ID: &'static str = "CrazyflieSwap-v0";
    const ABOUT: &'static str = "Drones on a circle change to the opposite places, all at once, straight through the middle unless they avoid each other";
    const REWARD: &'static str = "closeness - 0.05 jerk to the new place, as for hover; -10 for a collision, a crash or leaving the room, which end a drone's flight";
    const MAX_EPISODE_STEPS: u32 = 1000;
    const DRONES: usize = 8;
    type Options = Options;

    fn new(o: Options, drones: usize) -> Result<Self> {
        check_range("radius_m", o.radius_m, 0.2, 2.2)?;
        check_range("height_m", o.height_m, 0.2, 2.5)?;
        check_range("wait_s", o.wait_s, 0.0, 60.0)?;
        check_range("jitter_m", o.jitter_m, 0.0, 0.2)?;
        room_on_circle("radius_m", o.radius_m, drones, 0.15 + 2.0 * o.jitter_m)?;
        Ok(Swap(o))
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], _: &mut [f64]) {
        let (o, n) = (&self.0, starts.len());
        let turned = std::f64::consts::TAU * rng.random::<f64>();
        for (i, start) in starts.iter_mut().enumerate() {
            let [x, y] = on_circle(i, n, o.radius_m, turned);
            let [dx, dy, dz] = jitter(rng, o.jitter_m);
            *start = start_at([x + dx, y + dy, o.height_m + dz], &[x, y]);
        }
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, _: usize, goal: &mut [R; GOAL], _: &[R], scene: &Scene<R>) -> Setpoint<R> {
        // half a millisecond of margin for the clock's rounding
        let side =
            R::select(scene.t_s.lt(R::from_f64(self.0.wait_s - 5e-4)), R::from_f64(1.0), R::from_f64(-1.0));
        Setpoint { pos_m: [side * goal[0], side * goal[1], R::from_f64(self.0.height_m)], yaw_rad: R::zero() }
    }
}
