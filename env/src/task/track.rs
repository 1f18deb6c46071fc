//! Follow a moving set-point: figure eight, circle, square, helix, or straight legs between random waypoints.

use rand_pcg::Pcg64Mcg;
use serde::Deserialize;

use super::{GOAL, HEIGHT_M, Scene, Start, Task};
use crate::error::{Error, Result, check_range};
use crate::noise::channel;
use crate::observation::Setpoint;
use crate::scalar::{Scalar, tabulate};

/// What to fly.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shape {
    FigureEight,
    Circle,
    Square,
    Helix,
    Waypoints,
}

/// Options of the tracking task.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    pub shape: Shape,
    /// Half the width of the shape.
    pub size_m: f64,
    /// Time for one round; for waypoints, for one leg.
    pub period_s: f64,
    /// Middle height.
    pub height_m: f64,
    /// Half the height that a helix or the waypoints span.
    pub rise_m: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { shape: Shape::FigureEight, size_m: 0.5, period_s: 8.0, height_m: HEIGHT_M, rise_m: 0.2 }
    }
}

pub struct Track(Options);

/// Goal slots of the waypoints: leg from, leg to, its start time.
const FROM: usize = 0;
const TO: usize = 3;
const SINCE: usize = 6;

impl Task for Track {
    const NAME: &'static str = "track";
    const ID: &'static str = "CrazyflieTrack-v0";
    const ABOUT: &'static str = "Follow a moving set-point: figure_eight, circle, square, helix or waypoints";
    const REWARD: &'static str =
        "closeness - 0.05 jerk to the moving set-point, as for hover; ends in a crash or outside the room";
    const MAX_EPISODE_STEPS: u32 = 1000;
    type Options = Options;

    fn new(o: Options, _: usize) -> Result<Self> {
        check_range("size_m", o.size_m, 0.05, 2.0)?;
        check_range("period_s", o.period_s, 0.5, 120.0)?;
        check_range("height_m", o.height_m, 0.2, 2.5)?;
        check_range("rise_m", o.rise_m, 0.0, 1.0)?;
        if o.height_m - o.rise_m < 0.1 {
            return Err(Error::Range {
                name: "height_m - rise_m".into(),
                value: o.height_m - o.rise_m,
                want: "at least 0.1".into(),
            });
        }
        Ok(Track(o))
    }

    fn start(&self, _: &mut Pcg64Mcg, starts: &mut [Start], _: &mut [f64]) {
        let mut goal = [0.0; GOAL];
        let pos_m = match self.0.shape {
            Shape::Waypoints => [0.0, 0.0, self.0.height_m],
            _ => self.round(0.0),
        };
        goal[FROM..FROM + 3].copy_from_slice(&pos_m);
        goal[TO..TO + 3].copy_from_slice(&pos_m);
        // the first leg ends at once, and the first waypoint is drawn
        goal[SINCE] = -self.0.period_s;
        starts.fill(Start { pos_m, yaw_rad: 0.0, goal });
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, _: usize, goal: &mut [R; GOAL], _: &[R], scene: &Scene<R>) -> Setpoint<R> {
        let (o, t_s, draw) = (&self.0, scene.t_s, &scene.draw);
        if o.shape != Shape::Waypoints {
            return Setpoint { pos_m: self.round(t_s), yaw_rad: R::zero() };
        }
        let period = R::from_f64(o.period_s);
        let arrived = (goal[SINCE] + period).le(t_s + R::from_f64(1e-3));
        let spread = [o.size_m, o.size_m, o.rise_m];
        for i in 0..3 {
            let middle = if i == 2 { R::from_f64(o.height_m) } else { R::zero() };
            let drawn = middle
                + R::from_f64(2.0 * spread[i])
                    * (draw.uniform(channel("waypoint").wrapping_add(i as u32)) - R::from_f64(0.5));
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
    fn round<R: Scalar>(&self, t_s: R) -> [R; 3] {
        let o = &self.0;
        let (a, z) = (R::from_f64(o.size_m), R::from_f64(o.height_m));
        let turns = t_s * R::from_f64(1.0 / o.period_s);
        let (sin, cos) = (R::from_f64(std::f64::consts::TAU) * turns).sin_cos();
        match o.shape {
            // Gerono's lemniscate, through the marker at the start
            Shape::FigureEight | Shape::Waypoints => [a * sin, a * sin * cos, z],
            Shape::Circle => [a * cos, a * sin, z],
            // up and down once in four rounds
            Shape::Helix => [
                a * cos,
                a * sin,
                z + R::from_f64(o.rise_m) * (R::from_f64(std::f64::consts::FRAC_PI_2) * turns).sin_cos().0,
            ],
            Shape::Square => {
                // both coordinates are clipped triangle waves of the same round, a quarter apart
                [self.edge(turns, 0.125), self.edge(turns, 0.375), z]
            }
        }
    }

    /// A triangle wave of twice the size, clipped: a quarter of a round across, a quarter waiting.
    #[inline(always)]
    fn edge<R: Scalar>(&self, turns: R, phase: f64) -> R {
        let a = R::from_f64(self.0.size_m);
        let p = turns + R::from_f64(phase);
        let saw = p - p.round();
        (R::from_f64(8.0 * self.0.size_m) * (saw.abs() - R::from_f64(0.25))).clamp(-a, a)
    }
}
