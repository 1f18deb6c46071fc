//! The obstacles of the room: gates, poles and boxes, moved a little in every episode; detects whether a drone
//! touches any.

use rand_pcg::Pcg64Mcg;

use super::Options;
use crate::error::{Error, Result, check_range, out_of_range};
use crate::model::{ROOM_M, VEHICLE_RADIUS_M};
use crate::observation::NOTHING_NEAR_M;
use crate::scalar::{Scalar, merge, tabulate};
use crate::task::{Chosen, HEIGHT_M, Outline, jitter, on_circle};

/// Width of a gate's frame.
const FRAME_M: f64 = 0.08;
/// Most of each kind.
const MOST: usize = 16;
/// Numbers on the board.
const GATE: usize = 4;
const POLE: usize = 3;
const BOX: usize = 6;

/// Radius of the circle of the levels' gates.
const CIRCLE_M: f64 = 1.1;
const GATES: usize = 4;

/// The course as configured; its form in an episode is on the board.
pub(super) struct Course {
    gates: Vec<[f64; GATE]>,
    poles: Vec<[f64; POLE]>,
    boxes: Vec<[f64; BOX]>,
    opening_m: f64,
}

impl Course {
    /// Reads the course of a user.
    ///
    /// # Errors
    /// [`Error::Config`] for rows of another form, [`Error::Range`] for too many and for numbers out of range.
    pub(super) fn read(chosen: &Chosen<Options>) -> Result<Self> {
        let [side_m, top_m] = ROOM_M;
        let (place, height, size) = ([-side_m, side_m], [0.0, top_m], [0.01, 2.0 * side_m]);
        let turn = [-std::f64::consts::TAU, std::f64::consts::TAU];
        Ok(Course {
            gates: rows(chosen, "gates", [place, place, height, turn])?,
            poles: rows(chosen, "poles", [place, place, [0.01, 1.0]])?,
            boxes: rows(chosen, "boxes", [place, place, height, size, size, size])?,
            opening_m: 0.0,
        })
    }

    pub(super) fn is_empty(&self) -> bool {
        self.numbers() == 0
    }

    /// With the gates of the level where there are none, and its obstacles where nothing was placed.
    pub(super) fn complete(self, level: usize, opening_m: f64) -> Self {
        let (poles, boxes) =
            if self.is_empty() { (level_poles(level), level_boxes(level)) } else { (self.poles, self.boxes) };
        let gates = if self.gates.is_empty() { level_gates(level) } else { self.gates };
        Course { gates, poles, boxes, opening_m }
    }

    /// Checks that every gate is in the room, and so is the start before the first, `run_up_m` away.
    ///
    /// # Errors
    /// [`Error::Range`] naming the gate.
    pub(super) fn check(&self, shift_m: f64, run_up_m: f64) -> Result<()> {
        let half_m = 0.5 * self.opening_m + FRAME_M;
        let [side_m, top_m] = ROOM_M;
        for (i, [x, y, z, yaw_rad]) in self.gates.iter().copied().enumerate() {
            let back_m = if i == 0 { run_up_m } else { 0.0 };
            let places = [[x, y], [x - back_m * libm::cos(yaw_rad), y - back_m * libm::sin(yaw_rad)]];
            let far_m = places.iter().flatten().fold(0.0, |far: f64, p| far.max(p.abs()));
            let bad = |at: usize, value: f64, want: String| {
                Err(out_of_range(format!("gates[{i}][{at}]"), value, want))
            };
            if far_m + shift_m >= side_m {
                let axis = usize::from(places.iter().any(|p| p[1].abs() == far_m));
                return bad(
                    axis,
                    [x, y][axis],
                    format!("within {side_m} m of the middle, the start {run_up_m} m before it too"),
                );
            }
            let (low_m, high_m) = (half_m + shift_m, top_m - half_m - shift_m);
            if !(low_m..=high_m).contains(&z) {
                return bad(
                    2,
                    z,
                    format!("{low_m:.2} to {high_m:.2}: its frame stands between floor and ceiling"),
                );
            }
        }
        Ok(())
    }

    pub(super) fn gates(&self) -> usize {
        self.gates.len()
    }

