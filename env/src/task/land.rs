//! Land softly on the marker.

use rand_pcg::Pcg64Mcg;

use super::{
    Chosen, GOAL, HEIGHT_M, Outcome, Scene, Situation, Start, Task, closeness, in_disc, jerk, keeping,
    options, start_at,
};
use crate::error::Result;
use crate::observation::Setpoint;
use crate::scalar::Scalar;

options! {
    drawn start_radius_m: f64 = 0.3, "m", [0.0, 2.0], "radius of the disc about the marker over which it starts";
    drawn start_height_m: f64 = HEIGHT_M, "m", [0.1, 2.5], "height at the start";
}

pub struct Land(Chosen<Options>);

impl Task for Land {
    const NAME: &'static str = "land";
    const ID: &'static str = "CrazyflieLand-v0";
    const ABOUT: &'static str = "Land on the marker from 70 cm: softly, and in its middle";
    const REWARD: &'static str = "0.1 (closeness - 1) - 0.005 jerk per step towards the marker on the floor; at touch-down once 10 / (1 + (off / 0.1 m)^2) / (1 + (impact / 0.3 m/s)^2); ends there or outside the room";
    const MAX_EPISODE_STEPS: u32 = 500;
    type Options = Options;

    fn new(chosen: Chosen<Options>, _: usize) -> Result<Self> {
        Ok(Land(chosen))
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], _: &mut [f64]) {
        let o = self.0.draw(rng);
        let [x, y] = in_disc(o.start_radius_m, rng);
        starts.fill(start_at([x, y, o.start_height_m], &[]));
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, _: usize, goal: &mut [R; GOAL], _: &[R], _: &Scene<R>) -> Setpoint<R> {
        Setpoint { pos_m: [goal[0], goal[1], goal[2]], yaw_rad: goal[3] }
    }

    #[inline(always)]
    fn judge<R: Scalar>(&self, _: usize, s: &Situation<R>, _: &[R], _: &Scene<R>) -> Outcome<R> {
        let one = R::from_f64(1.0);
        let approach = R::from_f64(0.1) * (closeness(s) - one) - R::from_f64(0.005) * jerk(s);
        let off2 = s.x.pos_m[0] * s.x.pos_m[0] + s.x.pos_m[1] * s.x.pos_m[1];
        let impact2 = s.contact.impact_mps * s.contact.impact_mps;
        let touch = R::from_f64(10.0)
            / ((one + R::from_f64(1.0 / 0.01) * off2) * (one + R::from_f64(1.0 / 0.09) * impact2));
        let down = s.contact.standing;
        Outcome {
            reward: approach + R::select(down, touch, R::zero()),
            arrived: down,
            ends: down,
            ..keeping(s)
        }
    }
}
