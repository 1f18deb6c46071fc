//! Paths as polynomials of degree seven in place and heading, with their durations.

/// Coefficients of t^0 to t^7.
pub(crate) type Coefficients = [f64; 8];

/// Numbers of a point: x, y, z, heading.
pub(crate) type Point = [f64; 4];

/// One piece of a path.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Piece {
    pub duration_s: f64,
    /// Polynomials of x, y, z, heading.
    pub axes: [Coefficients; 4],
}

/// Position and velocity on a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PathPoint {
    pub at: Point,
    /// Per second.
    pub rate: Point,
}

fn value(c: &Coefficients, t: f64) -> f64 {
    c.iter().rev().fold(0.0, |sum, c| sum * t + c)
}

fn slope(c: &Coefficients, t: f64) -> f64 {
    (1..8).rev().fold(0.0, |sum, k| sum * t + k as f64 * c[k])
}

impl Piece {
    pub(crate) fn point(&self, t_s: f64) -> PathPoint {
        PathPoint { at: self.axes.map(|c| value(&c, t_s)), rate: self.axes.map(|c| slope(&c, t_s)) }
    }

    /// From a point in motion to rest at another, with acceleration and jerk of nothing at both ends.
    pub(crate) fn smooth(from: &PathPoint, to: &Point, duration_s: f64) -> Piece {
        let axes = std::array::from_fn(|i| smooth(from.at[i], from.rate[i], to[i], duration_s));
        Piece { duration_s, axes }
    }

    /// On the straight line to another point, at a constant speed.
    pub(crate) fn straight(from: &PathPoint, to: &Point, duration_s: f64) -> Piece {
        let line = |i: usize| [from.at[i], (to[i] - from.at[i]) / duration_s, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        Piece { duration_s, axes: std::array::from_fn(line) }
    }
}

/// With s = t / T the first four coefficients are the start's; the other four solve position, velocity,
/// acceleration and jerk at s = 1.
fn smooth(p0: f64, v0: f64, p1: f64, duration_s: f64) -> Coefficients {
    let v = v0 * duration_s;
    // the remaining position and velocity at the end, with acceleration and jerk zero
    let (p, dp) = (p1 - p0 - v, -v);
    let ends = [35.0 * p - 15.0 * dp, -84.0 * p + 39.0 * dp, 70.0 * p - 34.0 * dp, -20.0 * p + 10.0 * dp];
    scaled([p0, v, 0.0, 0.0, ends[0], ends[1], ends[2], ends[3]], duration_s)
}

/// Coefficients in t of those in t / T.
fn scaled(mut c: Coefficients, duration_s: f64) -> Coefficients {
    let mut power = 1.0;
    for c in &mut c {
        *c /= power;
        power *= duration_s;
    }
    c
}

/// Coefficients of a Bezier curve with the first control point given apart: degree 0, 1, 3 or 7.
pub(crate) fn bezier(first: f64, others: &[f64], duration_s: f64) -> Coefficients {
    let points: Vec<f64> = std::iter::once(first).chain(others.iter().copied()).collect();
    let n = points.len() - 1;
    let choose = |n: usize, k: usize| (0..k).fold(1.0, |c, i| c * (n - i) as f64 / (i + 1) as f64);
    let mut c = [0.0; 8];
    for (j, c) in c.iter_mut().enumerate().take(n + 1) {
        let sign = |i: usize| if (i + j).is_multiple_of(2) { 1.0 } else { -1.0 };
        *c = choose(n, j) * (0..=j).map(|i| sign(i) * choose(j, i) * points[i]).sum::<f64>();
    }
    scaled(c, duration_s)
}

/// Pieces one after the other, with how they are flown.
#[derive(Debug, Clone)]
pub(crate) struct Path {
    pieces: Vec<Piece>,
    /// Seconds of flight per second of the pieces.
    time_scale: f64,
    reversed: bool,
    /// The pieces' frame: turned by this about their start, then moved.
    turn_rad: f64,
    shift: Point,
}

impl Path {
    pub(crate) fn new(piece: Piece) -> Path {
        Path { pieces: vec![piece], time_scale: 1.0, reversed: false, turn_rad: 0.0, shift: [0.0; 4] }
    }

    /// Pieces of a trajectory; nothing without any, or with times that are none.
    pub(crate) fn trajectory(pieces: Vec<Piece>, time_scale: f64, reversed: bool) -> Option<Path> {
        let fine = |s: f64| s.is_finite() && s > 0.0;
        let flies = !pieces.is_empty() && fine(time_scale) && pieces.iter().all(|p| fine(p.duration_s));
        flies.then_some(Path { pieces, time_scale, reversed, turn_rad: 0.0, shift: [0.0; 4] })
    }

