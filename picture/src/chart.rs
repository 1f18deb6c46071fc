//! Line charts as SVG.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use crate::axis::{Axis, span};
use crate::legend;
use crate::panel::{check, entries};
use crate::scale::{Scale, cut, x_axis};
use crate::sheet::{
    Area, FAINT, FINE, FRAME, Style, dot, fine, fit, font, line, page, rgb, stroke, svg_error, text,
    text_width,
};
use crate::{Panel, PictureError, Series, thin};

const TICK_PX: f64 = 11.0;
const LABEL_PX: f64 = 12.5;
const TITLE_PX: f64 = 14.0;
const HEAD_PX: f64 = 17.0;
const MARGIN_PX: f64 = 14.0;
/// Height of the plots, of a panel's title row, of the axis numbers with the axis label, and of the
/// document's title.
const PLOT_PX: f64 = 200.0;
const TITLE_ROW_PX: f64 = 24.0;
const AXIS_PX: f64 = 42.0;
const HEAD_ROW_PX: f64 = 34.0;
/// Numbers on the y axis, at most, and the room that each number on the x axis gets.
const Y_NUMBERS: usize = 8;
const X_NUMBER_PX: f64 = 52.0;

/// Draws a grid of panels, filled row by row, as one SVG document with a white background.
///
/// Axes include all curves, bands and lines. Long series are thinned to what the width can show, keeping
/// every peak. The text is set in the reader's Helvetica, Arial or sans-serif; texts that are too long are
/// set smaller.
///
/// # Errors
/// [`PictureError::Empty`] without panels, for a panel without series and a series without points,
/// [`PictureError::ZeroSize`] for no columns, [`PictureError::LengthMismatch`], and with the series' name and
/// the element's index [`PictureError::NonFinite`] and [`PictureError::OutOfRange`] (beyond 1e300).
pub fn chart(panels: &[Panel], columns: usize, title: &str) -> Result<String, PictureError> {
    if panels.is_empty() {
        return Err(PictureError::Empty { what: "the list of panels".to_owned() });
    }
    if columns == 0 {
        return Err(PictureError::ZeroSize { width: 0, height: panels.len() });
    }
    panels.iter().try_for_each(check)?;
    let layout = Layout::new(panels, columns, title);
    page(layout.page(), |root| {
        if !title.is_empty() {
            let size = fit(title, HEAD_PX, f64::from(layout.page().0) - 2.0 * MARGIN_PX);
            let middle = 0.5 * f64::from(layout.page().0);
            text(root, title, (middle, 0.6 * HEAD_ROW_PX), font(size, true), HPos::Center)?;
        }
        panels.iter().enumerate().try_for_each(|(i, panel)| draw(root, &layout, i, panel))
    })
}

/// Sizes shared by all panels, in CSS pixels, so that plots line up across and down.
struct Layout {
    columns: usize,
    rows: usize,
    width: f64,
    height: f64,
    top: f64,
    /// Height of title and legend.
    header: f64,
    /// Width of the y numbers and label, per column.
    left: Vec<f64>,
    /// Width at the right that the last x number needs, per column.
    right: Vec<f64>,
}

impl Layout {
    fn new(panels: &[Panel], columns: usize, title: &str) -> Self {
        let columns = columns.min(panels.len());
        let width = match columns {
            1 => 720.0,
            2 => 480.0,
            _ => 400.0,
        };
        let (mut left, mut right) = (vec![0.0_f64; columns], vec![0.0_f64; columns]);
        for (i, panel) in panels.iter().enumerate() {
            let (x, y) = axes(panel, width);
            let size = |(_, text): (f64, String)| text_width(&text, TICK_PX);
            let (wide, last) =
                (y.numbers().map(size).fold(0.0, f64::max), x.numbers().last().map_or(0.0, size));
            let (left, right) = (&mut left[i % columns], &mut right[i % columns]);
            *left = left.max(wide + LABEL_PX + 16.0);
            *right = right.max(0.5 * last + 6.0 - MARGIN_PX);
        }
        let legend = |(i, panel): (usize, &Panel)| {
            legend::rows(&entries(panel), width - left[i % columns] - right[i % columns] - 2.0 * MARGIN_PX)
        };
        let legend_rows = panels.iter().enumerate().map(legend).max().unwrap_or(0);
        let titled = panels.iter().any(|panel| !panel.title.is_empty());
        let title_row = if titled { TITLE_ROW_PX } else { 0.0 };
        let header = title_row + legend_rows as f64 * legend::ROW_PX + 4.0;
        let height = header + PLOT_PX + AXIS_PX + 2.0 * MARGIN_PX;
        let top = if title.is_empty() { 0.0 } else { HEAD_ROW_PX };
        Self { columns, rows: panels.len().div_ceil(columns), width, height, top, header, left, right }
    }