    /// Half the width that is free for the drone's middle.
    pub(super) fn free_m(&self) -> f64 {
        0.5 * self.opening_m - VEHICLE_RADIUS_M
    }

    /// Numbers of the board.
    pub(super) fn numbers(&self) -> usize {
        self.boxes_from() + BOX * self.boxes.len()
    }

    fn poles_from(&self) -> usize {
        GATE * self.gates.len()
    }

    fn boxes_from(&self) -> usize {
        self.poles_from() + POLE * self.poles.len()
    }

    /// The course of an episode onto the board; returns its first gate.
    pub(super) fn draw(
        &self,
        shift_m: f64,
        turn_rad: f64,
        rng: &mut Pcg64Mcg,
        board: &mut [f64],
    ) -> [f64; GATE] {
        let (gates, rest) = board.split_at_mut(self.poles_from());
        let (poles, boxes) = rest.split_at_mut(POLE * self.poles.len());
        for (out, [x, y, z, yaw_rad]) in gates.chunks_exact_mut(GATE).zip(&self.gates) {
            let ([dx, dy, dz], [turn]) = (jitter(rng, shift_m), jitter(rng, turn_rad));
            out.copy_from_slice(&[x + dx, y + dy, z + dz, yaw_rad + turn]);
        }
        for (out, [x, y, radius_m]) in poles.chunks_exact_mut(POLE).zip(&self.poles) {
            let [dx, dy] = jitter(rng, shift_m);
            out.copy_from_slice(&[x + dx, y + dy, *radius_m]);
        }
        for (out, [x, y, z, size @ ..]) in boxes.chunks_exact_mut(BOX).zip(&self.boxes) {
            let [dx, dy] = jitter(rng, shift_m);
            out[..3].copy_from_slice(&[x + dx, y + dy, *z]);
            out[3..].copy_from_slice(&size.map(|s| 0.5 * s));
        }
        [gates[0], gates[1], gates[2], gates[3]]
    }

    /// Returns gate `i` from the board.
    #[inline(always)]
    pub(super) fn gate<R: Scalar>(&self, board: &[R], i: usize) -> Gate<R> {
        let first = GATE * i;
        Gate::new([board[first], board[first + 1], board[first + 2]], board[first + 3])
    }

    /// Inner edges of the gates, axes of the poles with a ring at both ends, edges of the boxes.
    pub(super) fn outlines(&self, board: &[f64]) -> Vec<Outline> {
        let gates = (0..self.gates.len()).map(|i| self.gate(board, i).square(0.5 * self.opening_m));
        let poles = board[self.poles_from()..self.boxes_from()].chunks_exact(POLE).flat_map(pole_lines);
        let boxes = board[self.boxes_from()..].chunks_exact(BOX).flat_map(box_lines);
        gates.chain(poles).chain(boxes).collect()
    }

    /// Returns whether a drone touched anything on its way.
    #[inline(always)]
    pub(super) fn is_hit<R: Scalar>(&self, board: &[R], before_m: &[R; 3], now_m: &[R; 3]) -> R::Mask {
        let mut hit = R::nothing();
        let (free_m, frame_m) = (self.free_m(), 0.5 * self.opening_m + FRAME_M + VEHICLE_RADIUS_M);
        for i in 0..self.gates.len() {
            hit = hit | self.gate(board, i).is_frame_hit(before_m, now_m, [free_m, frame_m]);
        }
        let way = self.nearest_obstacle(board, now_m);
        let away2 = way[0] * way[0] + way[1] * way[1] + way[2] * way[2];
        hit | away2.lt(R::from_f64(VEHICLE_RADIUS_M * VEHICLE_RADIUS_M))
    }

