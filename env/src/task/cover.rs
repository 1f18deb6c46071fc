//! Look at every marker of a field.

use rand_pcg::Pcg64Mcg;

use super::{
    Chosen, GOAL, Outcome, Scene, Situation, Start, Task, distance, is, jerk, jitter, options, start_at,
};
use crate::error::{Result, check_range, out_of_range};
use crate::observation::Setpoint;
use crate::scalar::Scalar;

options! {
    fixed columns: usize = 6, "1", [1.0, 64.0], "markers along x";
    fixed rows: usize = 6, "1", [1.0, 64.0], "markers along y";
    fixed pitch_m: f64 = 0.6, "m", [0.1, 2.0], "distance from marker to marker";
    drawn height_m: f64 = 0.8, "m", [0.2, 2.5], "height to fly at";
    drawn near_m: f64 = 0.15, "m", [0.02, 1.0], "distance from the place above a marker at which it is looked at";
}

pub struct Cover {
    chosen: Chosen<Options>,
    drones: usize,
    /// The places above the markers, strip by strip, there and back.
    places: Vec<[f64; 2]>,
}

/// Most markers in a field.
const MOST: usize = 64;

impl Task for Cover {
    const NAME: &'static str = "cover";
    const ID: &'static str = "CrazyflieCover-v0";
    const ABOUT: &'static str = "Look at every marker of a field; each drone has a share of them, and the set-point is the next one in it";
    const REWARD: &'static str = "1 to the drone that first sees a marker; 0.01 / (1 + distance to the set-point / 1 m) - 0.005 jerk per step; ends and -10 as for formation";
    const MAX_EPISODE_STEPS: u32 = 1500;
    const DRONES: usize = 4;
    type Options = Options;

    fn new(chosen: Chosen<Options>, drones: usize) -> Result<Self> {
        let o = chosen.first();
        let markers = o.columns * o.rows;
        if !(drones..=MOST).contains(&markers) {
            return Err(out_of_range(
                "columns x rows",
                markers as f64,
                format!("{drones} (one for each drone) to {MOST}"),
            ));
        }
        let half = |n: usize| 0.5 * (n as f64 - 1.0) * o.pitch_m;
        check_range("half the field", half(o.columns).max(half(o.rows)), 0.0, 2.3)?;
        let place = |i: usize| {
            let (row, along) = (i / o.columns, i % o.columns);
            let column = if row.is_multiple_of(2) { along } else { o.columns - 1 - along };
            [column as f64 * o.pitch_m - half(o.columns), row as f64 * o.pitch_m - half(o.rows)]
        };
        Ok(Cover { places: (0..markers).map(place).collect(), drones, chosen })
    }

    /// For each marker 1 when it has been looked at, then for each drone which marker of its share is next, then
    /// height and nearness.
    fn board(&self) -> usize {
        self.places.len() + self.drones + 2
    }

    fn start(&self, rng: &mut Pcg64Mcg, starts: &mut [Start], board: &mut [f64]) {
        let o = self.chosen.draw(rng);
        board.fill(0.0);
        if let [.., height_m, near_m] = board {
            (*height_m, *near_m) = (o.height_m, o.near_m);
        }
        for (i, start) in starts.iter_mut().enumerate() {
            let [x, y] = self.places[self.share(i).start];
            let [dx, dy] = jitter(rng, 0.05);
            *start = start_at([x + dx, y + dy, o.height_m], &[]);
        }
    }

    #[inline(always)]
    fn turn<R: Scalar>(&self, board: &mut [R], scene: &Scene<R>) {
        let [height, near] = self.limits(board);
        let (looked, rest) = board.split_at_mut(self.places.len());
        let (next, one) = (&mut rest[..self.drones], R::from_f64(1.0));
        for (looked, [x, y]) in looked.iter_mut().zip(&self.places) {
            for drone in scene.drones {
                let place = [R::from_f64(*x), R::from_f64(*y), height];
                let seen = distance(&drone.pos_m, &place).lt(near) & drone.here.gt(R::zero());
                *looked = R::select(seen, one, *looked);
            }
        }
        for (drone, next) in next.iter_mut().enumerate() {
            for (i, marker) in self.share(drone).enumerate() {
                *next = R::select(
                    is(*next, i) & looked[marker].gt(R::zero()),
                    R::from_f64(i as f64 + 1.0),
                    *next,
                );
            }
        }
    }

    #[inline(always)]
    fn setpoint<R: Scalar>(&self, own: usize, _: &mut [R; GOAL], scene: &Scene<R>) -> Setpoint<R> {
        let next = scene.board[self.places.len() + own];
        let share = self.share(own);
        let mut pos_m = [R::zero(), R::zero(), self.limits(scene.board)[0]];
        for (i, marker) in share.clone().enumerate() {
            // past the last one it stays there
            let due = if i == 0 { !R::nothing() } else { R::from_f64(i as f64 - 0.5).lt(next) };
            for (slot, place) in pos_m.iter_mut().zip(self.places[marker]) {
                *slot = R::select(due, R::from_f64(place), *slot);
            }
        }
        Setpoint { pos_m, yaw_rad: R::zero() }
    }

    #[inline(always)]
    fn judge<R: Scalar>(&self, own: usize, s: &Situation<R>, scene: &Scene<R>) -> Outcome<R> {
        let error_m = distance(&s.x.pos_m, &s.setpoint.pos_m);
        let markers = &self.places;
        let (mut left, mut found) = (R::zero(), R::zero());
        let [height, near] = self.limits(scene.board);
        for (looked, [x, y]) in scene.board.iter().zip(markers) {
            left += R::from_f64(1.0) - *looked;
            // the board is of before this tick: what is near now and not yet on it is new
            let place = [R::from_f64(*x), R::from_f64(*y), height];
            let new = distance(&scene.drones[own].pos_m, &place).lt(near) & looked.le(R::zero());
            found += R::select(new, R::from_f64(1.0), R::zero());
        }
        let way = R::from_f64(0.01) / (R::from_f64(1.0) + error_m);
        let all = left.lt(R::from_f64(0.5));
        Outcome { reward: found + way - R::from_f64(0.005) * jerk(s), error_m, arrived: all, ends: all }
    }
}

impl Cover {
    /// Height to fly at, and how near a marker must be.
    #[inline(always)]
    fn limits<R: Scalar>(&self, board: &[R]) -> [R; 2] {
        let first = self.places.len() + self.drones;
        [board[first], board[first + 1]]
    }

    /// The markers that a drone is to look at.
    #[inline(always)]
    fn share(&self, drone: usize) -> std::ops::Range<usize> {
        let n = self.places.len();
        drone * n / self.drones..(drone + 1) * n / self.drones
    }
}
