//! Where a task leads, for pictures.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::{Task, Visitor};
use crate::error::Result;
use crate::lanes::Lanes;
use crate::noise::Keys;
use crate::real::{Real, Word};

/// The set-point at the first `ticks` ticks of `tick_s` seconds of an episode; empty where it stands still or differs from episode to
/// episode.
///
/// # Errors
/// [`crate::Error::Unknown`] for the name of the task, [`crate::Error::Config`] and [`crate::Error::Range`] for its options.
pub fn path(name: &str, options: &serde_json::Value, tick_s: f64, ticks: u32) -> Result<Vec<[f32; 3]>> {
    super::visit(name, options, Path { tick_s, ticks })
}

struct Path {
    tick_s: f64,
    ticks: u32,
}

impl Visitor for Path {
    type Out = Vec<[f32; 3]>;
    fn visit<T: Task>(self, task: T) -> Result<Self::Out> {
        Ok(path_of(&task, self.tick_s, self.ticks))
    }
}

fn path_of(task: &impl Task, tick_s: f64, ticks: u32) -> Vec<[f32; 3]> {
    let walk = |key: u64| -> Vec<[f32; 3]> {
        let mut keys = Keys::<Lanes>::new();
        keys.set_lane(0, key);
        let mut goal = task.start(&mut Pcg64Mcg::seed_from_u64(key)).goal.map(Lanes::of);
        let at = |tick: u32| {
            let word = <Lanes as Real>::Word::of(tick);
            let draw = keys.at(&word);
            task.setpoint(&mut goal, Lanes::of(f64::from(tick) * tick_s), &draw).pos_m.map(|p| p.lane(0) as f32)
        };
        (0..ticks).map(at).collect()
    };
    let (path, other) = (walk(0), walk(1));
    let still = path.windows(2).all(|pair| pair[0] == pair[1]);
    if still || path != other { Vec::new() } else { path }
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