    /// From a place to the nearest point of the nearest pole or box; [`NOTHING_NEAR_M`] along each axis where
    /// there is none.
    #[inline(always)]
    pub(super) fn nearest_obstacle<R: Scalar>(&self, board: &[R], pos_m: &[R; 3]) -> [R; 3] {
        let mut best = [R::from_f64(NOTHING_NEAR_M); 3];
        let mut best2 = R::from_f64(3.0 * NOTHING_NEAR_M * NOTHING_NEAR_M);
        let mut take = |way: [R; 3]| {
            let away2 = way[0] * way[0] + way[1] * way[1] + way[2] * way[2];
            let nearer = away2.lt(best2);
            best2 = R::select(nearer, away2, best2);
            for (slot, number) in best.iter_mut().zip(way) {
                *slot = R::select(nearer, number, *slot);
            }
        };
        for pole in board[self.poles_from()..self.boxes_from()].chunks_exact(POLE) {
            let [dx, dy] = [pole[0] - pos_m[0], pole[1] - pos_m[1]];
            let middle_m = (dx * dx + dy * dy).sqrt().max(R::from_f64(1e-6));
            // within the pole it is at the surface
            let share = ((middle_m - pole[2]) / middle_m).max(R::zero());
            take([dx * share, dy * share, R::zero()]);
        }
        for block in board[self.boxes_from()..].chunks_exact(BOX) {
            take(tabulate(
                #[inline(always)]
                |i| {
                    let d = block[i] - pos_m[i];
                    d - d.clamp(-block[3 + i], block[3 + i])
                },
            ));
        }
        best
    }
}

/// A square frame, and the direction to fly through it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gate<R> {
    pub(super) pos_m: [R; 3],
    pub(super) yaw_rad: R,
    sin: R,
    cos: R,
}

impl<R: Scalar> Gate<R> {
    #[inline(always)]
    fn new(pos_m: [R; 3], yaw_rad: R) -> Self {
        let (sin, cos) = yaw_rad.sin_cos();
        Gate { pos_m, yaw_rad, sin, cos }
    }

    #[inline(always)]
    pub(super) fn or_where(self, mask: R::Mask, other: &Self) -> Self {
        Gate {
            pos_m: merge(mask, self.pos_m, other.pos_m),
            yaw_rad: R::select(mask, other.yaw_rad, self.yaw_rad),
            sin: R::select(mask, other.sin, self.sin),
            cos: R::select(mask, other.cos, self.cos),
        }
    }

    /// A point on the line through its middle; positive behind it.
    #[inline(always)]
    pub(super) fn point(&self, depth_m: R) -> [R; 3] {
        let [x, y, z] = self.pos_m;
        [x + depth_m * self.cos, y + depth_m * self.sin, z]
    }

    #[inline(always)]
    pub(super) fn distance(&self, pos_m: &[R; 3]) -> R {
        crate::task::distance(pos_m, &self.pos_m)
    }

    /// Returns the distance behind its plane.
    #[inline(always)]
    pub(super) fn depth(&self, pos_m: &[R; 3]) -> R {
        (pos_m[0] - self.pos_m[0]) * self.cos + (pos_m[1] - self.pos_m[1]) * self.sin
    }

    /// Returns the distance from the line through its middle, sideways or up, whichever is larger.
    #[inline(always)]
    fn off(&self, pos_m: &[R; 3]) -> R {
        let side = (pos_m[1] - self.pos_m[1]) * self.cos - (pos_m[0] - self.pos_m[0]) * self.sin;
        side.abs().max((pos_m[2] - self.pos_m[2]).abs())
    }

    /// Returns the point at which a path crosses its plane, if it does.
    #[inline(always)]
    fn piercing(&self, before_m: &[R; 3], depths_m: [R; 2], now_m: &[R; 3]) -> [R; 3] {
        let span = depths_m[1] - depths_m[0];
        let tiny = R::from_f64(1e-9);
        let share = -depths_m[0] / R::select(span.abs().lt(tiny), R::from_f64(1.0), span);
        let share = share.clamp(R::zero(), R::from_f64(1.0));
        tabulate(
            #[inline(always)]
            |i| before_m[i] + share * (now_m[i] - before_m[i]),
        )
    }

    /// Flown through in the right direction, with the drone's middle within `free_m` of its own.
    #[inline(always)]
    pub(super) fn is_passed(&self, before_m: &[R; 3], now_m: &[R; 3], free_m: f64) -> R::Mask {
        let depths_m = [self.depth(before_m), self.depth(now_m)];
        let off_m = self.off(&self.piercing(before_m, depths_m, now_m));
        depths_m[0].lt(R::zero()) & R::zero().le(depths_m[1]) & off_m.le(R::from_f64(free_m))
    }

