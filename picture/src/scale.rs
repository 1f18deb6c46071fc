//! What the x axis of a panel counts, and curves cut at its limits.

use crate::PictureError;
use crate::axis::{Axis, span};
use crate::panel::Panel;

/// What an x axis counts.
#[derive(Debug, Clone, Copy, Default)]
pub enum Scale<'a> {
    /// Amounts.
    #[default]
    Linear,
    /// Amounts above zero by their decimal logarithm, as the frequencies of a Bode plot.
    Log,
    /// Names side by side: the first stands at x = 0, the next at 1.
    Categories(&'a [&'a str]),
}

impl Scale<'_> {
    /// Where an x stands in the units of the axis.
    pub(crate) fn position(self, x: f64) -> f64 {
        match self {
            Scale::Log => x.log10(),
            Scale::Linear | Scale::Categories(_) => x,
        }
    }

    /// Refuses what has no place on the axis.
    pub(crate) fn check(self, what: &str, x: &[f64]) -> Result<(), PictureError> {
        let (low, high) = match self {
            Scale::Linear => return Ok(()),
            Scale::Log => (f64::MIN_POSITIVE, f64::MAX),
            Scale::Categories(names) => (-0.5, names.len() as f64 - 0.5),
        };
        let Some(index) = x.iter().position(|x| !(low..=high).contains(x)) else { return Ok(()) };
        Err(PictureError::OutOfRange { what: what.to_owned(), index, value: x[index], low, high })
    }
}

/// The x axis of a panel, with about so many numbers.
pub(crate) fn x_axis(panel: &Panel, numbers: usize) -> Axis {
    let own = panel.series.iter().flat_map(|s| s.x.iter().copied());
    let limits = panel.x_limits.into_iter().flatten();
    let values = if panel.x_limits.is_some() { limits.collect() } else { own.collect::<Vec<_>>() };
    match panel.x_scale {
        Scale::Linear => Axis::tidy(span(values.into_iter()), numbers),
        Scale::Log => Axis::decades(span(values.into_iter().map(f64::log10))),
        Scale::Categories(names) => Axis::categories(names),
    }
}

/// The parts of a curve that lie within a width and a height; where it crosses an edge, it ends on the edge.
pub(crate) fn cut(points: &[(f64, f64)], width: f64, height: f64) -> Vec<Vec<(f64, f64)>> {
    let mut parts: Vec<Vec<(f64, f64)>> = Vec::new();
    for pair in points.windows(2) {
        let Some((from, to)) = inside(pair[0], pair[1], width, height) else { continue };
        match parts.last_mut() {
            Some(part) if part.last() == Some(&from) => part.push(to),
            _ => parts.push(vec![from, to]),
        }
    }
    parts
}

/// The part of a segment within the box (Liang and Barsky 1984).
fn inside(a: (f64, f64), b: (f64, f64), width: f64, height: f64) -> Option<((f64, f64), (f64, f64))> {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for (step, room) in [(-dx, a.0), (dx, width - a.0), (-dy, a.1), (dy, height - a.1)] {
        if step == 0.0 {
            if room < 0.0 {
                return None;
            }
        } else if step < 0.0 {
            enter = enter.max(room / step);
        } else {
            leave = leave.min(room / step);
        }
    }
    // the ends themselves, to the bit, where nothing is cut off: parts are joined by them
    let at = |t: f64| (a.0 + t * dx, a.1 + t * dy);
    let from = if enter == 0.0 { a } else { at(enter) };
    let to = if leave == 1.0 { b } else { at(leave) };
    (enter <= leave).then_some((from, to))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_end_on_the_edge_and_come_back() {
        let parts = cut(&[(0.0, 5.0), (2.0, 5.0), (4.0, 15.0), (6.0, 15.0), (8.0, 5.0)], 10.0, 10.0);
        assert_eq!(parts, [vec![(0.0, 5.0), (2.0, 5.0), (3.0, 10.0)], vec![(7.0, 10.0), (8.0, 5.0)]]);
        assert!(cut(&[(0.0, 20.0), (9.0, 20.0)], 10.0, 10.0).is_empty());
    }
}
