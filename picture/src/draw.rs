//! Polygons and lines of the room on a tiny-skia canvas.

use tiny_skia::{
    Color, FillRule, LineJoin, Paint, Path, PathBuilder, Pixmap, Shader, Stroke, StrokeDash, Transform,
};

use crate::drawing::trace;
use crate::vector::{V3, mix};
use crate::view::{NEAR_M, View};

/// RGB and opacity, each 0 to 255.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ink(pub(crate) [u8; 3], pub(crate) u8);

/// Blends two colours, `t` = 0 gives the first.
pub(crate) fn blend(a: [u8; 3], b: [u8; 3], t: f32) -> [u8; 3] {
    let channel = |i: usize| f32::from(a[i]) + (f32::from(b[i]) - f32::from(a[i])) * t.clamp(0.0, 1.0);
    [channel(0).round() as u8, channel(1).round() as u8, channel(2).round() as u8]
}

/// The frame being drawn, with the camera that projects into it.
pub(crate) struct Canvas {
    pub(crate) view: View,
    pixmap: Pixmap,
}

impl Canvas {
    pub(crate) fn new(view: View, width: u32, height: u32) -> Option<Self> {
        Pixmap::new(width, height).map(|pixmap| Self { view, pixmap })
    }

    pub(crate) fn width(&self) -> f32 {
        self.pixmap.width() as f32
    }

    pub(crate) fn height(&self) -> f32 {
        self.pixmap.height() as f32
    }

    /// Line width that keeps its share of the frame: `at_360` pixels in a frame 360 pixels high.
    pub(crate) fn pen(&self, at_360: f32) -> f32 {
        at_360 * (self.height() / 360.0).clamp(0.5, 8.0)
    }

    /// Fills every image row with one opaque colour.
    pub(crate) fn fill_rows(&mut self, color_of_row: impl Fn(f32) -> [u8; 3]) {
        let stride = self.pixmap.width() as usize * 4;
        for (row, line) in self.pixmap.data_mut().chunks_exact_mut(stride).enumerate() {
            let [r, g, b] = color_of_row(row as f32 + 0.5);
            line.chunks_exact_mut(4).for_each(|pixel| pixel.copy_from_slice(&[r, g, b, 255]));
        }
    }

    /// Fills polygons given in metres as one shape, so that those sharing an edge show no seam.
    pub(crate) fn fill<'p>(&mut self, polygons: impl IntoIterator<Item = &'p [V3]>, ink: Ink) {
        let mut builder = PathBuilder::new();
        for polygon in polygons {
            let pixels = clip_polygon(&self.view, polygon);
            trace(&mut builder, pixels.into_iter(), true);
        }
        if let Some(path) = builder.finish() {
            let paint = paint(ink.0, ink.1);
            self.pixmap.fill_path(&path, &paint, FillRule::Winding, Transform::identity(), None);
        }
    }

    /// Draws a polyline given in metres, `width` in pixels.
    pub(crate) fn line(&mut self, points: &[V3], width: f32, ink: Ink) {
        self.line_dashed(points, width, ink, None);
    }

    /// Draws a line like [`Canvas::line`], with strokes and gaps of `dash` pixels.
    pub(crate) fn line_dashed(&mut self, points: &[V3], width: f32, ink: Ink, dash: Option<f32>) {
        let mut builder = PathBuilder::new();
        for piece in clip_line(&self.view, points) {
            trace(&mut builder, piece.into_iter(), false);
        }
        self.stroke_path(builder.finish(), width, ink, dash);
    }

    /// Draws a straight line between two points in metres whose opacity (0 to 1) is looked up by image row.
    ///
    /// A floor grid is a hundred lines across the whole frame; tiny-skia blends them a pixel at a time
    /// through its general pipeline, which took two thirds of a frame. The area covered in each row or column
    /// is exact enough here.
    pub(crate) fn draw_ruled_line(&mut self, from: V3, to: V3, width: f32, color: [u8; 3], opacity: &[f32]) {
        for piece in clip_line(&self.view, &[from, to]) {
            if let [a, b] = piece[..] {
                rule(&mut self.pixmap, a, b, width, color, opacity);
            }
        }
    }

    /// Draws a polyline given in pixels.
    pub(crate) fn line_px(&mut self, pixels: &[[f32; 2]], width: f32, ink: Ink) {
        let mut builder = PathBuilder::new();
        trace(&mut builder, pixels.iter().copied(), false);
        self.stroke_path(builder.finish(), width, ink, None);
    }

    /// Copies the frame out; it is opaque everywhere because [`Canvas::fill_rows`] was.
    pub(crate) fn write_rgb(&self, out: &mut [u8]) {
        for (rgb, rgba) in out.chunks_exact_mut(3).zip(self.pixmap.data().chunks_exact(4)) {
            rgb.copy_from_slice(&rgba[..3]);
        }
    }

    fn stroke_path(&mut self, path: Option<Path>, width: f32, ink: Ink, dash: Option<f32>) {
        if let Some(path) = path {
            let stroke = stroke(width, dash.map(|length| [length; 2]));
            self.pixmap.stroke_path(&path, &paint(ink.0, ink.1), &stroke, Transform::identity(), None);
        }
    }
}

