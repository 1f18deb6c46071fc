//! Fewer points, the same picture; and curves cut at the edges of their plot.

use std::collections::HashSet;

use crate::drawing::Point;

/// A line whose points run backwards somewhere may keep this many points; more is a black patch anyway.
const MAX_POINTS: usize = 6000;
/// A series may keep so many dots; each takes ten times the text of a point on a line.
const MAX_DOTS: usize = 2500;

/// Points of a line as they appear on the page, thinned to what columns of one pixel can show.
///
/// While x never decreases, each column keeps its first, lowest, highest and last point, so that no peak is
/// lost. Otherwise it is thinned as a [`curve`].
pub(crate) fn line(points: Vec<Point>) -> Vec<Point> {
    if !points.is_sorted_by(|a, b| a[0] <= b[0]) {
        return curve(&points);
    }
    let mut kept = Vec::new();
    for column in points.chunk_by(|a, b| a[0].floor() == b[0].floor()) {
        let by_y = |a: &usize, b: &usize| column[*a][1].total_cmp(&column[*b][1]);
        let (low, high) = ((0..column.len()).min_by(by_y), (0..column.len()).max_by(by_y));
        let mut chosen = [0, low.unwrap_or(0), high.unwrap_or(0), column.len() - 1];
        chosen.sort_unstable();
        kept.extend(chosen.chunk_by(|a, b| a == b).map(|same| column[same[0]]));
    }
    kept
}

/// A curve that may run in any direction: points nearer than half a pixel to the last one kept are dropped,
/// or farther ones if there are still too many.
pub(crate) fn curve(points: &[Point]) -> Vec<Point> {
    let mut apart = 0.5;
    loop {
        let mut kept: Vec<Point> = Vec::new();
        for (i, [x, y]) in points.iter().enumerate() {
            let far = kept.last().is_none_or(|last| (x - last[0]).hypot(y - last[1]) >= apart);
            if far || i + 1 == points.len() {
                kept.push([*x, *y]);
            }
        }
        if kept.len() <= MAX_POINTS {
            return kept;
        }
        apart *= 1.5;
    }
}

/// Dots of which no two share a cell; cells are a pixel wide, or larger if there are still too many dots.
pub(crate) fn dots(points: &[Point]) -> Vec<Point> {
    let mut cell = 1.0;
    loop {
        let mut taken = HashSet::new();
        let is_new = |point: &&Point| taken.insert(point.map(|v| (v / cell).floor() as i64));
        let kept: Vec<Point> = points.iter().filter(is_new).copied().collect();
        if kept.len() <= MAX_DOTS {
            return kept;
        }
        cell *= 1.5;
    }
}

/// The parts of a curve that lie within a width and a height; where it crosses an edge, it ends on the edge.
pub(crate) fn cut(points: &[Point], size: Point) -> Vec<Vec<Point>> {
    let mut parts: Vec<Vec<Point>> = Vec::new();
    for pair in points.windows(2) {
        let Some([from, to]) = inside(pair[0], pair[1], size) else { continue };
        match parts.last_mut() {
            Some(part) if part.last() == Some(&from) => part.push(to),
            _ => parts.push(vec![from, to]),
        }
    }
    parts
}

/// The part of a segment within the box (Liang and Barsky 1984).
fn inside(a: Point, b: Point, size: Point) -> Option<[Point; 2]> {
    let step = [b[0] - a[0], b[1] - a[1]];
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for axis in [0, 1] {
        for (step, room) in [(-step[axis], a[axis]), (step[axis], size[axis] - a[axis])] {
            if step < 0.0 {
                enter = enter.max(room / step);
            } else if step > 0.0 {
                leave = leave.min(room / step);
            } else if room < 0.0 {
                return None;
            }
        }
    }
    // the ends themselves, to the bit, where nothing is cut off: parts are joined by them
    let point = |t: f64| [a[0] + t * step[0], a[1] + t * step[1]];
    let from = if enter == 0.0 { a } else { point(enter) };
    let to = if leave == 1.0 { b } else { point(leave) };
    (enter <= leave).then_some([from, to])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_spike_survives() {
        let mut points: Vec<Point> = (0..100_000).map(|i| [f64::from(i) * 0.004, 0.0]).collect();
        points[43_210][1] = 9.0;
        let kept = line(points.clone());
        assert!(kept.len() < 1700);
        assert!(kept.contains(&points[43_210]));
        assert_eq!((kept.first(), kept.last()), (points.first(), points.last()));
    }

    #[test]
    fn few_points_stay_as_they_are() {
        let points = vec![[0.0, 1.0], [5.0, 2.0], [9.0, -1.0]];
        assert_eq!(line(points.clone()), points);
    }

    #[test]
    fn curves_that_turn_back_and_dots_are_bounded() {
        let spiral = |i: u32| {
            let a = f64::from(i) * 0.01;
            [200.0 + 0.2 * a * a.cos(), 200.0 + 0.2 * a * a.sin()]
        };
        let points: Vec<Point> = (0..100_000).map(spiral).collect();
        let kept = line(points.clone());
        assert!(kept.len() <= MAX_POINTS && kept.last() == points.last());
        assert!(dots(&points).len() <= MAX_DOTS);
    }

    #[test]
    fn curves_end_on_the_edge_and_come_back() {
        let parts = cut(&[[0.0, 5.0], [2.0, 5.0], [4.0, 15.0], [6.0, 15.0], [8.0, 5.0]], [10.0, 10.0]);
        assert_eq!(parts, [vec![[0.0, 5.0], [2.0, 5.0], [3.0, 10.0]], vec![[7.0, 10.0], [8.0, 5.0]]]);
        assert!(cut(&[[0.0, 20.0], [9.0, 20.0]], [10.0, 10.0]).is_empty());
    }
}
