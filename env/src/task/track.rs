//! Follow a moving set-point: figure eight, circle, square, helix, or straight legs between random waypoints.

use rand_pcg::Pcg64Mcg;

use super::options::{OptionKind, OptionValue, Rows, options};
use super::track_table::TrackTable;
use super::{Chosen, GOAL, HEIGHT_M, Scene, Start, Task, start_at};
use crate::error::{Error, Result, out_of_range};
use crate::noise::channel;
use crate::observation::Setpoint;
use crate::scalar::{Scalar, tabulate};

/// Shapes of the path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    FigureEight,
    Circle,
    Square,
    Helix,
    Waypoints,
}

/// In the order of [`SHAPE_NAMES`].
const SHAPES: [Shape; 5] = [Shape::FigureEight, Shape::Circle, Shape::Square, Shape::Helix, Shape::Waypoints];
const SHAPE_NAMES: [&str; 5] = ["figure_eight", "circle", "square", "helix", "waypoints"];

impl OptionValue for Shape {
    type Range = ();
    const KIND: OptionKind = OptionKind::Name(&SHAPE_NAMES);
    fn numbers(self) -> [f64; 3] {
        [self as usize as f64, 0.0, 0.0]
    }
    fn from_numbers([place, ..]: [f64; 3]) -> Self {
        SHAPES[place as usize]
    }
    fn bounds((): ()) -> [[f64; 2]; 3] {
        [[0.0; 2]; 3]
    }
}

options! {
    fixed shape: Shape = Shape::FigureEight, "", (), "what to fly";
    drawn size_m: f64 = 0.5, "m", [0.05, 2.0], "half the width of the shape";
    drawn period_s: f64 = 8.0, "s", [0.5, 120.0], "time for one round; for waypoints, for one leg";
    drawn height_m: f64 = HEIGHT_M, "m", [0.2, 2.5], "middle height";
    drawn rise_m: f64 = 0.2, "m", [0.0, 1.0], "half the height that a helix or the waypoints span";
    fixed points: Rows = Rows, "", (), "your track instead of a shape: rows of t_s, x_m, y_m, z_m and perhaps yaw_rad, straight between them";
}

pub struct Track {
    chosen: Chosen<Options>,
    shape: Shape,
    table: Option<TrackTable>,
}

/// Goal slots of the waypoints: leg from, leg to, its start time.
const FROM: usize = 0;
const TO: usize = 3;
const SINCE: usize = 6;
/// Goal slots of what was drawn: size, rounds per second or for waypoints seconds per leg, height, rise.
const SIZE: usize = 7;
const PACE: usize = 8;
const HEIGHT: usize = 9;
const RISE: usize = 10;

impl Task for Track {
    const NAME: &'static str = "track";
    const ID: &'static str = "CrazyflieTrack-v0";
    const ABOUT: &'static str = "Follow a moving set-point: figure_eight, circle, square, helix or waypoints";
    const REWARD: &'static str =
        "closeness - 0.05 jerk to the moving set-point, as for hover; ends in a crash or outside the room";
    const MAX_EPISODE_STEPS: u32 = 1000;
    type Options = Options;