    fn page(&self) -> (u32, u32) {
        let (width, height) = (self.width * self.columns as f64, self.height * self.rows as f64);
        (width as u32, (height + self.top) as u32)
    }
}

fn draw(root: &Area, layout: &Layout, index: usize, panel: &Panel) -> Result<(), PictureError> {
    let (column, row) = (index % layout.columns, index / layout.columns);
    let (x0, y0) = (layout.width * column as f64, layout.top + layout.height * row as f64);
    let (left, right) = (layout.left[column], layout.right[column]);
    let width = layout.width - left - right - 2.0 * MARGIN_PX;
    let area = root.clone().shrink(
        (fine(x0 + MARGIN_PX), fine(y0 + MARGIN_PX)),
        (fine(layout.width - 2.0 * MARGIN_PX), fine(layout.height - 2.0 * MARGIN_PX)),
    );
    let entries = entries(panel);
    let legend_y = layout.header - 4.0 - legend::ROW_PX * legend::rows(&entries, width) as f64;
    let title = font(fit(panel.title, TITLE_PX, width), true);
    text(&area, panel.title, (left, 0.5 * TITLE_ROW_PX - 4.0), title, HPos::Left)?;
    legend::draw(&area, &entries, (left, legend_y), width)?;
    let plot = Plot { header: layout.header, left, right };
    plot.draw(&area, panel, axes(panel, layout.width))
}

/// The part of a panel within its axes, as distances from the panel's edges in CSS pixels.
struct Plot {
    header: f64,
    left: f64,
    right: f64,
}

impl Plot {
    fn draw(&self, area: &Area, panel: &Panel, (x, y): (Axis, Axis)) -> Result<(), PictureError> {
        let mut chart = ChartBuilder::on(area)
            .margin_top(fine(self.header))
            .margin_right(fine(self.right))
            .x_label_area_size(fine(AXIS_PX))
            .y_label_area_size(fine(self.left))
            .build_cartesian_2d(x.clone(), y.clone())
            .map_err(svg_error)?;
        chart
            .configure_mesh()
            .bold_line_style(stroke(FAINT, 1.0, false))
            .axis_style(stroke(FRAME, 1.0, false))
            .label_style(font(TICK_PX, false))
            .set_all_tick_mark_size(fine(4.0))
            .draw()
            .map_err(svg_error)?;
        self.labels(area, panel)?;
        let shown = y.start()..=y.end();
        for band in &panel.bands {
            let edge = |value: f64| value.clamp(y.start(), y.end());
            let corners =
                [(x.start(), edge(band.low.min(band.high))), (x.end(), edge(band.low.max(band.high)))];
            let fill = rgb(band.color).mix(legend::BAND_OPACITY).filled();
            chart.draw_series([Rectangle::new(corners, fill)]).map_err(svg_error)?;
        }
        for line in panel.hlines.iter().filter(|line| shown.contains(&line.y)) {
            let ends = vec![(x.start(), line.y), (x.end(), line.y)];
            let style = stroke(rgb(line.color), 1.2, true);
            chart.draw_series([PathElement::new(ends, style)]).map_err(svg_error)?;
        }
        let inside = chart.plotting_area().strip_coord_spec();
        panel.series.iter().try_for_each(|series| curve(&inside, (&x, &y), panel.x_scale, series))
    }

