//! Hold a formation that moves and changes its shape.

use rand_pcg::Pcg64Mcg;

use super::{Chosen, GOAL, Scene, Start, Task, jitter, on_circle, options, start_at};
use crate::error::{Result, out_of_range};
use crate::observation::Setpoint;
use crate::scalar::{Scalar, tabulate};

options! {
    fixed spacing_m: f64 = 0.5, "m", [0.1, 2.0], "distance between neighbours, at least";
    drawn height_m: f64 = 0.8, "m", [0.2, 2.5], "height of the formation";
    drawn roam_m: f64 = 0.4, "m", [0.0, 1.5], "radius of the circle on which the middle of the formation moves";
    drawn period_s: f64 = 16.0, "s", [2.0, 600.0], "time for one round of it";
    fixed change_s: f64 = 8.0, "s", [0.0, 600.0], "the shape changes this often, between ring and rows; 0 for never";
}

pub struct Formation {
    chosen: Chosen<Options>,
    change_s: f64,
    /// Each drone's place in the ring and in the rows, about the middle.
    places: Vec<[[f64; 2]; 2]>,
}

/// Time that a change of shape may take.
const CHANGE_S: f64 = 3.0;

impl Task for Formation {
    const NAME: &'static str = "formation";
    const ID: &'static str = "CrazyflieFormation-v0";
    const ABOUT: &'static str =
        "Hold a ring, then rows, then a ring again, while the middle of the formation moves on a circle";
    const REWARD: &'static str = "closeness - 0.05 jerk to the own place, as for hover; -10 for a collision, a crash or leaving the room, which end a drone's flight";
    const MAX_EPISODE_STEPS: u32 = 1000;
    const DRONES: usize = 4;
    type Options = Options;

    fn new(chosen: Chosen<Options>, drones: usize) -> Result<Self> {
        // the widest circle decides whether there is room
        let first = chosen.first();
        let roam_m = chosen.corners().map(|o| o.roam_m).fold(first.roam_m, f64::max);
        let o = Options { roam_m, ..first };
        if o.change_s != 0.0 && o.change_s < CHANGE_S {
            return Err(out_of_range("change_s", o.change_s, format!("0 or at least {CHANGE_S}")));
        }
        let radius_m = if drones == 1 {
            0.0
        } else {
            o.spacing_m / (2.0 * libm::sin(std::f64::consts::PI / drones as f64))
        };
        let columns = libm::ceil(libm::sqrt(drones as f64)) as usize;
        let rows = drones.div_ceil(columns);
        let widest_m = radius_m.max(0.5 * o.spacing_m * (columns - 1) as f64) + o.roam_m;
        // a ring of many would leave the room: they stay in their rows
        let fits = widest_m < 2.3;
        let square = |i: usize, n: usize| (i as f64 - 0.5 * (n as f64 - 1.0)) * o.spacing_m;
        if square(columns, columns + 1) + o.roam_m > 2.4 {
            return Err(out_of_range("spacing_m", o.spacing_m, format!("room for {drones} drones in 4.8 m")));
        }
        let place = |i: usize| {
            let row = [square(i % columns, columns), square(i / columns, rows)];
            [if fits { on_circle(i, drones, radius_m, 0.0) } else { row }, row]
        };
        Ok(Formation { places: assigned((0..drones).map(place).collect()), change_s: o.change_s, chosen })
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], _: &mut [f64]) {
        let o = self.chosen.draw(rng);
        let goal = [std::f64::consts::TAU / o.period_s, o.roam_m, o.height_m];
        for (start, [ring, _]) in starts.iter_mut().zip(&self.places) {
            let [dx, dy] = jitter(rng, 0.05);
            *start = start_at([o.roam_m + ring[0] + dx, ring[1] + dy, o.height_m], &goal);
        }
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, own: usize, goal: &mut [R; GOAL], scene: &Scene<R>) -> Setpoint<R> {
        let [rate, roam, height, ..] = *goal;
        let (sin, cos) = (scene.t_s * rate).sin_cos();
        let shape = self.shape(scene.t_s);
        let [ring, rows] = &self.places[own];
        let middle = [cos * roam, sin * roam];
        let [x, y] = tabulate(
            #[inline(always)]
            |i| middle[i] + R::from_f64(ring[i]) + shape * R::from_f64(rows[i] - ring[i]),
        );
        Setpoint { pos_m: [x, y, height], yaw_rad: R::zero() }
    }
}

impl Formation {
    /// 0 for the ring, 1 for the rows, in between during a change.
    #[inline(always)]
    fn shape<R: Scalar>(&self, t_s: R) -> R {
        let period = self.change_s;
        if period == 0.0 {
            return R::zero();
        }
        // a triangle wave of two periods, cut off so that a change takes CHANGE_S
        let turns = t_s * R::from_f64(0.5 / period) - R::from_f64(0.5 + 0.25 * (1.0 - CHANGE_S / period));
        let saw = turns - turns.round();
        let wave = (R::from_f64(0.25) - saw.abs()) * R::from_f64(2.0 * period / CHANGE_S);
        R::from_f64(1.0) - (wave + R::from_f64(0.5)).clamp(R::zero(), R::from_f64(1.0))
    }
}

/// Ring and rows paired so that the ways between them are short: the same order around the middle.
fn assigned(places: Vec<[[f64; 2]; 2]>) -> Vec<[[f64; 2]; 2]> {
    let mut rows: Vec<[f64; 2]> = places.iter().map(|p| p[1]).collect();
    places
        .iter()
        .map(|[ring, _]| {
            let far = |p: &[f64; 2]| (p[0] - ring[0]).powi(2) + (p[1] - ring[1]).powi(2);
            let nearest =
                (0..rows.len()).min_by(|a, b| far(&rows[*a]).total_cmp(&far(&rows[*b]))).unwrap_or(0);
            [*ring, rows.remove(nearest)]
        })
        .collect()
}
