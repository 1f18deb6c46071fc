//! The path of a task: for pictures, and for vehicles that no simulator steps.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::{Scene, Start, Task, Visitor};
use crate::effects::Neighbour;
use crate::error::{Error, Result};
use crate::lanes::Lanes;
use crate::noise::EpisodeKeys;
use crate::scalar::{Scalar, Word};

/// Returns the set-point of the first drone at the first `ticks` ticks of `tick_s` seconds of an episode, if nobody
/// flies; empty if it does not move or differs from episode to episode.
///
/// # Errors
/// [`crate::Error::Unknown`] for the name of the task, [`crate::Error::Config`] and [`crate::Error::Range`]
/// for its options.
pub fn path(name: &str, options: &serde_json::Value, tick_s: f64, ticks: u32) -> Result<Vec<[f32; 3]>> {
    super::visit(name, 0, options, Path { tick_s, ticks })
}

/// Set-points of a task of one drone, or of one of several (its place and their number), at the first `ticks` ticks
/// of `tick_s` seconds, of the episode that `key` draws: x, y, z and yaw.
///
/// # Errors
/// The errors of [`path`]; [`Error::Config`] for tasks of several drones without `of`, and where the set-point waits
/// for a drone.
pub fn setpoints(
    name: &str,
    options: &serde_json::Value,
    tick_s: f64,
    ticks: u32,
    key: u64,
    of: Option<(usize, usize)>,
) -> Result<Vec<[f64; 4]>> {
    let drones = of.map_or(0, |(_, drones)| drones);
    super::visit(name, drones, options, Setpoints { path: Path { tick_s, ticks }, name, key, of })
}

struct Setpoints<'a> {
    path: Path,
    name: &'a str,
    key: u64,
    of: Option<(usize, usize)>,
}

impl Visitor for Setpoints<'_> {
    type Output = Vec<[f64; 4]>;
    fn visit<T: Task>(self, task: T, drones: usize) -> Result<Self::Output> {
        let refused = |why: &str| Err(Error::Config(format!("task {}: {why}", self.name)));
        let drone = match self.of {
            None if drones != 1 => return refused("it is for several drones, expected one of one drone"),
            Some((drone, _)) if drone >= drones => {
                return refused(&format!("it has {drones} drones, expected more than {drone}"));
            }
            of => (of.map_or(0, |(drone, _)| drone), drones),
        };
        if drones > 1 && task.board() > 0 {
            return refused("its set-points depend on what its drones have done, expected known ones");
        }
        let [points, followed] =
            [false, true].map(|followed| self.path.rows(&task, drone, self.key, followed));
        if points != followed {
            return refused("its set-point waits for the drone, expected one that is known beforehand");
        }
        Ok(points)
    }
}

struct Path {
    tick_s: f64,
    ticks: u32,
}

impl Visitor for Path {
    type Output = Vec<[f32; 3]>;
    fn visit<T: Task>(self, task: T, drones: usize) -> Result<Self::Output> {
        let (path, other) = (self.walk(&task, drones, 0), self.walk(&task, drones, 1));
        let still = path.windows(2).all(|pair| pair[0] == pair[1]);
        Ok(if still || path != other { Vec::new() } else { path })
    }
}

impl Path {
    /// Places of the set-point in the episode that `key` draws.
    fn walk(&self, task: &impl Task, drones: usize, key: u64) -> Vec<[f32; 3]> {
        let rows = self.rows(task, (0, drones), key, false);
        rows.into_iter().map(|[x, y, z, _]| [x as f32, y as f32, z as f32]).collect()
    }

