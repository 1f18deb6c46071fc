//! Charts: panels in a grid, filled row by row.

use crate::axis::Axis;
use crate::color::{FAINT, FRAME};
use crate::drawing::{Anchor, Drawing, Look, Pen, Point};
use crate::legend::{BAND_OPACITY, Legend};
use crate::panel::{Series, Style};
use crate::{Panel, PictureError, thin};

pub(crate) const TICK_PX: f64 = 11.0;
pub(crate) const LABEL_PX: f64 = 12.5;
pub(crate) const HEAD_PX: f64 = 17.0;
const TITLE_PX: f64 = 14.0;
const MARGIN_PX: f64 = 14.0;
/// Height of the plots, of a panel's title row, of the axis numbers with the axis label, and of the
/// document's title.
const PLOT_PX: f64 = 200.0;
const TITLE_ROW_PX: f64 = 24.0;
const AXIS_PX: f64 = 37.0;
const HEAD_ROW_PX: f64 = 34.0;
/// Diameter of dots.
const DOT_PX: f32 = 3.6;

/// Draws panels in rows of `columns`.
///
/// Axes include all curves, bands and levels. Long series are thinned to what the width can show, keeping
/// every peak. Texts that are too long are set smaller.
///
/// # Errors
/// [`PictureError::Empty`] without panels, for a panel without curves and a series without points,
/// [`PictureError::ZeroSize`] for no columns, [`PictureError::LengthMismatch`], and with the series' name and
/// the element's index [`PictureError::NonFinite`] and [`PictureError::OutOfRange`] (beyond 1e300).
pub fn chart(panels: &[Panel], columns: usize, title: &str) -> Result<Drawing, PictureError> {
    if columns == 0 {
        return Err(PictureError::ZeroSize { width: 0, height: panels.len() });
    }
    let columns = columns.min(panels.len());
    let width = match columns {
        1 => 720.0,
        2 => 480.0,
        _ => 400.0,
    };
    let tiles = tiles(panels, [width, PLOT_PX])?;
    let top = if title.is_empty() { 0.0 } else { HEAD_ROW_PX };
    let height = tiles[0].size_px[1];
    let page = [width * columns as f64, height * panels.len().div_ceil(columns) as f64 + top];
    let mut drawing = Drawing::new(page);
    let middle = [0.5 * page[0], 0.6 * HEAD_ROW_PX];
    drawing.text(title, middle, HEAD_PX, Look::Bold, Anchor::Middle, page[0] - 2.0 * MARGIN_PX);
    for (i, tile) in tiles.into_iter().enumerate() {
        drawing.place(tile, [width * (i % columns) as f64, top + height * (i / columns) as f64]);
    }
    Ok(drawing)
}

/// Draws each panel by itself, all of one size, so that plots line up wherever they are placed. `size_px` is
/// the width of a panel and the height of its plot.
///
/// # Errors
/// The errors of [`chart`].
pub fn tiles(panels: &[Panel], [width, plot_px]: [f64; 2]) -> Result<Vec<Drawing>, PictureError> {
    if panels.is_empty() {
        return Err(PictureError::Empty { what: "the list of panels".to_owned() });
    }
    panels.iter().try_for_each(Panel::check)?;
    let axes: Vec<[Axis; 2]> = panels.iter().map(|panel| panel.axes([width - 60.0, plot_px])).collect();
    let max = |sizes: &mut dyn Iterator<Item = f64>| sizes.fold(0.0, f64::max);
    let numbers = max(&mut axes.iter().map(|[_, y]| TICK_PX * y.longest_em()));
    let left = MARGIN_PX + LABEL_PX + 16.0 + numbers;
    let last = max(&mut axes.iter().map(|[x, _]| TICK_PX * x.longest_em()));
    let right = width - MARGIN_PX.max(0.5 * last + 6.0);
    let legends: Vec<Legend> = panels.iter().map(|panel| legend(panel, right - left)).collect();
    let titled = panels.iter().any(|panel| !panel.title.is_empty());
    let title_row = if titled { TITLE_ROW_PX } else { 0.0 };
    let top = MARGIN_PX + title_row + max(&mut legends.iter().map(Legend::height)) + 4.0;
    let plot = Plot { left, right, top, bottom: top + plot_px };
    let size = [width, plot.bottom + AXIS_PX + MARGIN_PX];
    let drawn = panels.iter().zip(&axes).zip(&legends);
    Ok(drawn.map(|((panel, axes), legend)| plot.draw(Drawing::new(size), panel, axes, legend)).collect())
}

fn legend(panel: &Panel, width: f64) -> Legend<'_> {
    let mut series: Vec<&Series> = panel.series.iter().collect();
    series.sort_by_key(|series| series.style.is_behind());
    Legend::new(series.into_iter().map(|s| (s.label.as_str(), s.style, s.color)), width)
}

