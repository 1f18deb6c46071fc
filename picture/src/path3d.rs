//! Trajectories in space.

use crate::axis::{Axis, bounds, opened};
use crate::chart::{HEAD_PX, LABEL_PX, TICK_PX};
use crate::color::{Color, FAINT, FRAME};
use crate::draw::blend;
use crate::drawing::{Anchor, Drawing, Look, Pen, Point};
use crate::error::within;
use crate::legend::Legend;
use crate::panel::Style;
use crate::view::{AZIMUTH_DEG, ELEVATION_DEG};
use crate::{Marker, PictureError, floor, thin};

const PAGE_PX: Point = [720.0, 560.0];
const MARGIN_PX: f64 = 16.0;
const TITLE_ROW_PX: f64 = 28.0;
/// Room around the box for numbers and axis labels.
const ROOM_PX: Point = [70.0, 52.0];
/// Numbers along the longest axis, about.
const NUMBERS: f64 = 8.0;
/// Coordinates beyond this are refused.
const LARGEST_M: f64 = 1e6;

/// A trajectory.
#[derive(Debug, Clone)]
pub struct Path3 {
    /// Name in the legend; an empty one has no entry.
    pub label: String,
    /// Positions in metres: x right, y forward, z up.
    pub points_m: Vec<[f64; 3]>,
    /// [`Style::Dashed`] and [`Style::Points`] as in charts; a continuous line otherwise.
    pub style: Style,
    /// Its colour, preferably from [`PALETTE`](crate::PALETTE).
    pub color: Color,
}

/// Draws trajectories in a box with metric axes of one scale, seen as with MATLAB's `view(43, 24)`, with the 0.197 m
/// marker at the origin. Each path leaves a faint copy on the floor; a ring marks its first point and a dot its last.
/// `outlines` are lines of the objects in the room: gates, obstacles.
///
/// # Errors
/// [`PictureError::Empty`] without paths or for a path without points; with the path's name and the point's
/// index [`PictureError::NonFinite`] and [`PictureError::OutOfRange`] (beyond 1000 km).
pub fn path3d(paths: &[Path3], outlines: &[Vec<[f64; 3]>], title: &str) -> Result<Drawing, PictureError> {
    if paths.is_empty() {
        return Err(PictureError::Empty { what: "the list of paths".to_owned() });
    }
    let named = paths.iter().map(|path| (format!("path \"{}\"", path.label), &path.points_m));
    for (what, points_m) in named.chain(outlines.iter().map(|points_m| ("an outline".to_owned(), points_m))) {
        if points_m.is_empty() {
            return Err(PictureError::Empty { what });
        }
        let is_close = |(i, point): (usize, &[f64; 3])| within(&what, i, point, -LARGEST_M, LARGEST_M);
        points_m.iter().enumerate().try_for_each(is_close)?;
    }
    let style = |path: &Path3| match path.style {
        Style::Dashed | Style::Points => path.style,
        _ => Style::Solid,
    };
    let width = PAGE_PX[0] - 2.0 * MARGIN_PX;
    let legend = Legend::new(paths.iter().map(|path| (path.label.as_str(), style(path), path.color)), width);
    let title_row = if title.is_empty() { 0.0 } else { TITLE_ROW_PX };
    let header = MARGIN_PX + title_row + legend.height();
    let space = Space::new(paths.iter().map(|path| &path.points_m).chain(outlines).flatten(), header);
    let mut drawing = Drawing::new(PAGE_PX);
    let middle = [0.5 * PAGE_PX[0], MARGIN_PX + 0.4 * HEAD_PX];
    drawing.text(title, middle, HEAD_PX, Look::Bold, Anchor::Middle, width);
    legend.draw(&mut drawing, [MARGIN_PX, header]);
    space.draw_box(&mut drawing);
    for (polygons, color) in floor::marker_shapes(&Marker::default()) {
        for corners in polygons {
            drawing.draw(&corners.map(|corner| space.project(corner.map(f64::from))), Pen::Fill(1.0), color);
        }
    }
    for outline in outlines {
        drawing.draw(&space.lay(outline), Pen::Line(1.4), FRAME);
    }
    for path in paths {
        let on_floor: Vec<_> =
            path.points_m.iter().map(|[x, y, _]| [*x, *y, space.axes[2].range.start]).collect();
        let pale = blend(path.color, [255; 3], 0.78);
        drawing.draw(&thin::curve(&space.lay(&on_floor)), Pen::Line(1.2), pale);
    }
    for path in paths {
        let points = space.lay(&path.points_m);
        if style(path) == Style::Points {
            drawing.draw(&thin::dots(&points), Pen::Dots(4.0), path.color);
            continue;
        }
        let pen = if style(path) == Style::Dashed { Pen::Dashes(1.8) } else { Pen::Line(1.8) };
        drawing.draw(&thin::curve(&points), pen, path.color);
        drawing.draw(&points[..1], Pen::Dots(8.0), path.color);
        drawing.draw(&points[..1], Pen::Dots(4.8), [255; 3]);
        drawing.draw(&points[points.len() - 1..], Pen::Dots(8.0), path.color);
    }
    Ok(drawing)
}

/// Parallel projection of the box of all paths.
struct Space {
    axes: [Axis; 3],
    px_per_m: f64,
    shift: Point,
}