    /// Axis labels, placed by hand so that neither can run into the numbers or out of the panel.
    fn labels(&self, area: &Area, panel: &Panel) -> Result<(), PictureError> {
        let (wide, high) = size(area);
        let (width, height) = (wide - self.left - self.right, high - self.header - AXIS_PX);
        let x_font = font(fit(panel.x_label, LABEL_PX, width), false);
        let below = (self.left + 0.5 * width, high - 0.5 * LABEL_PX);
        text(area, panel.x_label, below, x_font, HPos::Center)?;
        let y_font = font(fit(panel.y_label, LABEL_PX, height), false).transform(FontTransform::Rotate270);
        let beside = (0.5 * LABEL_PX, self.header + 0.5 * height);
        text(area, panel.y_label, beside, y_font, HPos::Center)
    }
}

/// Draws a series on the plot's own page area, cut at its edges and thinned to its pixels.
fn curve(area: &Area, axes: (&Axis, &Axis), scale: Scale, series: &Series) -> Result<(), PictureError> {
    let (width, height) = size(area);
    let points = place(series, axes, scale, (width, height));
    let color = rgb(series.color);
    let is_inside = |(x, y): &(f64, f64)| (0.0..=width).contains(x) && (0.0..=height).contains(y);
    if series.style == Style::Points {
        let shown = points.into_iter().filter(is_inside).collect();
        return thin::dots(shown, 1.0).into_iter().try_for_each(|point| dot(area, point, 1.8, color));
    }
    let style = stroke(color, 1.6, series.style == Style::Dashed);
    let thinned = |points| {
        let points = thin::line(points, 1.0);
        if let [only] = points[..] {
            return dot(area, only, 1.8, color);
        }
        line(area, &points, style)
    };
    // rounding may leave the ends of an axis by a hair: only curves with limits leave it
    let margin = |(x, y): &(f64, f64)| (-1.0..=width + 1.0).contains(x) && (-1.0..=height + 1.0).contains(y);
    if points.iter().all(margin) {
        return thinned(points);
    }
    cut(&points, width, height).into_iter().try_for_each(thinned)
}

/// From the units of the axes to CSS pixels within the plot.
fn place(
    series: &Series,
    (x_axis, y_axis): (&Axis, &Axis),
    scale: Scale,
    (width, height): (f64, f64),
) -> Vec<(f64, f64)> {
    let mut points = Vec::with_capacity(series.x.len());
    for (x, y) in series.x.iter().zip(series.y) {
        let (right, down) = (x_axis.part(scale.position(*x)) * width, (1.0 - y_axis.part(*y)) * height);
        // A step holds the value before until the new one takes over.
        if let (Style::Step, Some((_, held))) = (series.style, points.last().copied()) {
            points.push((right, held));
        }
        points.push((right, down));
    }
    points
}

/// Width and height of an area in CSS pixels.
fn size(area: &Area) -> (f64, f64) {
    let (width, height) = area.dim_in_pixel();
    (f64::from(width) / f64::from(FINE), f64::from(height) / f64::from(FINE))
}

/// The ranges of the axes: x the data, y the data, bands and lines with some room above and below.
fn axes(panel: &Panel, panel_width: f64) -> (Axis, Axis) {
    let x = x_axis(panel, ((panel_width - 60.0) / X_NUMBER_PX) as usize);
    if let Some([low, high]) = panel.y_limits {
        return (x, Axis::exact(low..high, Y_NUMBERS));
    }
    let levels = panel.hlines.iter().map(|line| line.y);
    let edges = panel.bands.iter().flat_map(|band| [band.low, band.high]);
    let values = panel.series.iter().flat_map(|s| s.y.iter().copied());
    let y = span(values.chain(levels).chain(edges));
    let room = 0.05 * (y.end - y.start);
    (x, Axis::exact(y.start - room..y.end + room, Y_NUMBERS))
}
