//! Small multiples: the residual of every test flight, channel by channel, on one scale per channel.

use std::fmt::Write;

use crazyflie_identify::explain::signals::HORIZONS as JUDGED;
use crazyflie_identify::fit::hypothesis::Hypothesis;
use serde::Serialize;

use super::Run;
use super::error_view::flight_pointer;
use super::series::{Curve, SHOWN, channel, residuals, without_disturbances};
use super::view::Cell;
use super::words::significant;
use crate::text::number;

/// A frame holds this share of the points, the others are outliers.
const WITHIN: f64 = 0.995;
/// A picture's own units: wide, and high to each side of zero.
const WIDE: f64 = 600.0;
const HALF: f64 = 100.0;
/// Points of a curve that a picture of this size can show.
const MAX_POINTS: usize = 300;
/// Rows of the components' errors, in the order of [`SHOWN`].
const COMPONENTS: [usize; 6] = [0, 1, 2, 6, 7, 8];

#[derive(Serialize)]
pub(super) struct FlightRow {
    name: String,
    duration: String,
    plots: Vec<Plot>,
}

#[derive(Serialize)]
struct Plot {
    channel: &'static str,
    unit: &'static str,
    /// Errors 2 s ahead.
    before: Cell,
    after: Cell,
    /// Half height of the picture, in the unit.
    frame: String,
    /// Curves as data of SVG paths.
    declared: String,
    completed: String,
}

/// Curves of a flight per channel, before and after.
type Residuals = [[Vec<Curve>; 6]; 2];

/// A row per test flight.
pub(super) fn flight_rows(run: &Run) -> Vec<FlightRow> {
    let found = &run.found;
    let (declared, completed) =
        (without_disturbances(&found.declared), without_disturbances(&found.completed));
    let residuals_of = |hypothesis: &Hypothesis, flight| residuals(hypothesis, flight).unwrap_or_default();
    let all: Vec<Residuals> =
        run.test.flights.iter().map(|f| [residuals_of(&declared, f), residuals_of(&completed, f)]).collect();
    let frames: [f64; 6] = std::array::from_fn(|at| frame(&all, at));
    let row = |(i, residuals): (usize, &Residuals)| {
        let flight = &run.test.flights[i];
        let length_s = flight.ticks as f64 * flight.tick_s;
        let plot = |(at, component): (usize, usize)| {
            let (name, unit, one) = channel(at);
            let error = |when: &str, table: &[[f64; 5]; 9]| {
                let error = table[component][JUDGED[1]];
                Cell::new(significant(error / one, 2), error, flight_pointer(i, when, component, JUDGED[1]))
            };
            let errors = &found.errors.flights[i];
            let [declared, completed] =
                residuals.each_ref().map(|curves| path(&curves[at], length_s, frames[at]));
            let (before, after) = (error("before", &errors.before), error("after", &errors.after));
            Plot {
                channel: name,
                unit,
                before,
                after,
                frame: significant(frames[at], 2),
                declared,
                completed,
            }
        };
        FlightRow {
            name: flight.name.clone(),
            duration: number(length_s, 0),
            plots: SHOWN.into_iter().zip(COMPONENTS).map(plot).collect(),
        }
    };
    all.iter().enumerate().map(row).collect()
}

/// Half height that holds all but the outliers of a channel, over all flights.
fn frame(all: &[Residuals], at: usize) -> f64 {
    let curves = all.iter().flatten().flat_map(|channels| &channels[at]);
    let mut sizes: Vec<f64> =
        curves.flat_map(|c| c.y.iter().map(|y| y.abs())).filter(|y| y.is_finite()).collect();
    sizes.sort_by(f64::total_cmp);
    let max = sizes.get((WITHIN * sizes.len() as f64) as usize).or(sizes.last()).copied().unwrap_or(1.0);
    // two digits say it: the picture is drawn to what is written beside it
    significant(1.1 * max.max(1e-9), 2).parse().unwrap_or(max)
}

/// Curves as data of an SVG path; what leaves the frame is cut there by the picture's edge.
fn path(curves: &[Curve], length_s: f64, frame: f64) -> String {
    let points: usize = curves.iter().map(|c| c.x.len()).sum();
    let every = points.div_ceil(MAX_POINTS).max(1);
    let mut data = String::new();
    for curve in curves {
        let last = curve.x.len().saturating_sub(1);
        let kept = (0..curve.x.len()).filter(|i| i % every == 0 || *i == last);
        for (n, i) in kept.enumerate() {
            let x = WIDE * curve.x[i] / length_s;
            let y = HALF - (HALF * curve.y[i] / frame).clamp(-3.0 * HALF, 3.0 * HALF);
            let _ = write!(data, "{}{x:.0} {y:.0}", if n == 0 { 'M' } else { 'L' });
        }
    }
    data
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_that_ends_at_the_frame_ends_at_the_pictures_edge() {
        let curve = Curve { x: vec![0.0, 1.0, 2.0], y: vec![0.0, 0.5, -9.0] };
        assert_eq!(path(std::slice::from_ref(&curve), 2.0, 0.5), "M0 100L300 0L600 400");
        let long = Curve { x: (0..3000).map(f64::from).collect(), y: vec![0.0; 3000] };
        assert!(path(&[long, curve], 3000.0, 0.5).matches('L').count() <= MAX_POINTS + 3);
    }
}