    /// Returns whether the drone's middle was within `ring_m` of the line when it crossed the frame's plane.
    #[inline(always)]
    fn is_frame_hit(&self, before_m: &[R; 3], now_m: &[R; 3], ring_m: [f64; 2]) -> R::Mask {
        let depths_m = [self.depth(before_m), self.depth(now_m)];
        let pierces = (depths_m[0] * depths_m[1]).le(R::zero());
        let inside = depths_m[1].abs().lt(R::from_f64(0.5 * FRAME_M));
        let is_on_frame = |off_m: R| R::from_f64(ring_m[0]).lt(off_m) & off_m.lt(R::from_f64(ring_m[1]));
        (pierces & is_on_frame(self.off(&self.piercing(before_m, depths_m, now_m))))
            | (inside & is_on_frame(self.off(now_m)))
    }
}

impl Gate<f64> {
    /// A square about its middle, closed.
    fn square(&self, half_m: f64) -> Outline {
        let [x, y, z] = self.pos_m;
        [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]]
            .map(|[side, up]| {
                let side_m = side * half_m;
                [x - side_m * self.sin, y + side_m * self.cos, z + up * half_m]
            })
            .to_vec()
    }
}

fn pole_lines(pole: &[f64]) -> Vec<Outline> {
    let [x, y, radius_m] = [pole[0], pole[1], pole[2]];
    let ring = |z: f64| {
        let point = |i: usize| {
            let [dx, dy] = on_circle(i, 12, radius_m, 0.0);
            [x + dx, y + dy, z]
        };
        (0..=12).map(point).collect()
    };
    vec![ring(0.0), ring(ROOM_M[1]), vec![[x, y, 0.0], [x, y, ROOM_M[1]]]]
}

/// Floor, top, and the four edges between them.
fn box_lines(block: &[f64]) -> Vec<Outline> {
    let corner =
        |[i, j, k]: [f64; 3]| [block[0] + i * block[3], block[1] + j * block[4], block[2] + k * block[5]];
    let around = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]];
    let level = |k: f64| around.map(|[i, j]| corner([i, j, k])).to_vec();
    let edges = around[..4].iter().map(|[i, j]| vec![corner([*i, *j, -1.0]), corner([*i, *j, 1.0])]);
    [level(-1.0), level(1.0)].into_iter().chain(edges).collect()
}

/// Rows of a list, number by number within `bounds`.
fn rows<const N: usize>(
    chosen: &Chosen<Options>,
    name: &str,
    bounds: [[f64; 2]; N],
) -> Result<Vec<[f64; N]>> {
    let rows = chosen.list::<Vec<f64>>(name)?;
    if rows.len() > MOST {
        return Err(out_of_range(
            format!("the number of {name}"),
            rows.len() as f64,
            format!("at most {MOST}"),
        ));
    }
    let row = |(i, row): (usize, Vec<f64>)| {
        let numbers: [f64; N] = row.try_into().map_err(|row: Vec<f64>| {
            Error::Config(format!(
                "options of the task race: {name}[{i}] has {} numbers, expected {N}",
                row.len()
            ))
        })?;
        for (j, (value, [low, high])) in numbers.iter().zip(bounds).enumerate() {
            check_range(&format!("{name}[{i}][{j}]"), *value, low, high)?;
        }
        Ok(numbers)
    };
    rows.into_iter().enumerate().map(row).collect()
}

fn level_gates(level: usize) -> Vec<[f64; GATE]> {
    let gate = |i: usize| {
        let [x, y] = on_circle(i, GATES, CIRCLE_M, 0.0);
        // along the circle
        let yaw_rad = std::f64::consts::TAU * (i as f64 / GATES as f64 + 0.25);
        let rise_m = if level < 4 { 0.3 } else { [0.1, 0.8, 0.3, 1.1][i % GATES] };
        [x, y, HEIGHT_M + rise_m, yaw_rad]
    };
    (0..GATES).map(gate).collect()
}

