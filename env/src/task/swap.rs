//! Everybody to the opposite side, through the middle.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::{Chosen, GOAL, Scene, Start, Task, jitter, on_circle, options, room_on_circle, start_at};
use crate::error::Result;
use crate::observation::Setpoint;
use crate::scalar::Scalar;

options! {
    drawn radius_m: f64 = 1.2, "m", [0.2, 2.2], "radius of their circle; many drones widen it";
    drawn height_m: f64 = 0.8, "m", [0.2, 2.5], "height of the circle";
    drawn wait_s: f64 = 1.0, "s", [0.0, 60.0], "time in place before the swap begins";
    drawn jitter_m: f64 = 0.05, "m", [0.0, 0.2], "most that a start is off its place along each axis; many drones shrink it";
}

pub struct Swap(Chosen<Options>);

/// Between the starts of neighbours, at least: two propellers' tips.
const GAP_M: f64 = 0.15;

impl Task for Swap {
    const NAME: &'static str = "swap";
    const ID: &'static str = "CrazyflieSwap-v0";
    const ABOUT: &'static str = "Drones on a circle change to the opposite places, all at once, straight through the middle unless they avoid each other";
    const REWARD: &'static str = "closeness - 0.05 jerk to the new place; ends and -10 as for formation";
    const MAX_EPISODE_STEPS: u32 = 1000;
    const DRONES: usize = 8;
    type Options = Options;

    fn new(mut chosen: Chosen<Options>, drones: usize) -> Result<Self> {
        make_room(&mut chosen, drones);
        for o in chosen.corners() {
            room_on_circle("radius_m", o.radius_m, drones, GAP_M + 2.0 * o.jitter_m)?;
        }
        Ok(Swap(chosen))
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], _: &mut [f64]) {
        let (o, n) = (self.0.draw(rng), starts.len());
        let turned = std::f64::consts::TAU * rng.random::<f64>();
        for (i, start) in starts.iter_mut().enumerate() {
            let [x, y] = on_circle(i, n, o.radius_m, turned);
            let [dx, dy, dz] = jitter(rng, o.jitter_m);
            *start = start_at(
                [x + dx, y + dy, o.height_m + dz],
                // half a millisecond of margin for the clock's rounding
                &[x, y, o.height_m, o.wait_s - 5e-4],
            );
        }
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, _: usize, goal: &mut [R; GOAL], scene: &Scene<R>) -> Setpoint<R> {
        let side = R::select(scene.t_s.lt(goal[3]), R::from_f64(1.0), R::from_f64(-1.0));
        Setpoint { pos_m: [side * goal[0], side * goal[1], goal[2]], yaw_rad: R::zero() }
    }
}

/// Many drones need a larger circle, and less jitter where the room ends, unless the user chose either.
fn make_room(chosen: &mut Chosen<Options>, drones: usize) {
    let o = chosen.first();
    let half_sine = libm::sin(std::f64::consts::PI / drones.max(2) as f64);
    let needed_m = 0.5 * (GAP_M + 2.0 * o.jitter_m) / half_sine;
    if !chosen.gives("radius_m") && needed_m > o.radius_m {
        // a little more, so that rounding leaves room
        chosen.set("radius_m", (needed_m + 0.001).min(2.2));
    }
    let left_m = half_sine * chosen.first().radius_m - 0.5 * GAP_M;
    if !chosen.gives("jitter_m") && left_m < o.jitter_m {
        chosen.set("jitter_m", (left_m - 0.001).max(0.0));
    }
}
