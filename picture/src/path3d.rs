//! Trajectories in space as SVG.

use std::ops::Range;

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use crate::axis::{Axis, span};
use crate::legend::{self, Entry, Sample};
use crate::panel::finite;
use crate::sheet::{
    Area, FAINT, FRAME, Style, dot, fit, font, line, page, polygon, rgb, stroke, text, text_width,
};
use crate::view::{AZIMUTH_DEG, ELEVATION_DEG};
use crate::{Marker, PictureError, floor, thin};

const PAGE_PX: (u32, u32) = (720, 560);
const MARGIN_PX: f64 = 16.0;
const TITLE_PX: f64 = 16.0;
const TITLE_ROW_PX: f64 = 28.0;
const TICK_PX: f64 = 11.0;
const LABEL_PX: f64 = 12.5;
/// Room around the box for numbers and axis labels.
const ROOM_PX: (f64, f64) = (70.0, 52.0);
/// Numbers along the longest axis, about.
const NUMBERS: f64 = 8.0;
const LABELS: [&str; 3] = ["x (m)", "y (m)", "z (m)"];
/// Coordinates beyond this are refused.
const LARGEST_M: f64 = 1e6;

/// A trajectory.
#[derive(Debug, Clone, Copy)]
pub struct Path3<'a> {
    /// Name in the legend; an empty one has no entry.
    pub label: &'a str,
    /// Positions in metres: x right, y forward, z up.
    pub points_m: &'a [[f64; 3]],
    /// How the points are joined; [`Style::Step`] means the same as [`Style::Solid`] here.
    pub style: Style,
    /// RGB, preferably from [`PALETTE`](crate::PALETTE).
    pub color: [u8; 3],
}

/// Draws trajectories in a box with metric axes of one scale as an SVG document, seen as with MATLAB's
/// `view(43, 24)`, with the 0.197 m marker at the origin. Each path leaves a faint copy on the floor; a ring
/// marks its first point and a dot its last.
///
/// # Errors
/// [`PictureError::Empty`] without paths or for a path without points; with the path's name and the point's
/// index [`PictureError::NonFinite`] and [`PictureError::OutOfRange`] (beyond 1000 km).
pub fn path3d(paths: &[Path3], title: &str) -> Result<String, PictureError> {
    scene3d(paths, &[], title)
}

/// As [`path3d`], with lines of what stands in the room: gates, obstacles.
///
/// # Errors
/// As [`path3d`]; the coordinates of `outlines` are checked like those of paths.
pub fn scene3d(paths: &[Path3], outlines: &[Vec<[f64; 3]>], title: &str) -> Result<String, PictureError> {
    for (index, point) in outlines.iter().flatten().enumerate() {
        finite("an outline", point, LARGEST_M).map_err(|error| error.at_element(index))?;
    }
    if paths.is_empty() {
        return Err(PictureError::Empty { what: "the list of paths".to_owned() });
    }
    for path in paths {
        let what = format!("path \"{}\"", path.label);
        if path.points_m.is_empty() {
            return Err(PictureError::Empty { what });
        }
        for (index, point) in path.points_m.iter().enumerate() {
            finite(&what, point, LARGEST_M).map_err(|error| error.at_element(index))?;
        }
    }
    let entries: Vec<Entry> = paths.iter().filter(|path| !path.label.is_empty()).map(entry).collect();
    let width = f64::from(PAGE_PX.0) - 2.0 * MARGIN_PX;
    let title_row = if title.is_empty() { 0.0 } else { TITLE_ROW_PX };
    let header = MARGIN_PX + title_row + legend::ROW_PX * legend::rows(&entries, width) as f64;
    let space = Space::new(paths, outlines, header);
    page(PAGE_PX, |area| {
        let middle = (0.5 * f64::from(PAGE_PX.0), MARGIN_PX + 0.4 * TITLE_PX);
        text(area, title, middle, font(fit(title, TITLE_PX, width), true), HPos::Center)?;
        legend::draw(area, &entries, (MARGIN_PX, MARGIN_PX + title_row), width)?;
        space.draw_box(area)?;
        space.draw_marker(area)?;
        for outline in outlines {
            let points: Vec<(f64, f64)> = outline.iter().map(|point| space.project(*point)).collect();
            line(area, &points, stroke(FRAME, 1.4, false))?;
        }
        paths.iter().try_for_each(|path| space.draw_path(area, path, true))?;
        paths.iter().try_for_each(|path| space.draw_path(area, path, false))
    })
}