/// The part of a panel within its axes, in CSS pixels from the panel's upper left corner.
struct Plot {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
}

impl Plot {
    fn draw(&self, mut drawing: Drawing, panel: &Panel, [x, y]: &[Axis; 2], legend: &Legend) -> Drawing {
        let Plot { left, right, top, bottom } = *self;
        let size = [right - left, bottom - top];
        let heading = [left, top - legend.height() - 0.5 * TITLE_ROW_PX - 4.0];
        drawing.text(&panel.title, heading, TITLE_PX, Look::Bold, Anchor::Start, size[0]);
        legend.draw(&mut drawing, [left, top - 4.0]);
        let room = size[0] / x.ticks.len() as f64;
        for (value, number) in &x.ticks {
            let tick = left + x.part(*value) * size[0];
            drawing.draw(&[[tick, top], [tick, bottom]], Pen::Line(1.0), FAINT);
            drawing.draw(&[[tick, bottom], [tick, bottom + 4.0]], Pen::Line(1.0), FRAME);
            drawing.text(number, [tick, bottom + 12.0], TICK_PX, Look::Plain, Anchor::Middle, room);
        }
        for (value, number) in &y.ticks {
            let tick = bottom - y.part(*value) * size[1];
            drawing.draw(&[[left, tick], [right, tick]], Pen::Line(1.0), FAINT);
            drawing.draw(&[[left - 4.0, tick], [left, tick]], Pen::Line(1.0), FRAME);
            drawing.text(number, [left - 7.0, tick], TICK_PX, Look::Plain, Anchor::End, left);
        }
        drawing.draw(&[[left, top], [left, bottom], [right, bottom]], Pen::Line(1.0), FRAME);
        let [x_label, y_label] = &panel.labels;
        let below = [0.5 * (left + right), bottom + AXIS_PX - 0.5 * LABEL_PX];
        drawing.text(x_label, below, LABEL_PX, Look::Plain, Anchor::Middle, size[0]);
        let beside = [MARGIN_PX + 0.5 * LABEL_PX, 0.5 * (top + bottom)];
        drawing.text(y_label, beside, LABEL_PX, Look::Turned, Anchor::Middle, size[1]);

        let mut curves = Drawing::new(size);
        let mut series: Vec<&Series> = panel.series.iter().collect();
        series.sort_by_key(|series| series.style.min(Style::Solid));
        for series in series {
            draw_series(&mut curves, panel, series, [x, y]);
        }
        drawing.place(curves, [left, top]);
        drawing
    }
}

/// Draws a series on a drawing of the plot alone, cut at its edges and thinned to its pixels.
fn draw_series(plot: &mut Drawing, panel: &Panel, series: &Series, [x_axis, y_axis]: [&Axis; 2]) {
    let ([width, height], Series { style, color, .. }) = (plot.size_px, series);
    // values far outside stay finite
    let right = |x: f64| width * x_axis.part(panel.position(x)).clamp(-1e6, 1e6);
    let down = |y: f64| height * (1.0 - y_axis.part(y).clamp(-1e6, 1e6));
    let is_inside = |[x, y]: &Point| (0.0..=width).contains(x) && (0.0..=height).contains(y);
    let y = |value: f64| down(value).clamp(0.0, height);
    match style {
        Style::Band => {
            let [low, high] =
                [f64::min, f64::max].map(|of| series.y.iter().copied().reduce(of).map_or(0.0, y));
            let corners = [[0.0, low], [width, low], [width, high], [0.0, high]];
            return plot.draw(&corners, Pen::Fill(BAND_OPACITY), *color);
        }
        Style::Level => {
            let shown = series.y.iter().map(|y| down(*y)).filter(|y| is_inside(&[0.0, *y]));
            return shown.for_each(|y| plot.draw(&[[0.0, y], [width, y]], Pen::Dashes(1.2), *color));
        }
        _ => {}
    }
    let mut points: Vec<Point> = Vec::with_capacity(series.x.len());
    for (x, y) in series.x.iter().zip(&series.y) {
        // A step holds the value before until the new one takes over.
        if let (Style::Step, Some([_, held])) = (style, points.last().copied()) {
            points.push([right(*x), held]);
        }
        points.push([right(*x), down(*y)]);
    }
    if *style == Style::Points || points.len() == 1 {
        points.retain(is_inside);
        return plot.draw(&thin::dots(&points), Pen::Dots(DOT_PX), *color);
    }
    let pen = if *style == Style::Dashed { Pen::Dashes(1.6) } else { Pen::Line(1.6) };
    for part in thin::cut(&points, plot.size_px) {
        plot.draw(&thin::line(part), pen, *color);
    }
}