    fn new(chosen: Chosen<Options>, _: usize) -> Result<Self> {
        for o in chosen.corners() {
            if o.height_m - o.rise_m < 0.1 {
                return Err(out_of_range("height_m - rise_m", o.height_m - o.rise_m, "at least 0.1"));
            }
        }
        let table = TrackTable::from_rows(&chosen.list::<Vec<f64>>("points")?)?;
        if let (Some(_), Some(name)) =
            (&table, ["shape", "size_m", "period_s", "height_m", "rise_m"].iter().find(|n| chosen.gives(n)))
        {
            return Err(Error::Config(format!(
                "options of the task track: points are given, so {name} must not be"
            )));
        }
        Ok(Track { shape: chosen.first().shape, table, chosen })
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], _: &mut [f64]) {
        let o = self.chosen.draw(rng);
        if let Some(table) = &self.table {
            let [x, y, z, yaw_rad] = table.interpolate(0.0);
            starts.fill(Start { yaw_rad, ..start_at([x, y, z], &[]) });
            return;
        }
        let mut goal = [0.0; GOAL];
        let waypoints = self.shape == Shape::Waypoints;
        goal[SIZE] = o.size_m;
        goal[PACE] = if waypoints { o.period_s } else { 1.0 / o.period_s };
        goal[HEIGHT] = o.height_m;
        goal[RISE] = o.rise_m;
        let pos_m = if waypoints { [0.0, 0.0, o.height_m] } else { self.round(&goal, 0.0) };
        goal[FROM..FROM + 3].copy_from_slice(&pos_m);
        goal[TO..TO + 3].copy_from_slice(&pos_m);
        // the first leg ends at once, and the first waypoint is drawn
        goal[SINCE] = -o.period_s;
        starts.fill(start_at(pos_m, &goal));
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, own: usize, goal: &mut [R; GOAL], scene: &Scene<R>) -> Setpoint<R> {
        let (t_s, draw) = (scene.t_s, &scene.draw);
        if let Some(table) = &self.table {
            return table.setpoint(t_s);
        }
        if self.shape != Shape::Waypoints {
            return Setpoint { pos_m: self.round(goal, t_s), yaw_rad: R::zero() };
        }
        let period = goal[PACE];
        let arrived = (goal[SINCE] + period).le(t_s + R::from_f64(1e-3));
        let spread = [goal[SIZE], goal[SIZE], goal[RISE]];
        for i in 0..3 {
            let middle = if i == 2 { goal[HEIGHT] } else { R::zero() };
            let drawn = middle
                + R::from_f64(2.0)
                    * spread[i]
                    * (draw.uniform(channel("waypoint").wrapping_add((3 * own + i) as u32))
                        - R::from_f64(0.5));
            goal[FROM + i] = R::select(arrived, goal[TO + i], goal[FROM + i]);
            goal[TO + i] = R::select(arrived, drawn, goal[TO + i]);
        }
        goal[SINCE] = R::select(arrived, t_s, goal[SINCE]);
        let done = ((t_s - goal[SINCE]) / period).clamp(R::zero(), R::from_f64(1.0));
        Setpoint {
            pos_m: tabulate(
                #[inline(always)]
                |i| goal[FROM + i] + done * (goal[TO + i] - goal[FROM + i]),
            ),
            yaw_rad: R::zero(),
        }
    }
}

impl Track {
    /// The closed shapes.
    #[inline(always)]
    fn round<R: Scalar>(&self, goal: &[R; GOAL], t_s: R) -> [R; 3] {
        let (a, z) = (goal[SIZE], goal[HEIGHT]);
        let turns = t_s * goal[PACE];
        let (sin, cos) = (R::from_f64(std::f64::consts::TAU) * turns).sin_cos();
        match self.shape {
            // Gerono's lemniscate, through the marker at the start
            Shape::FigureEight | Shape::Waypoints => [a * sin, a * sin * cos, z],
            Shape::Circle => [a * cos, a * sin, z],
            // up and down once in four rounds
            Shape::Helix => [
                a * cos,
                a * sin,
                z + goal[RISE] * (R::from_f64(std::f64::consts::FRAC_PI_2) * turns).sin_cos().0,
            ],
            Shape::Square => {
                // both coordinates are clipped triangle waves of the same round, a quarter apart
                [edge(a, turns, 0.125), edge(a, turns, 0.375), z]
            }
        }
    }
}

/// A triangle wave of twice the size `a`, clipped: a quarter of a round across, a quarter waiting.
#[inline(always)]
fn edge<R: Scalar>(a: R, turns: R, phase: f64) -> R {
    let p = turns + R::from_f64(phase);
    let saw = p - p.round();
    (R::from_f64(8.0) * a * (saw.abs() - R::from_f64(0.25))).clamp(-a, a)
}
