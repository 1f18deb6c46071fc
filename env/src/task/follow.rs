//! One leads, the others follow.

use rand_pcg::Pcg64Mcg;

use super::{Chosen, GOAL, Scene, Start, Task, jitter, options, start_at};
use crate::error::{Result, check_range};
use crate::observation::Setpoint;
use crate::scalar::Scalar;

options! {
    drawn size_m: f64 = 1.2, "m", [0.2, 2.0], "half the length of the leader's oval";
    drawn period_s: f64 = 20.0, "s", [4.0, 600.0], "time for one round of it";
    drawn height_m: f64 = 0.8, "m", [0.2, 2.5], "height of the oval";
    drawn behind_s: f64 = 1.2, "s", [0.2, 600.0], "each follower is to be where the one before it will have been this much earlier on the way";
}

pub struct Follow(Chosen<Options>);

/// Goal slots: turns per second as an angle, half the length and half the width of the oval, height, how much
/// later the own place and that of the drone ahead are passed.
const RATE: usize = 0;
const LENGTH: usize = 1;
const WIDTH: usize = 2;
const HEIGHT: usize = 3;
const LATE: usize = 4;
const AHEAD_LATE: usize = 5;

impl Task for Follow {
    const NAME: &'static str = "follow";
    const ID: &'static str = "CrazyflieFollow-v0";
    const ABOUT: &'static str = "The first drone flies an oval; each other one keeps behind the one before it, wherever that really is";
    const REWARD: &'static str =
        "closeness - 0.05 jerk to the place behind the drone ahead; ends and -10 as for formation";
    const MAX_EPISODE_STEPS: u32 = 1500;
    const DRONES: usize = 4;
    type Options = Options;

    fn new(chosen: Chosen<Options>, drones: usize) -> Result<Self> {
        for o in chosen.corners() {
            // the last must not catch up with the first
            check_range("behind_s", o.behind_s, 0.2, 0.9 * o.period_s / drones as f64)?;
        }
        Ok(Follow(chosen))
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], _: &mut [f64]) {
        let o = self.0.draw(rng);
        for (i, start) in starts.iter_mut().enumerate() {
            let late_s = i as f64 * o.behind_s;
            let mut goal = [
                std::f64::consts::TAU / o.period_s,
                o.size_m,
                0.7 * o.size_m,
                o.height_m,
                late_s,
                0.0,
                0.0,
                0.0,
            ];
            if i > 0 {
                goal[AHEAD_LATE] = (i - 1) as f64 * o.behind_s;
            }
            let [x, y] = oval(&goal, -late_s);
            let [dx, dy] = jitter(rng, 0.05);
            *start = start_at([x + dx, y + dy, o.height_m], &goal);
        }
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, own: usize, goal: &mut [R; GOAL], scene: &Scene<R>) -> Setpoint<R> {
        let [x, y] = oval(goal, scene.t_s - goal[LATE]);
        let z = goal[HEIGHT];
        if own == 0 {
            return Setpoint { pos_m: [x, y, z], yaw_rad: R::zero() };
        }
        // the error of the one ahead is passed on: who is late makes the others wait
        let ahead = &scene.drones[own - 1];
        let [ax, ay] = oval(goal, scene.t_s - goal[AHEAD_LATE]);
        let late = [ahead.here * (ahead.pos_m[0] - ax), ahead.here * (ahead.pos_m[1] - ay)];
        let limit = R::from_f64(0.3);
        Setpoint {
            pos_m: [x + late[0].clamp(-limit, limit), y + late[1].clamp(-limit, limit), z],
            yaw_rad: R::zero(),
        }
    }
}

#[inline(always)]
fn oval<R: Scalar>(goal: &[R], t_s: R) -> [R; 2] {
    let (sin, cos) = (t_s * goal[RATE]).sin_cos();
    [goal[LENGTH] * cos, goal[WIDTH] * sin]
}
