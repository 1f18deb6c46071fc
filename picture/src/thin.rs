//! Fewer points, the same picture.

use std::collections::HashSet;

/// A line whose points run backwards somewhere may keep this many points; more is a black patch anyway.
const MOST: usize = 6000;
/// So many dots may a series keep; each takes ten times the text of a point on a line.
const MOST_DOTS: usize = 2500;

/// Points of a line as they appear on the page, thinned to what `column_px` wide columns can show.
///
/// While x never decreases, each column keeps its first, lowest, highest and last point, so that no peak is
/// lost. Otherwise it is thinned as a [`curve`].
pub(crate) fn line(points: Vec<(f64, f64)>, column_px: f64) -> Vec<(f64, f64)> {
    if points.windows(2).all(|pair| pair[0].0 <= pair[1].0) {
        return by_column(&points, column_px);
    }
    curve(points)
}

/// A curve that may run in any direction: points nearer than half a pixel to the last one kept are dropped,
/// or farther ones if there are still too many.
pub(crate) fn curve(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let mut apart = 0.5;
    loop {
        let kept = by_distance(&points, apart);
        if kept.len() <= MOST {
            return kept;
        }
        apart *= 1.5;
    }
}

/// Dots of which no two share a cell; cells are `cell_px` wide, or larger if there are still too many dots.
pub(crate) fn dots(points: Vec<(f64, f64)>, cell_px: f64) -> Vec<(f64, f64)> {
    let mut cell = cell_px;
    loop {
        let mut taken = HashSet::new();
        let cell_of = |(x, y): &(f64, f64)| ((x / cell).floor() as i64, (y / cell).floor() as i64);
        let kept: Vec<(f64, f64)> = points.iter().filter(|p| taken.insert(cell_of(p))).copied().collect();
        if kept.len() <= MOST_DOTS {
            return kept;
        }
        cell *= 1.5;
    }
}

fn by_column(points: &[(f64, f64)], column_px: f64) -> Vec<(f64, f64)> {
    let column = |index: usize| (points[index].0 / column_px).floor();
    let mut kept = Vec::new();
    let mut start = 0;
    while start < points.len() {
        let end = (start..points.len()).find(|i| column(*i) != column(start)).unwrap_or(points.len());
        let by_y = |a: &usize, b: &usize| points[*a].1.total_cmp(&points[*b].1);
        let low = (start..end).min_by(by_y).unwrap_or(start);
        let high = (start..end).max_by(by_y).unwrap_or(start);
        let mut chosen = [start, low, high, end - 1];
        chosen.sort_unstable();
        let mut before = None;
        for index in chosen {
            if before != Some(index) {
                kept.push(points[index]);
            }
            before = Some(index);
        }
        start = end;
    }
    kept
}

fn by_distance(points: &[(f64, f64)], apart: f64) -> Vec<(f64, f64)> {
    let mut kept: Vec<(f64, f64)> = Vec::new();
    for (i, point) in points.iter().enumerate() {
        let far = kept.last().is_none_or(|last| (point.0 - last.0).hypot(point.1 - last.1) >= apart);
        if far || i + 1 == points.len() {
            kept.push(*point);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_spike_survives() {
        let mut points: Vec<(f64, f64)> = (0..100_000).map(|i| (f64::from(i) * 0.004, 0.0)).collect();
        points[43_210].1 = 9.0;
        let kept = line(points.clone(), 1.0);
        assert!(kept.len() < 1700);
        assert!(kept.contains(&points[43_210]));
        assert_eq!((kept.first(), kept.last()), (points.first(), points.last()));
    }

    #[test]
    fn few_points_stay_as_they_are() {
        let points = vec![(0.0, 1.0), (5.0, 2.0), (9.0, -1.0)];
        assert_eq!(line(points.clone(), 1.0), points);
    }

    #[test]
    fn curves_that_turn_back_and_dots_are_bounded() {
        let spiral = |i: u32| {
            let a = f64::from(i) * 0.01;
            (200.0 + 0.2 * a * a.cos(), 200.0 + 0.2 * a * a.sin())
        };
        let points: Vec<(f64, f64)> = (0..100_000).map(spiral).collect();
        let kept = line(points.clone(), 1.0);
        assert!(kept.len() <= MOST && kept.last() == points.last());
        assert!(dots(points, 1.0).len() <= MOST_DOTS);
    }
}