    /// Begins at the place of `start`; turned to its heading as well, if wanted.
    pub(crate) fn begin_at(&mut self, start: &Point, turned: bool) {
        let own = self.point(0.0).at;
        if turned {
            self.turn_rad = start[3] - own[3];
            self.shift[3] = self.turn_rad;
        }
        let now = self.point(0.0).at;
        for i in 0..3 {
            self.shift[i] += start[i] - now[i];
        }
    }

    pub(crate) fn duration_s(&self) -> f64 {
        self.time_scale * self.pieces.iter().map(|piece| piece.duration_s).sum::<f64>()
    }

    /// Returns the path's position so long after its start; it rests at its ends.
    pub(crate) fn point(&self, t_s: f64) -> PathPoint {
        let (whole_s, beyond) = (self.duration_s(), t_s >= self.duration_s());
        let t_s = t_s.clamp(0.0, whole_s);
        let mut left_s = if self.reversed { whole_s - t_s } else { t_s } / self.time_scale;
        let mut piece = &self.pieces[0];
        for next in &self.pieces {
            piece = next;
            if left_s <= next.duration_s {
                break;
            }
            left_s -= next.duration_s;
        }
        let PathPoint { at, rate } = piece.point(left_s.min(piece.duration_s));
        let pace = if beyond { 0.0 } else { (if self.reversed { -1.0 } else { 1.0 }) / self.time_scale };
        let (sin, cos) = self.turn_rad.sin_cos();
        let turned = |[x, y, z, yaw]: Point| [cos * x - sin * y, sin * x + cos * y, z, yaw];
        let at = turned(at);
        PathPoint { at: std::array::from_fn(|i| at[i] + self.shift[i]), rate: turned(rate).map(|r| pace * r) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_smooth_piece_ends_at_rest_where_it_should() {
        let from = PathPoint { at: [0.0, 1.0, 0.5, 0.1], rate: [0.3, -0.2, 0.0, 0.0] };
        let piece = Piece::smooth(&from, &[1.0, 2.0, 0.7, -0.5], 2.5);
        let close = |a: Point, b: Point| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
        assert!(close(piece.point(0.0).at, from.at) && close(piece.point(0.0).rate, from.rate));
        assert!(close(piece.point(2.5).at, [1.0, 2.0, 0.7, -0.5]) && close(piece.point(2.5).rate, [0.0; 4]));
        let (h, end) = (1e-3, piece.point(2.5).rate[0]);
        assert!(((end - piece.point(2.5 - h).rate[0]) / h).abs() < 1e-2, "no acceleration at the end");
    }

    #[test]
    fn a_bezier_curve_goes_through_its_ends_and_along_its_tangents() {
        let c = bezier(1.0, &[2.0, 3.0, 5.0], 2.0);
        assert!((value(&c, 0.0) - 1.0).abs() < 1e-12 && (value(&c, 2.0) - 5.0).abs() < 1e-12);
        assert!((slope(&c, 0.0) - 3.0 * (2.0 - 1.0) / 2.0).abs() < 1e-12);
        assert_eq!(bezier(4.0, &[], 1.0)[0], 4.0);
        let seven = bezier(0.0, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], 1.0);
        assert!((value(&seven, 0.5) - 3.5).abs() < 1e-9, "points on a line are a line");
    }

    #[test]
    fn a_path_is_moved_turned_stretched_and_reversed() {
        let line = Piece::straight(
            &PathPoint { at: [1.0, 0.0, 0.0, 0.0], rate: [0.0; 4] },
            &[2.0, 0.0, 0.0, 0.0],
            1.0,
        );
        let mut path = Path::trajectory(vec![line.clone()], 2.0, false).unwrap();
        path.begin_at(&[5.0, 5.0, 1.0, std::f64::consts::FRAC_PI_2], true);
        let end = path.point(path.duration_s());
        assert_eq!(path.duration_s(), 2.0);
        assert!((end.at[0] - 5.0).abs() < 1e-9 && (end.at[1] - 6.0).abs() < 1e-9, "{end:?}");
        assert!((path.point(1.0).rate[1] - 0.5).abs() < 1e-9 && end.rate == [0.0; 4]);
        let back = Path::trajectory(vec![line], 1.0, true).unwrap();
        assert_eq!((back.point(0.0).at[0], back.point(1.0).at[0]), (2.0, 1.0));
        assert!(Path::trajectory(Vec::new(), 1.0, false).is_none());
    }
}
