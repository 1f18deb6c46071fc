//! The floor: its shade, its grid and the markers on it.

use crate::Marker;
use crate::draw::{Canvas, Ink, blend};
use crate::scene::Scene;
use crate::vector::V3;

const NEAR_FLOOR: [u8; 3] = [244, 246, 248];
const FAR_FLOOR: [u8; 3] = [214, 223, 232];
const SKY: [u8; 3] = [205, 216, 227];
const LINE: [u8; 3] = [120, 138, 156];
/// Grid spacings in metres with the opacity of their lines. The two coarse ones only show from far away.
const GRID: [(f32, f32); 4] = [(0.25, 0.36), (1.0, 0.65), (10.0, 0.85), (100.0, 0.9)];
/// Lines closer than the first are not drawn, those farther apart than the second have their full opacity.
const FADE_PX: (f32, f32) = (3.0, 12.0);
/// Bits of marker 582 of the original ArUco dictionary, row by row from the +y side; 1 is white.
const BITS: [u8; 5] = [0b01001, 0b10111, 0b10000, 0b10111, 0b01001];
/// White border around the black square, as a share of its side; detectors need one, and it sets the marker
/// off.
const QUIET: f32 = 1.0 / 7.0;

pub(crate) fn paint(scene: &Scene, canvas: &mut Canvas) {
    let view = canvas.view;
    let scale = view.eye_height().max(0.1) / 0.4;
    canvas.fill_rows(|row| match view.floor_depth(row) {
        Some(depth) => blend(NEAR_FLOOR, FAR_FLOOR, (depth / scale - 1.0) / 4.0),
        None => SKY,
    });
    for (spacing, opacity) in GRID {
        grid(canvas, spacing, opacity);
    }
    for marker in scene.markers {
        paint_marker(canvas, marker);
    }
}

/// One family of floor lines, faded out where they would run together.
fn grid(canvas: &mut Canvas, spacing: f32, opacity: f32) {
    let view = canvas.view;
    let bottom = canvas.height();
    let Some(near) = view.floor_depth(bottom) else {
        return;
    };
    let reach = view.floor_reach(spacing, FADE_PX.0);
    let far = view.floor_depth(0.0).map_or(reach, |depth| depth.min(reach));
    if far <= near {
        return;
    }
    let width = canvas.width();
    let corners = [(0.0, near), (width, near), (0.0, far), (width, far)].map(|(c, d)| view.floor_point(c, d));
    let bounds = |axis: usize| {
        corners.iter().fold((f32::MAX, f32::MIN), |(low, high), p| (low.min(p[axis]), high.max(p[axis])))
    };
    let (x, y) = (bounds(0), bounds(1));
    let opacity = fade(canvas, spacing, opacity, far);
    let pen = canvas.pen(1.0).min(1.5);
    for k in indices(x, spacing) {
        canvas.draw_ruled_line([k, y.0, 0.0], [k, y.1, 0.0], pen, LINE, &opacity);
    }
    for k in indices(y, spacing) {
        canvas.draw_ruled_line([x.0, k, 0.0], [x.1, k, 0.0], pen, LINE, &opacity);
    }
}

/// Multiples of `spacing` within the bounds.
fn indices((low, high): (f32, f32), spacing: f32) -> impl Iterator<Item = f32> {
    let (first, last) = ((low / spacing).ceil() as i32, (high / spacing).floor() as i32);
    (first..=last).map(move |k| k as f32 * spacing)
}

/// Opacity of the lines in every image row: a row shows one depth of the floor, so lines fade where they run
/// together.
fn fade(canvas: &Canvas, spacing: f32, opacity: f32, far: f32) -> Vec<f32> {
    let view = canvas.view;
    let shown = |row: usize| {
        let depth = view.floor_depth(row as f32 + 0.5).filter(|depth| *depth < far);
        let pixels = depth.map_or(0.0, |depth| view.floor_spacing_px(spacing, depth));
        opacity * ((pixels - FADE_PX.0) / (FADE_PX.1 - FADE_PX.0)).clamp(0.0, 1.0)
    };
    (0..canvas.height() as usize).map(shown).collect()
}

fn paint_marker(canvas: &mut Canvas, marker: &Marker) {
    for (polygons, color) in marker_shapes(marker) {
        canvas.fill(polygons.iter().map(|polygon| &polygon[..]), Ink(color, 255));
    }
}

/// Shapes of a marker, in the order of drawing: paper, black square, white cells.
pub(crate) fn marker_shapes(marker: &Marker) -> [(Vec<[V3; 4]>, [u8; 3]); 3] {
    let square = |half: f32| {
        vec![[(-half, -half), (half, -half), (half, half), (-half, half)].map(|(u, v)| marker.point(u, v))]
    };
    let cells = white_cells().map(|(column, row)| cell(marker, column, row)).collect();
    [(square(0.5 + QUIET), [255; 3]), (square(0.5), [16, 18, 20]), (cells, [255; 3])]
}

/// Column from the left and row from the top, 0 to 4, of the white cells.
fn white_cells() -> impl Iterator<Item = (usize, usize)> {
    (0..25).map(|i| (i % 5, i / 5)).filter(|(column, row)| BITS[*row] >> (4 - column) & 1 == 1)
}

/// Corners of an inner cell; the square is seven cells wide with its black border.
fn cell(marker: &Marker, column: usize, row: usize) -> [V3; 4] {
    let left = (column as f32 + 1.0) / 7.0 - 0.5;
    let low = 0.5 - (row as f32 + 2.0) / 7.0;
    let side = 1.0 / 7.0;
    [(left, low), (left + side, low), (left + side, low + side), (left, low + side)]
        .map(|(u, v)| marker.point(u, v))
}
