//! The thesis's own task: fly to the marker and hover over it (7.3).

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::Deserialize;

use super::{
    Chosen, GOAL, HEIGHT_M, Scene, Start, Task, in_disc, options, options::Rows, random_direction, start_at,
};
use crate::error::{Result, check_range};
use crate::observation::Setpoint;
use crate::scalar::Scalar;

options! {
    drawn start_radius_m: f64 = 0.8, "m", [0.0, 2.0], "radius of the disc about the set-point in which it starts";
    drawn start_m: Option<[f64; 3]> = None, "m", ROOM, "where it starts, instead of anywhere in the disc";
    drawn start_yaw_deg: f64 = 0.0, "deg", [0.0, 180.0], "heading at the start is within this of the set-point's";
    drawn start_speed_mps: f64 = 0.0, "m/s", [0.0, 3.0], "sideways speed at the start, in any direction";
    drawn start_tilt_deg: f64 = 0.0, "deg", [0.0, 30.0], "tilt at the start, to any side";
    drawn setpoint_m: [f64; 3] = [0.0, 0.0, HEIGHT_M], "m", ROOM, "where to hover";
    drawn setpoint_yaw_deg: f64 = 0.0, "deg", [-180.0, 180.0], "heading to hover with";
    fixed steps: Rows = Rows, "", (), "where to hover from later times on, in order: rows of from_s, setpoint_m and setpoint_yaw_deg";
}

/// Bounds of starts and set-points.
pub(super) const ROOM: [[f64; 2]; 3] = [[-2.4, 2.4], [-2.4, 2.4], [0.0, 2.6]];

/// A jump of the set-point.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    pub from_s: f64,
    pub setpoint_m: [f64; 3],
    #[serde(default)]
    pub setpoint_yaw_deg: f64,
}

pub struct Hover {
    chosen: Chosen<Options>,
    steps: Vec<Step>,
}

impl Task for Hover {
    const NAME: &'static str = "hover";
    const ID: &'static str = "Crazyflie-v0";
    const ABOUT: &'static str = "Fly to the marker from up to 80 cm away and hover 70 cm over it";
    const REWARD: &'static str = "closeness - 0.05 jerk; closeness = (0.8 + 0.2 / (1 + yaw_error^2)) / (1 + (distance / 0.3 m)^2), jerk = mean square change of the action; ends in a crash (floor at over 1.5 m/s) or outside the room (5 x 5 x 2.8 m)";
    const MAX_EPISODE_STEPS: u32 = 500;
    type Options = Options;

    fn new(chosen: Chosen<Options>, _: usize) -> Result<Self> {
        let steps: Vec<Step> = chosen.list("steps")?;
        let mut earliest_s = 0.0;
        for step in &steps {
            for (p, [low, high]) in step.setpoint_m.iter().zip(ROOM) {
                check_range("setpoint_m of a step", *p, low, high)?;
            }
            check_range("setpoint_yaw_deg of a step", step.setpoint_yaw_deg, -180.0, 180.0)?;
            earliest_s = check_range("from_s of a step, in order", step.from_s, earliest_s, 3600.0)?;
        }
        Ok(Hover { chosen, steps })
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], _: &mut [f64]) {
        let o = self.chosen.draw(rng);
        let [x, y] = in_disc(o.start_radius_m, rng);
        let turned = o.start_yaw_deg * (2.0 * rng.random::<f64>() - 1.0);
        let [gx, gy, gz] = o.setpoint_m;
        let yaw_rad = o.setpoint_yaw_deg.to_radians();
        let pos_m = o.start_m.unwrap_or([gx + x, gy + y, gz]);
        let yaw_start_rad = yaw_rad + turned.to_radians();
        let vel_mps = random_direction(o.start_speed_mps, rng);
        let tilt_rad = random_direction(o.start_tilt_deg.to_radians(), rng);
        let still = start_at(pos_m, &[gx, gy, gz, yaw_rad]);
        starts.fill(Start { yaw_rad: yaw_start_rad, vel_mps, tilt_rad, ..still });
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, _: usize, goal: &mut [R; GOAL], scene: &Scene<R>) -> Setpoint<R> {
        for step in &self.steps {
            // half a millisecond of margin for the clock's rounding
            let due = R::from_f64(step.from_s - 5e-4).le(scene.t_s);
            let [x, y, z] = step.setpoint_m;
            for (kept, new) in goal.iter_mut().zip([x, y, z, step.setpoint_yaw_deg.to_radians()]) {
                *kept = R::select(due, R::from_f64(new), *kept);
            }
        }
        Setpoint { pos_m: [goal[0], goal[1], goal[2]], yaw_rad: goal[3] }
    }
}

#[cfg(test)]
mod tests {
    use crate::task::path;

    #[test]
    fn the_set_point_jumps_when_it_is_told_to() {
        let steps = serde_json::json!({"steps": [{"from_s": 0.1, "setpoint_m": [0.5, 0, 0.7]}, {"from_s": 0.2, "setpoint_m": [0, 0, 1]}]});
        let path = path("hover", &steps, 0.02, 15).unwrap();
        let want = |tick: usize| {
            if tick < 5 {
                [0.0, 0.0, 0.7]
            } else if tick < 10 {
                [0.5, 0.0, 0.7]
            } else {
                [0.0, 0.0, 1.0]
            }
        };
        assert_eq!(path, (0..15).map(want).collect::<Vec<_>>());
    }

    #[test]
    fn steps_come_in_order_and_within_the_room() {
        let step = |from_s: f64, x: f64| serde_json::json!({"from_s": from_s, "setpoint_m": [x, 0.0, 0.7]});
        let made = |steps: Vec<serde_json::Value>| {
            let options = serde_json::json!({ "steps": steps });
            path("hover", &options, 0.02, 1).map(|_| ()).map_err(|e| e.to_string())
        };
        made(vec![step(1.0, 0.0), step(2.0, 0.1)]).unwrap();
        for (steps, word) in [
            (vec![step(2.0, 0.0), step(1.0, 0.0)], "from_s of a step, in order is 1"),
            (vec![step(f64::NAN, 0.0)], "steps: invalid type: null"),
            (vec![step(1.0, 3.0)], "setpoint_m of a step is 3"),
        ] {
            let error = made(steps).unwrap_err();
            assert!(error.contains(word), "{error}");
        }
    }
}
