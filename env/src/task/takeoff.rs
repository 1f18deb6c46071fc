//! Take off from the marker to 70 cm (7.3, figure 7.9).

use rand_pcg::Pcg64Mcg;

use super::{Chosen, HEIGHT_M, Outcome, Scene, Situation, Start, Task, keeping, options, start_at};
use crate::error::Result;
use crate::scalar::Scalar;

options! {
    drawn height_m: f64 = HEIGHT_M, "m", [0.1, 2.5], "height to hover at";
}

pub struct Takeoff(Chosen<Options>);

impl Task for Takeoff {
    const NAME: &'static str = "takeoff";
    const ID: &'static str = "CrazyflieTakeoff-v0";
    const ABOUT: &'static str = "Take off from the marker and hover 70 cm over it, without overshoot";
    const REWARD: &'static str = "closeness - 0.05 jerk - 2 overshoot, as for hover; overshoot = metres above the set-point; ends in a crash or outside the room";
    const MAX_EPISODE_STEPS: u32 = 500;
    type Options = Options;

    fn new(chosen: Chosen<Options>, _: usize) -> Result<Self> {
        Ok(Takeoff(chosen))
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], _: &mut [f64]) {
        starts.fill(start_at([0.0; 3], &[0.0, 0.0, self.0.draw(rng).height_m]));
    }

    #[inline(always)]
    fn judge<R: Scalar>(&self, _: usize, s: &Situation<R>, _: &Scene<R>) -> Outcome<R> {
        let overshoot = (s.x.pos_m[2] - s.setpoint.pos_m[2]).max(R::zero());
        let kept = keeping(s);
        Outcome { reward: kept.reward - R::from_f64(2.0) * overshoot, ..kept }
    }
}