/// Between the gates, where the shortest way leads.
fn level_poles(level: usize) -> Vec<[f64; POLE]> {
    let pole = |i: usize| {
        let [x, y] = on_circle(i, GATES, 0.8, std::f64::consts::FRAC_PI_4);
        [x, y, 0.05]
    };
    (0..if level < 3 { 0 } else { GATES }).map(pole).collect()
}

/// In the corners, where the longest way leads.
fn level_boxes(level: usize) -> Vec<[f64; BOX]> {
    let block = |i: usize| {
        let [x, y] = on_circle(i, 2, 1.6, std::f64::consts::FRAC_PI_4);
        [x, y, 0.7, 0.4, 0.4, 1.4]
    };
    (0..if level < 4 { 0 } else { 2 }).map(block).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn course(poles: &[[f64; POLE]], boxes: &[[f64; BOX]]) -> (Course, Vec<f64>) {
        use rand::SeedableRng;
        let gates = vec![[1.0, 0.0, 1.0, std::f64::consts::FRAC_PI_2]];
        let course = Course { gates, poles: poles.to_vec(), boxes: boxes.to_vec(), opening_m: 0.6 };
        let mut board = vec![0.0; course.numbers()];
        let gate = course.draw(0.0, 0.0, &mut Pcg64Mcg::seed_from_u64(1), &mut board);
        assert_eq!(gate, course.gates[0]);
        (course, board)
    }

    #[test]
    fn a_gate_is_passed_forwards_within_its_opening_and_hit_at_its_frame() {
        let (course, board) = course(&[], &[]);
        let gate = course.gate(&board, 0);
        let (passes, hits) = (
            |a: [f64; 3], b: [f64; 3]| gate.is_passed(&a, &b, course.free_m()),
            |a: [f64; 3], b: [f64; 3]| course.is_hit(&board, &a, &b),
        );
        // along y, slanting by 10 cm: it pierces the plane at x = 1.15
        let through = ([1.1, -0.05, 1.0], [1.2, 0.05, 1.0]);
        assert!(passes(through.0, through.1) && !hits(through.0, through.1));
        assert!(!passes(through.1, through.0), "backwards");
        // 0.3 m from the middle is the frame, less than 0.231 m is free
        for (x, free, frame) in
            [(1.22, true, false), (1.24, false, true), (1.44, false, true), (1.46, false, false)]
        {
            let way = ([x, -0.05, 1.0], [x, 0.05, 1.0]);
            assert_eq!((passes(way.0, way.1), hits(way.0, way.1)), (free, frame), "at {x}");
            let up = ([1.0, -0.05, x], [1.0, 0.05, x]);
            assert_eq!((passes(up.0, up.1), hits(up.0, up.1)), (free, frame), "at height {x}");
        }
        // beside the frame, along its plane
        assert!(hits([1.6, 0.01, 1.0], [1.4, 0.01, 1.0]));
        assert!(!hits([1.6, 0.2, 1.0], [1.4, 0.2, 1.0]));
    }

    #[test]
    fn the_way_to_the_nearest_obstacle_ends_at_its_surface() {
        let (course, board) = course(&[[0.0, 0.0, 0.1]], &[[0.0, 2.0, 0.5, 0.4, 0.4, 1.0]]);
        let way = |pos_m: [f64; 3]| course.nearest_obstacle(&board, &pos_m);
        let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
        assert!(near(way([0.5, 0.0, 1.5]), [-0.4, 0.0, 0.0]), "a pole has every height");
        assert!(near(way([0.1, 1.7, 1.3]), [0.0, 0.1, -0.3]), "over a box, and before it");
        assert!(near(way([0.1, 1.9, 0.7]), [0.0; 3]), "within");
        assert!(course.is_hit(&board, &[0.0, 0.2, 1.0], &[0.0, 0.16, 1.0]));
        assert!(!course.is_hit(&board, &[0.0, 0.2, 1.0], &[0.0, 0.18, 1.0]));
    }

    #[test]
    fn an_empty_room_has_nothing_near() {
        let (course, board) = course(&[], &[]);
        assert_eq!(course.nearest_obstacle(&board, &[0.0; 3]), [NOTHING_NEAR_M; 3]);
    }
}