impl Space {
    fn new<'a>(points: impl Iterator<Item = &'a [f64; 3]> + Clone, header: f64) -> Self {
        let ranges = [0, 1, 2].map(|axis| {
            let reach = if axis < 2 { [-0.2, 0.2] } else { [0.0, 0.2] };
            opened(bounds(points.clone().map(|point| point[axis]).chain(reach)))
        });
        let longest = ranges.iter().map(|range| range.end - range.start).fold(0.0, f64::max);
        // All axes have one scale, so a shorter one has room for fewer numbers.
        let axes = ranges.map(|range| {
            let count = NUMBERS * (range.end - range.start) / longest;
            Axis::whole(range, count.ceil() as usize)
        });
        let mut space = Self { axes, px_per_m: 1.0, shift: [0.0; 2] };
        let end = |axis: &Axis, high: bool| if high { axis.range.end } else { axis.range.start };
        let corners: Vec<[f64; 3]> =
            (0..8).map(|k| [0, 1, 2].map(|axis| end(&space.axes[axis], k >> axis & 1 == 1))).collect();
        let corners = space.lay(&corners);
        let [x, y] = [0, 1].map(|axis| bounds(corners.iter().map(|corner| corner[axis])));
        let width = PAGE_PX[0] - 2.0 * ROOM_PX[0];
        let height = PAGE_PX[1] - header - ROOM_PX[1] - MARGIN_PX;
        space.px_per_m = (width / (x.end - x.start)).min(height / (y.end - y.start));
        let middle = [0.5 * PAGE_PX[0], header + 0.5 * height + 0.5 * MARGIN_PX];
        let centres = [x, y].map(|range| 0.5 * (range.start + range.end) * space.px_per_m);
        space.shift = [middle[0] - centres[0], middle[1] - centres[1]];
        space
    }

    /// CSS pixels of a point in metres.
    fn project(&self, [x, y, z]: [f64; 3]) -> Point {
        let (sa, ca) = AZIMUTH_DEG.to_radians().sin_cos();
        let (se, ce) = ELEVATION_DEG.to_radians().sin_cos();
        let right = x * ca + y * sa;
        let up = -x * sa * se + y * ca * se + z * ce;
        [self.shift[0] + self.px_per_m * right, self.shift[1] - self.px_per_m * up]
    }

    fn lay(&self, points_m: &[[f64; 3]]) -> Vec<Point> {
        points_m.iter().map(|point| self.project(*point)).collect()
    }

    /// Floor and the two walls behind the paths, with numbers along the three near edges.
    fn draw_box(&self, drawing: &mut Drawing) {
        let [left, front, floor] = self.axes.each_ref().map(|axis| axis.range.start);
        let [right, back, top] = self.axes.each_ref().map(|axis| axis.range.end);
        let [x, y, z] = &self.axes;
        let across = |(x, _): &(f64, String)| [[*x, front, floor], [*x, back, floor], [*x, back, top]];
        let along = |(y, _): &(f64, String)| [[right, *y, floor], [left, *y, floor], [left, *y, top]];
        let around = |(z, _): &(f64, String)| [[left, front, *z], [left, back, *z], [right, back, *z]];
        let grid =
            x.ticks.iter().map(across).chain(y.ticks.iter().map(along)).chain(z.ticks.iter().map(around));
        grid.for_each(|points| drawing.draw(&self.lay(&points), Pen::Line(1.0), FAINT));
        let near = [[left, front, top], [left, front, floor], [right, front, floor], [right, back, floor]];
        drawing.draw(&self.lay(&near), Pen::Line(1.0), FRAME);
        self.draw_axis(drawing, 0, |x| [x, front, floor], [-0.6, 1.0]);
        self.draw_axis(drawing, 1, |y| [right, y, floor], [0.6, 1.0]);
        self.draw_axis(drawing, 2, |z| [left, front, z], [-1.0, 0.0]);
    }

    /// Draws ticks, numbers and the label of one axis; `away` points from the box to their places.
    fn draw_axis(&self, drawing: &mut Drawing, index: usize, edge: impl Fn(f64) -> [f64; 3], away: Point) {
        let (axis, label) = (&self.axes[index], ["x (m)", "y (m)", "z (m)"][index]);
        let anchor = if away[0] < 0.0 { Anchor::End } else { Anchor::Start };
        let beside = |value: f64, distance: f64| {
            let [x, y] = self.project(edge(value));
            [x + distance * away[0], y + distance * away[1]]
        };
        let mut before: Option<Point> = None;
        for (value, number) in &axis.ticks {
            drawing.draw(&[beside(*value, 0.0), beside(*value, 5.0)], Pen::Line(1.0), FRAME);
            let place = beside(*value, 11.0);
            // Along a short edge there is not room for every number.
            if before.is_none_or(|before| (place[1] - before[1]).abs() > TICK_PX + 2.0) {
                drawing.text(number, place, TICK_PX, Look::Plain, anchor, PAGE_PX[0]);
                before = Some(place);
            }
        }
        let widest = TICK_PX * axis.longest_em();
        let [x, y] = beside(0.5 * (axis.range.start + axis.range.end), 0.0);
        let (place, look) = if index == 2 {
            ([x - widest - 22.0, y], Look::Turned)
        } else {
            ([x + away[0].signum() * (widest + 26.0), y + 32.0], Look::Plain)
        };
        drawing.text(label, place, LABEL_PX, look, Anchor::Middle, PAGE_PX[0]);
    }
}
