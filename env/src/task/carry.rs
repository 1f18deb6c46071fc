//! Carry a load together, on ropes.

use rand_pcg::Pcg64Mcg;

use super::{
    Chosen, GOAL, Outcome, Scene, Situation, Start, Task, distance, jerk, jitter, on_circle, options,
    room_on_circle, start_at,
};
use crate::coupling::load::Load;
use crate::error::{Result, check_range};
use crate::observation::Setpoint;
use crate::scalar::Scalar;

options! {
    fixed load_kg: f64 = 0.01, "kg", [0.001, 1.0], "mass of the load; at most 15 g for each drone";
    fixed rope_m: f64 = 0.6, "m", [0.1, 1.5], "length of each rope";
    fixed ring_m: f64 = 0.3, "m", [0.0, 1.5], "radius of the circle on which they fly above the load";
    drawn height_m: f64 = 0.5, "m", [0.05, 2.5], "height of the load";
    drawn size_m: f64 = 0.8, "m", [0.0, 1.5], "half the length of the load's oval way";
    drawn period_s: f64 = 16.0, "s", [4.0, 600.0], "time for one round of it";
}

pub struct Carry {
    chosen: Chosen<Options>,
    load: Load,
    ring_m: f64,
    drones: usize,
    /// From the load up to the drones.
    above_m: f64,
}

impl Task for Carry {
    const NAME: &'static str = "carry";
    const ID: &'static str = "CrazyflieCarry-v0";
    const ABOUT: &'static str = "Carry a load on ropes along an oval; the ropes pull drones and load";
    const REWARD: &'static str = "0.5 / (1 + (load's distance from its way / 0.15 m)^2) + 0.5 / (1 + (own distance from the set-point / 0.3 m)^2) - 0.05 jerk; ends and -10 as for formation";
    const MAX_EPISODE_STEPS: u32 = 1000;
    const DRONES: usize = 3;
    type Options = Options;

    fn new(chosen: Chosen<Options>, drones: usize) -> Result<Self> {
        let o = chosen.first();
        let load = Load::new(o.load_kg, o.rope_m, drones)?;
        check_range("ring_m", o.ring_m, 0.0, 0.95 * o.rope_m)?;
        let above_m = libm::sqrt(o.rope_m * o.rope_m - o.ring_m * o.ring_m);
        for o in chosen.corners() {
            check_range("height_m", o.height_m, 0.05, 2.5 - above_m)?;
        }
        room_on_circle("ring_m", o.ring_m, drones, 0.2)?;
        Ok(Carry { chosen, load, ring_m: o.ring_m, drones, above_m })
    }

    fn load(&self) -> Option<Load> {
        Some(self.load)
    }

    /// The load's way: turns per second as an angle, half the length, height, and the height of the drones.
    fn board(&self) -> usize {
        4
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], board: &mut [f64]) {
        let o = self.chosen.draw(rng);
        let above_m = o.height_m + self.above_m;
        board.copy_from_slice(&[std::f64::consts::TAU / o.period_s, o.size_m, o.height_m, above_m]);
        let [x, y] = way(board, 0.0);
        for (i, start) in starts.iter_mut().enumerate() {
            let [dx, dy] = on_circle(i, self.drones, self.ring_m, 0.0);
            let [off_x, off_y] = jitter(rng, 0.02);
            *start = start_at([x + dx + off_x, y + dy + off_y, above_m], &[]);
        }
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, own: usize, _: &mut [R; GOAL], scene: &Scene<R>) -> Setpoint<R> {
        let [x, y] = way(scene.board, scene.t_s);
        let [dx, dy] = on_circle(own, self.drones, self.ring_m, 0.0);
        Setpoint { pos_m: [x + R::from_f64(dx), y + R::from_f64(dy), scene.board[3]], yaw_rad: R::zero() }
    }

    #[inline(always)]
    fn judge<R: Scalar>(&self, _: usize, s: &Situation<R>, scene: &Scene<R>) -> Outcome<R> {
        let [x, y] = way(scene.board, scene.t_s);
        let place = [x, y, scene.board[2]];
        let error_m = scene.load.map_or(
            R::zero(),
            #[inline(always)]
            |load| distance(&load.pos_m, &place),
        );
        let own_m = distance(&s.x.pos_m, &s.setpoint.pos_m);
        let near = |d: R, half: f64| {
            R::from_f64(0.5) / (R::from_f64(1.0) + d * d * R::from_f64(1.0 / (half * half)))
        };
        let reward = near(error_m, 0.15) + near(own_m, 0.3) - R::from_f64(0.05) * jerk(s);
        Outcome { reward, error_m, arrived: error_m.lt(R::from_f64(0.1)), ends: R::nothing() }
    }
}

/// Returns the set-point of the load.
#[inline(always)]
fn way<R: Scalar>(board: &[R], t_s: R) -> [R; 2] {
    let (sin, cos) = (t_s * board[0]).sin_cos();
    [board[1] * cos, R::from_f64(0.5) * board[1] * sin]
}
