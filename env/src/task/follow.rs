//! One leads, the others follow.

use rand_pcg::Pcg64Mcg;
use serde::Deserialize;

use super::{GOAL, Scene, Start, Task, jitter, start_at};
use crate::error::{Result, check_range};
use crate::observation::Setpoint;
use crate::scalar::Scalar;

/// Options of follow the leader.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Half the length of the leader's oval.
    pub size_m: f64,
    pub period_s: f64,
    pub height_m: f64,
    /// Each follower is to be where the one before it will have been this much earlier on the way.
    pub behind_s: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { size_m: 1.2, period_s: 20.0, height_m: 0.8, behind_s: 1.2 }
    }
}

pub struct Follow(Options);

impl Task for Follow {
    const NAME: &'static str = "follow";
    const ID: &'static str = "CrazyflieFollow-v0";
    const ABOUT: &'static str = "The first drone flies an oval; each other one keeps behind the one before it, wherever that really is";
    const REWARD: &'static str = "closeness - 0.05 jerk to the place behind the drone ahead, as for hover; -10 for a collision, a crash or leaving the room, which end a drone's flight";
    const MAX_EPISODE_STEPS: u32 = 1500;
    const DRONES: usize = 4;
    type Options = Options;

    fn new(o: Options, drones: usize) -> Result<Self> {
        check_range("size_m", o.size_m, 0.2, 2.0)?;
        check_range("period_s", o.period_s, 4.0, 600.0)?;
        check_range("height_m", o.height_m, 0.2, 2.5)?;
        // the last must not catch up with the first
        check_range("behind_s", o.behind_s, 0.2, 0.9 * o.period_s / drones as f64)?;
        Ok(Follow(o))
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], _: &mut [f64]) {
        for (i, start) in starts.iter_mut().enumerate() {
            let [x, y] = self.oval(-(i as f64) * self.0.behind_s);
            let [dx, dy] = jitter(rng, 0.05);
            *start = start_at([x + dx, y + dy, self.0.height_m], &[]);
        }
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, own: usize, _: &mut [R; GOAL], _: &[R], scene: &Scene<R>) -> Setpoint<R> {
        let o = &self.0;
        let [x, y] = self.oval(scene.t_s - R::from_f64(own as f64 * o.behind_s));
        let z = R::from_f64(o.height_m);
        if own == 0 {
            return Setpoint { pos_m: [x, y, z], yaw_rad: R::zero() };
        }
        // the error of the one ahead is passed on: who is late makes the others wait
        let ahead = &scene.drones[own - 1];
        let [ax, ay] = self.oval(scene.t_s - R::from_f64((own - 1) as f64 * o.behind_s));
        let late = [ahead.here * (ahead.pos_m[0] - ax), ahead.here * (ahead.pos_m[1] - ay)];
        let limit = R::from_f64(0.3);
        Setpoint {
            pos_m: [x + late[0].clamp(-limit, limit), y + late[1].clamp(-limit, limit), z],
            yaw_rad: R::zero(),
        }
    }
}

impl Follow {
    #[inline(always)]
    fn oval<R: Scalar>(&self, t_s: R) -> [R; 2] {
        let (sin, cos) = (t_s * R::from_f64(std::f64::consts::TAU / self.0.period_s)).sin_cos();
        [R::from_f64(self.0.size_m) * cos, R::from_f64(0.7 * self.0.size_m) * sin]
    }
}