fn entry<'a>(path: &Path3<'a>) -> Entry<'a> {
    let style = if path.style == Style::Step { Style::Solid } else { path.style };
    Entry { label: path.label, color: path.color, sample: Sample::Line(style) }
}

/// Parallel projection of the box that holds all paths.
struct Space {
    axes: [Axis; 3],
    px_per_m: f64,
    shift: (f64, f64),
}

impl Space {
    fn new(paths: &[Path3], outlines: &[Vec<[f64; 3]>], header: f64) -> Self {
        let bounds = [0, 1, 2].map(|axis| {
            let reach = if axis < 2 { [-0.2, 0.2] } else { [0.0, 0.2] };
            let points = paths.iter().flat_map(|path| path.points_m).chain(outlines.iter().flatten());
            span(points.map(|point| point[axis]).chain(reach))
        });
        let longest = bounds.iter().map(|range| range.end - range.start).fold(0.0, f64::max);
        // All axes have one scale, so a shorter one has room for fewer numbers.
        let axes = bounds.map(|range| {
            let count = NUMBERS * (range.end - range.start) / longest;
            Axis::whole(range, count.ceil() as usize)
        });
        let mut space = Self { axes, px_per_m: 1.0, shift: (0.0, 0.0) };
        let corners = space.corners().map(|corner| space.project(corner));
        let x = span(corners.iter().map(|corner| corner.0));
        let y = span(corners.iter().map(|corner| corner.1));
        let width = f64::from(PAGE_PX.0) - 2.0 * ROOM_PX.0;
        let height = f64::from(PAGE_PX.1) - header - ROOM_PX.1 - MARGIN_PX;
        space.px_per_m = (width / (x.end - x.start)).min(height / (y.end - y.start));
        let centre = |range: Range<f64>| -0.5 * (range.start + range.end) * space.px_per_m;
        space.shift =
            (0.5 * f64::from(PAGE_PX.0) + centre(x), header + 0.5 * height + 0.5 * MARGIN_PX + centre(y));
        space
    }

    fn corners(&self) -> [[f64; 3]; 8] {
        let end = |axis: &Axis, high: bool| if high { axis.end() } else { axis.start() };
        [0, 1, 2, 3, 4, 5, 6, 7].map(|k| [0, 1, 2].map(|axis| end(&self.axes[axis], k >> axis & 1 == 1)))
    }

    /// CSS pixels of a point in metres.
    fn project(&self, [x, y, z]: [f64; 3]) -> (f64, f64) {
        let (sa, ca) = AZIMUTH_DEG.to_radians().sin_cos();
        let (se, ce) = ELEVATION_DEG.to_radians().sin_cos();
        let right = x * ca + y * sa;
        let up = -x * sa * se + y * ca * se + z * ce;
        (self.shift.0 + self.px_per_m * right, self.shift.1 - self.px_per_m * up)
    }

