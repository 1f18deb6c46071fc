//! Land softly on the marker.

use rand_pcg::Pcg64Mcg;

use super::{
    Chosen, HEIGHT_M, Outcome, Scene, Situation, Start, Task, in_disc, keeping, landing_reward, options,
    start_at,
};
use crate::error::Result;
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
    fn judge<R: Scalar>(&self, _: usize, s: &Situation<R>, _: &Scene<R>) -> Outcome<R> {
        let down = s.contact.standing;
        let reward = landing_reward(s, s.contact.impact_mps, down);
        Outcome { reward, arrived: down, ends: down, ..keeping(s) }
    }
}
