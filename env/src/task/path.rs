//! Where a task leads, for pictures.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::{GOAL, Scene, Start, Task, Visitor};
use crate::effects::Neighbour;
use crate::error::Result;
use crate::lanes::Lanes;
use crate::noise::EpisodeKeys;
use crate::scalar::{Scalar, Word};

/// The set-point of the first drone at the first `ticks` ticks of `tick_s` seconds of an episode, if nobody
/// flies; empty where it stands still or differs from episode to episode.
///
/// # Errors
/// [`crate::Error::Unknown`] for the name of the task, [`crate::Error::Config`] and [`crate::Error::Range`]
/// for its options.
pub fn path(name: &str, options: &serde_json::Value, tick_s: f64, ticks: u32) -> Result<Vec<[f32; 3]>> {
    super::visit(name, 0, options, Path { tick_s, ticks })
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
    /// Set-points of the episode that `key` draws.
    fn walk(&self, task: &impl Task, drones: usize, key: u64) -> Vec<[f32; 3]> {
        let mut keys = EpisodeKeys::<Lanes>::new();
        keys.set_lane(0, key);
        let mut starts = vec![Start { pos_m: [0.0; 3], yaw_rad: 0.0, goal: [0.0; GOAL] }; drones];
        let mut board = vec![0.0; task.board()];
        task.start(&mut Pcg64Mcg::seed_from_u64(key), &mut starts, &mut board);
        let mut goal = starts[0].goal.map(Lanes::from_f64);
        let board: Vec<_> = board.into_iter().map(Lanes::from_f64).collect();
        let gone = vec![Neighbour::gone(); drones];
        let at = |tick: u32| {
            let word = <Lanes as Scalar>::Word::from_u32(tick);
            let scene = Scene {
                drones: &gone,
                load: None,
                t_s: Lanes::from_f64(f64::from(tick) * self.tick_s),
                draw: keys.draw(&word),
            };
            task.setpoint(0, &mut goal, &board, &scene).pos_m.map(|p| p.lane(0) as f32)
        };
        (0..self.ticks).map(at).collect()
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
}