    /// Set-points of one drone of so many, in the episode that `key` draws. `followed`: all drones are always where
    /// that one was asked to be.
    fn rows(
        &self,
        task: &impl Task,
        (drone, drones): (usize, usize),
        key: u64,
        followed: bool,
    ) -> Vec<[f64; 4]> {
        let mut keys = EpisodeKeys::<Lanes>::new();
        keys.set_lane(0, key);
        let mut starts = vec![Start::origin(); drones];
        let mut board = vec![0.0; task.board()];
        task.start(&mut Pcg64Mcg::seed_from_u64(key), &mut starts, &mut board);
        let mut goal = starts[drone].goal.map(Lanes::from_f64);
        let board: Vec<_> = board.into_iter().map(Lanes::from_f64).collect();
        let mut seen = vec![Neighbour::gone(); drones];
        let mut row = |tick: u32| {
            let word = <Lanes as Scalar>::Word::from_u32(tick);
            let scene = Scene {
                drones: &seen,
                load: None,
                board: &board,
                t_s: Lanes::from_f64(f64::from(tick) * self.tick_s),
                draw: keys.draw(&word),
            };
            let setpoint = task.setpoint(drone, &mut goal, &scene);
            if followed {
                let (vel_mps, here) = ([Lanes::zero(); 3], Lanes::from_f64(1.0));
                seen.fill(Neighbour { pos_m: setpoint.pos_m, vel_mps, here });
            }
            let [x, y, z] = setpoint.pos_m;
            [x, y, z, setpoint.yaw_rad].map(|number| number.lane(0))
        };
        (0..self.ticks).map(&mut row).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closed_shapes_have_a_path_and_the_others_none() {
        let options = |shape: &str| serde_json::json!({ "shape": shape });
        let eight = path("track", &options("figure_eight"), 0.02, 400).unwrap();
        assert_eq!(eight.len(), 400);
        assert!(eight.iter().all(|p| p[0].abs() <= 0.5 && p[1].abs() <= 0.26 && (p[2] - 0.7).abs() < 1e-6));
        assert!(eight.iter().any(|p| p[0] > 0.49) && eight.iter().any(|p| p[0] < -0.49));
        assert!(path("track", &options("waypoints"), 0.02, 800).unwrap().is_empty());
        assert!(path("hover", &serde_json::Value::Null, 0.02, 10).unwrap().is_empty());
    }

    #[test]
    fn set_points_are_told_where_they_are_known_beforehand() {
        let steps = serde_json::json!({"steps": [{"from_s": 0.04, "setpoint_m": [0.5, 0, 1], "setpoint_yaw_deg": 90}]});
        let rows = setpoints("hover", &steps, 0.02, 4, 3, None).unwrap();
        assert_eq!(rows[1][..2], [0.0, 0.0]);
        assert!((rows[2][3] - std::f64::consts::FRAC_PI_2).abs() < 1e-6 && rows[3][2] == 1.0, "{rows:?}");
        let drawn = |key| {
            setpoints("track", &serde_json::json!({"shape": "waypoints"}), 0.02, 400, key, None).unwrap()
        };
        assert!(drawn(1) != drawn(2) && drawn(1) == drawn(1));
        let swap =
            |drone| setpoints("swap", &serde_json::Value::Null, 0.02, 1000, 7, Some((drone, 2))).unwrap();
        for drone in [0, 1] {
            let rows = swap(drone);
            assert!((rows[0][0] + rows[999][0]).abs() < 1e-6 && rows[0][0].abs() > 0.1, "{:?}", rows[0]);
        }
        let [a, b] = [0, 1].map(|drone| swap(drone)[0]);
        assert!((a[0] - b[0]).hypot(a[1] - b[1]) > 1.0, "{a:?} {b:?}");
        for (task, words) in [
            ("cover", "depend on what its drones"),
            ("follow", "waits for the drone"),
            ("hover", "for one drone"),
        ] {
            let refused = setpoints(task, &serde_json::Value::Null, 0.02, 100, 0, Some((1, 2)));
            let error = refused.unwrap_err().to_string();
            assert!(error.contains(words), "{task}: {error}");
        }
        for (task, words) in [("race", "waits for the drone"), ("swap", "several drones")] {
            let error =
                setpoints(task, &serde_json::Value::Null, 0.02, 3000, 0, None).unwrap_err().to_string();
            assert!(error.contains(words), "{task}: {error}");
        }
    }
}
