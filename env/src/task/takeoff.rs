//! Take off from the marker to 70 cm (7.3, figure 7.9).

use rand_pcg::Pcg64Mcg;
use serde::Deserialize;

use super::{GOAL, HEIGHT_M, Outcome, Scene, Situation, Start, Task, keeping};
use crate::error::{Result, check_range};
use crate::observation::Setpoint;
use crate::scalar::Scalar;

/// Options of the take-off task.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    pub height_m: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { height_m: HEIGHT_M }
    }
}

pub struct Takeoff(Options);

impl Task for Takeoff {
    const NAME: &'static str = "takeoff";
    const ID: &'static str = "CrazyflieTakeoff-v0";
    const ABOUT: &'static str = "Take off from the marker and hover 70 cm over it, without overshoot";
    const REWARD: &'static str = "closeness - 0.05 jerk - 2 overshoot, as for hover; overshoot = metres above the set-point; ends in a crash or outside the room";
    const MAX_EPISODE_STEPS: u32 = 500;
    type Options = Options;

    fn new(o: Options, _: usize) -> Result<Self> {
        check_range("height_m", o.height_m, 0.1, 2.5)?;
        Ok(Takeoff(o))
    }

    fn start(&self, _: &mut Pcg64Mcg, starts: &mut [Start], _: &mut [f64]) {
        starts.fill(Start {
            pos_m: [0.0; 3],
            yaw_rad: 0.0,
            goal: [0.0, 0.0, self.0.height_m, 0.0, 0.0, 0.0, 0.0, 0.0],
        });
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, _: usize, goal: &mut [R; GOAL], _: &[R], _: &Scene<R>) -> Setpoint<R> {
        Setpoint { pos_m: [goal[0], goal[1], goal[2]], yaw_rad: goal[3] }
    }

    #[inline(always)]
    fn judge<R: Scalar>(&self, _: usize, s: &Situation<R>, _: &[R], _: &Scene<R>) -> Outcome<R> {
        let overshoot = (s.x.pos_m[2] - s.setpoint.pos_m[2]).max(R::zero());
        let kept = keeping(s);
        Outcome { reward: kept.reward - R::from_f64(2.0) * overshoot, ..kept }
    }
}