    /// Floor and the two walls behind the paths, with numbers along the three near edges.
    fn draw_box(&self, area: &Area) -> Result<(), PictureError> {
        let [left, front, floor] = self.axes.each_ref().map(Axis::start);
        let [right, back, top] = self.axes.each_ref().map(Axis::end);
        let trace = |points: &[[f64; 3]], color| {
            let points: Vec<(f64, f64)> = points.iter().map(|point| self.project(*point)).collect();
            line(area, &points, stroke(color, 1.0, false))
        };
        for (x, _) in self.axes[0].numbers() {
            trace(&[[x, front, floor], [x, back, floor], [x, back, top]], FAINT)?;
        }
        for (y, _) in self.axes[1].numbers() {
            trace(&[[right, y, floor], [left, y, floor], [left, y, top]], FAINT)?;
        }
        for (z, _) in self.axes[2].numbers() {
            trace(&[[left, front, z], [left, back, z], [right, back, z]], FAINT)?;
        }
        trace(
            &[[left, front, top], [left, front, floor], [right, front, floor], [right, back, floor]],
            FRAME,
        )?;
        self.draw_axis(area, 0, |x| [x, front, floor], (-0.6, 1.0))?;
        self.draw_axis(area, 1, |y| [right, y, floor], (0.6, 1.0))?;
        self.draw_axis(area, 2, |z| [left, front, z], (-1.0, 0.0))
    }

    /// Ticks, numbers and the label of one axis; `away` points from the box to where they stand.
    fn draw_axis(
        &self,
        area: &Area,
        index: usize,
        edge: impl Fn(f64) -> [f64; 3],
        away: (f64, f64),
    ) -> Result<(), PictureError> {
        let (axis, label) = (&self.axes[index], LABELS[index]);
        let anchor = if away.0 < 0.0 { HPos::Right } else { HPos::Left };
        let beside = |value: f64, distance: f64| {
            let (x, y) = self.project(edge(value));
            (x + distance * away.0, y + distance * away.1)
        };
        let (mut widest, mut before): (f64, Option<(f64, f64)>) = (0.0, None);
        for (value, number) in axis.numbers() {
            line(area, &[beside(value, 0.0), beside(value, 5.0)], stroke(FRAME, 1.0, false))?;
            let place = beside(value, 11.0);
            // Along a short edge there is not room for every number.
            if before.is_none_or(|before| (place.1 - before.1).abs() > TICK_PX + 2.0) {
                text(area, &number, place, font(TICK_PX, false), anchor)?;
                before = Some(place);
            }
            widest = widest.max(text_width(&number, TICK_PX));
        }
        let (x, y) = beside(0.5 * (axis.start() + axis.end()), 0.0);
        let style = font(LABEL_PX, false);
        if index == 2 {
            let turned = style.transform(FontTransform::Rotate270);
            return text(area, label, (x - widest - 22.0, y), turned, HPos::Center);
        }
        let side = away.0.signum() * (widest + 26.0);
        text(area, label, (x + side, y + 32.0), style, HPos::Center)
    }

    fn draw_marker(&self, area: &Area) -> Result<(), PictureError> {
        for (polygons, color) in floor::marker_shapes(&Marker::default()) {
            for corners in polygons {
                let corners = corners.map(|corner| self.project(corner.map(f64::from)));
                polygon(area, &corners, rgb(color).mix(1.0))?;
            }
        }
        Ok(())
    }

    fn draw_path(&self, area: &Area, path: &Path3, on_floor: bool) -> Result<(), PictureError> {
        let lay = |[x, y, z]: [f64; 3]| self.project([x, y, if on_floor { self.axes[2].start() } else { z }]);
        let points: Vec<(f64, f64)> = path.points_m.iter().map(|point| lay(*point)).collect();
        let (first, last) = (points[0], points[points.len() - 1]);
        let color = rgb(path.color);
        if on_floor {
            let pale = ShapeStyle { color: color.mix(0.22), ..stroke(color, 1.2, false) };
            return line(area, &thin::curve(points), pale);
        }
        if path.style == Style::Points {
            return thin::dots(points, 1.0).into_iter().try_for_each(|point| dot(area, point, 2.0, color));
        }
        line(area, &thin::curve(points), stroke(color, 1.8, path.style == Style::Dashed))?;
        dot(area, first, 4.0, color)?;
        dot(area, first, 2.4, WHITE)?;
        dot(area, last, 4.0, color)
    }
}
