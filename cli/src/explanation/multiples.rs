//! Small multiples: the residual of every test flight, channel by channel, on one scale per channel.

use crazyflie_identify::explain::signals::HORIZONS as JUDGED;
use crazyflie_identify::explain::verdict::Explanation;
use crazyflie_identify::fit::flight::{Flight, WINDOW_S};
use crazyflie_picture::{BLUE, Drawing, GREY, Panel, PictureError, Style, VERMILION, chart};
use minijinja::{Value, context};

use super::error_view::flight_pointer;
use super::figures::{figure, liveliest_flight};
use super::series::{Curve, SHOWN, channel, residuals, without_disturbances};
use super::view::Cell;
use super::words::significant;
use super::{Run, sentence};

/// A frame contains this share of the points, the others are outliers.
const WITHIN: f64 = 0.995;
/// Width of a panel and height of its plot.
const SIZE_PX: [f64; 2] = [340.0, 90.0];
/// Points of a curve that a panel of this size can show.
const MAX_POINTS: usize = 300;
/// Rows of the components' errors, in the order of [`SHOWN`].
const COMPONENTS: [usize; 6] = [0, 1, 2, 6, 7, 8];

/// Curves of a flight per channel, before and after.
type Residuals = [[Vec<Curve>; 6]; 2];

/// A row per test flight.
pub(super) fn flight_rows(run: &Run) -> Result<Vec<Value>, PictureError> {
    let all: Vec<Residuals> =
        run.test.flights.iter().map(|flight| before_and_after(&run.found, flight)).collect();
    let frames: [f64; 6] = std::array::from_fn(|at| frame(&all, at));
    let row = |(i, residuals): (usize, &Residuals)| {
        let flight = &run.test.flights[i];
        let length_s = flight.ticks as f64 * flight.tick_s;
        let panels = SHOWN.map(|at| panel(at, residuals, length_s, frames[at], ["", ""]));
        let drawn = figure(&panels, SIZE_PX)?.unwrap_or_default();
        let plot = |((at, component), svg): ((usize, usize), String)| {
            let (channel, unit, one) = channel(at);
            let error = |when: &str, table: &[[f64; 5]; 9]| {
                let error = table[component][JUDGED[1]];
                Cell::new(significant(error / one, 2), error, flight_pointer(i, when, component, JUDGED[1]))
            };
            let errors = &run.found.errors.flights[i];
            // 2 s ahead
            let (before, after) = (error("before", &errors.before), error("after", &errors.after));
            context!(channel, unit, before, after, svg)
        };
        let plots: Vec<Value> = SHOWN.into_iter().zip(COMPONENTS).zip(drawn).map(plot).collect();
        Ok(context!(name => flight.name.as_str(), plots))
    };
    all.iter().enumerate().map(row).collect()
}

/// The residuals of the liveliest test flight with the declared and with the completed model, under the answer.
///
/// # Errors
/// [`PictureError::Empty`] without a test flight.
pub(crate) fn picture(run: &Run) -> Result<Drawing, PictureError> {
    let panels = liveliest_flight(&run.test.flights).map_or_else(Vec::new, |flight| {
        let residuals = before_and_after(&run.found, flight);
        let length_s = flight.ticks as f64 * flight.tick_s;
        let measured = SHOWN.into_iter().filter(|at| !residuals[0][*at].is_empty());
        let names = ["declared model", "completed model"];
        let frame = |at| frame(std::slice::from_ref(&residuals), at);
        measured.map(|at| panel(at, &residuals, length_s, frame(at), names)).collect()
    });
    let answer = sentence(&run.found);
    let named = answer.split_once(". ").map_or(answer.as_str(), |(named, _)| named);
    chart(&panels, 3, &format!("{named}. Measured less predicted, windows of {WINDOW_S} s"))
}

fn before_and_after(found: &Explanation, flight: &Flight) -> Residuals {
    [&found.declared, &found.completed]
        .map(|hypothesis| residuals(&without_disturbances(hypothesis), flight).unwrap_or_default())
}

/// Returns the half height that contains all but the outliers of a channel, over all flights.
fn frame(all: &[Residuals], at: usize) -> f64 {
    let curves = all.iter().flatten().flat_map(|channels| &channels[at]);
    let mut sizes: Vec<f64> =
        curves.flat_map(|c| c.y.iter().map(|y| y.abs())).filter(|y| y.is_finite()).collect();
    sizes.sort_by(f64::total_cmp);
    let max = sizes.get((WITHIN * sizes.len() as f64) as usize).or(sizes.last()).copied().unwrap_or(1.0);
    1.1 * max.max(1e-9)
}

/// The residuals of a channel, window by window, before and after under their names.
fn panel(at: usize, residuals: &Residuals, length_s: f64, frame: f64, names: [&str; 2]) -> Panel {
    let (name, unit, _) = channel(at);
    let mut panel = Panel::new("time (s)", format!("{name} ({unit})"))
        .curve(Style::Solid, GREY, "", [0.0, length_s], [0.0, 0.0])
        .x_limits([0.0, length_s])
        .y_limits([-frame, frame]);
    for ((curves, color), mut name) in residuals.iter().zip([VERMILION, BLUE]).zip(names) {
        let points: usize = curves[at].iter().map(|curve| curve.x.len()).sum();
        let every = points.div_ceil(MAX_POINTS).max(1);
        for curve in curves[at].iter().filter(|curve| !curve.x.is_empty()) {
            let (x, y) = (curve.x.iter().step_by(every), curve.y.iter().step_by(every));
            panel = panel.curve(Style::Solid, color, std::mem::take(&mut name), x, y);
        }
    }
    panel
}