/// A colour, opaque at 255.
pub(crate) fn paint([r, g, b]: [u8; 3], opacity: u8) -> Paint<'static> {
    let shader = Shader::SolidColor(Color::from_rgba8(r, g, b, opacity));
    Paint { shader, anti_alias: true, ..Paint::default() }
}

/// A line of some width, with dashes and gaps of these lengths.
pub(crate) fn stroke(width: f32, dash: Option<[f32; 2]>) -> Stroke {
    let dash = dash.and_then(|dash| StrokeDash::new(dash.to_vec(), 0.0));
    Stroke { width, line_join: LineJoin::Round, dash, ..Stroke::default() }
}

/// Steps along the longer axis of the line from `a` to `b` and, in each step, spreads its width over the
/// pixels across.
fn rule(pixmap: &mut Pixmap, a: [f32; 2], b: [f32; 2], width: f32, color: [u8; 3], opacity: &[f32]) {
    let size = [pixmap.width() as usize, pixmap.height() as usize];
    let along = usize::from((b[0] - a[0]).abs() < (b[1] - a[1]).abs());
    let across = 1 - along;
    let (a, b) = if a[along] <= b[along] { (a, b) } else { (b, a) };
    let run = b[along] - a[along];
    if run <= 0.0 {
        return;
    }
    let slope = (b[across] - a[across]) / run;
    let half = 0.5 * width * slope.hypot(1.0);
    let data = pixmap.data_mut();
    let first = a[along].clamp(0.0, size[along] as f32) as usize;
    let last = b[along].clamp(0.0, size[along] as f32) as usize;
    for i in first..last {
        let middle = a[across] + (i as f32 + 0.5 - a[along]) * slope;
        let (low, high) = (middle - half, middle + half);
        if high <= 0.0 || low >= size[across] as f32 {
            continue;
        }
        for j in low.max(0.0) as usize..size[across].min(high.ceil() as usize) {
            let covered = high.min(j as f32 + 1.0) - low.max(j as f32);
            let (column, row) = if along == 0 { (i, j) } else { (j, i) };
            let Some(alpha) = opacity.get(row).map(|opacity| opacity * covered) else {
                continue;
            };
            let start = (row * size[0] + column) * 4;
            for (channel, ink) in data[start..start + 3].iter_mut().zip(color) {
                *channel = (f32::from(*channel) + (f32::from(ink) - f32::from(*channel)) * alpha + 0.5) as u8;
            }
        }
    }
}

/// Cuts away what is behind the camera, edge by edge, and projects the rest.
fn clip_polygon(view: &View, polygon: &[V3]) -> Vec<[f32; 2]> {
    let mut pixels = Vec::with_capacity(polygon.len() + 2);
    let Some(&last) = polygon.last() else {
        return pixels;
    };
    let (mut from, mut from_depth) = (last, view.depth(last));
    for &to in polygon {
        let to_depth = view.depth(to);
        if (from_depth < NEAR_M) != (to_depth < NEAR_M) {
            pixels.push(crossing(view, from, from_depth, to, to_depth));
        }
        if to_depth >= NEAR_M {
            pixels.push(view.project_at(to, to_depth));
        }
        (from, from_depth) = (to, to_depth);
    }
    pixels
}

/// The visible pieces of a polyline, projected.
fn clip_line(view: &View, points: &[V3]) -> Vec<Vec<[f32; 2]>> {
    let mut pieces = vec![Vec::with_capacity(points.len())];
    let mut before: Option<(V3, f32)> = None;
    for &to in points {
        let depth = view.depth(to);
        let cut = before.filter(|(_, d)| (*d < NEAR_M) != (depth < NEAR_M));
        if let (Some((from, d)), Some(piece)) = (cut, pieces.last_mut()) {
            piece.push(crossing(view, from, d, to, depth));
        }
        if depth >= NEAR_M {
            if let Some(piece) = pieces.last_mut() {
                piece.push(view.project_at(to, depth));
            }
        } else if cut.is_some() {
            pieces.push(Vec::new());
        }
        before = Some((to, depth));
    }
    pieces
}

fn crossing(view: &View, from: V3, from_depth: f32, to: V3, to_depth: f32) -> [f32; 2] {
    let t = (NEAR_M - from_depth) / (to_depth - from_depth);
    view.project_at(mix(from, to, t), NEAR_M)
}
