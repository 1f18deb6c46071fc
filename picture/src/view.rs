//! The camera that looks at the scene: its position, and the projection of a point of the room into the image.

use crate::scene::Scene;
use crate::vector::{V3, add, dot, length, mix, on_floor, scale, sub};

/// Direction of sight, as MATLAB's `view(43, 24)`: x runs to the right and away, y to the left-to-right and
/// away.
pub(crate) const AZIMUTH_DEG: f64 = 43.0;
pub(crate) const ELEVATION_DEG: f64 = 24.0;
/// Vertical opening angle; narrow enough that perspective does not bend the reading of distances.
const FIELD_OF_VIEW_DEG: f32 = 35.0;
/// Nothing nearer to the camera than this is drawn.
pub(crate) const NEAR_M: f32 = 0.05;
/// Least distance of the camera, so that a drone on its marker does not fill the frame.
const CLOSEST_M: f32 = 1.3;
/// Motor to motor across the frame.
pub(crate) const SPAN_M: f32 = 0.092;
/// A marker that is this much farther away than the nearest one pulls on the framing 1/e as much.
const MARKER_REACH_M: f32 = 0.5;

/// A perspective camera over the scene, with x right and y down in the image.
///
/// [`View::frame`] places it exactly as [`render`](crate::render) does, so that an overlay can find its
/// pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    eye: V3,
    right: V3,
    up: V3,
    forward: V3,
    focal_px: f32,
    centre_px: [f32; 2],
    least_span_px: f32,
}

impl View {
    /// Places the camera: fixed azimuth and elevation, aimed at the midpoint of the drones and the setpoint
    /// (at the origin when there are none), shifted along the image's vertical so that what must be seen is
    /// centred, and as close as the drones, the setpoint, the reference path, their shadows and the nearest
    /// marker allow. Continuous in all positions, so an animation does not jump.
    pub fn frame(scene: &Scene, width: u32, height: u32) -> Self {
        let (size_x, size_y) = (width as f32, height as f32);
        let focal_px = 0.5 * size_y / (0.5 * FIELD_OF_VIEW_DEG).to_radians().tan();
        let least_span_px = (size_y / 9.0).max(40.0_f32.min(size_y / 3.0));
        let (sa, ca) = (AZIMUTH_DEG as f32).to_radians().sin_cos();
        let (se, ce) = (ELEVATION_DEG as f32).to_radians().sin_cos();
        let mut view = Self {
            eye: [0.0; 3],
            right: [ca, sa, 0.0],
            up: [-sa * se, ca * se, ce],
            forward: [-sa * ce, ca * ce, -se],
            focal_px,
            centre_px: [0.5 * size_x, 0.5 * size_y],
            least_span_px,
        };
        let focus = focus(scene);
        let margin = |size: f32| (0.5 * size - 0.04 * size - 0.8 * least_span_px).max(0.2 * size);
        let (slope_x, slope_y) = (margin(size_x) / focal_px, margin(size_y) / focal_px);
        // For a camera at distance d and shifted up by s, a point (a, b, c) along right, up and forward is
        // inside when
        // |a| <= (d + c) slope_x and |b - s| <= (d + c) slope_y; the best d and s follow from the extremes.
        let (mut distance, mut top, mut bottom) = (CLOSEST_M, f32::MIN, f32::MIN);
        for_each_framed(scene, focus, |point| {
            let p = sub(point, focus);
            let (a, b, c) = (dot(p, view.right), dot(p, view.up), dot(p, view.forward));
            distance = distance.max(a.abs() / slope_x - c);
            top = top.max(b - c * slope_y);
            bottom = bottom.max(-b - c * slope_y);
        });
        let mut shift = 0.0;
        if top > f32::MIN {
            distance = distance.max(0.5 * (top + bottom) / slope_y);
            shift = 0.5 * (top - bottom);
        }
        view.eye = add(add(focus, scale(view.up, shift)), scale(view.forward, -distance));
        view
    }

    /// Pixel position (x right, y down, in pixels from the upper left corner) of a point of the room in
    /// metres; `None` when the point is behind the camera. The position may lie outside the frame.
    pub fn project(&self, point_m: [f32; 3]) -> Option<[f32; 2]> {
        let depth = self.depth(point_m);
        (depth >= NEAR_M).then(|| self.project_at(point_m, depth))
    }

    /// Returns the enlargement of a drone at this point: 1 if its 92 mm span covers at least 40 pixels, otherwise the
    /// factor that makes it so. (A ninth of the frame's height replaces the 40 pixels in frames taller than 360
    /// pixels, a third of it in frames lower than 120.)
    pub fn exaggeration(&self, point_m: [f32; 3]) -> f32 {
        (self.least_span_px / (SPAN_M * self.pixels_per_m(point_m))).max(1.0)
    }

    pub(crate) fn depth(&self, point: V3) -> f32 {
        dot(sub(point, self.eye), self.forward)
    }

    pub(crate) fn project_at(&self, point: V3, depth: f32) -> [f32; 2] {
        let p = sub(point, self.eye);
        let k = self.focal_px / depth;
        [self.centre_px[0] + k * dot(p, self.right), self.centre_px[1] - k * dot(p, self.up)]
    }

    pub(crate) fn pixels_per_m(&self, point: V3) -> f32 {
        self.focal_px / self.depth(point).max(NEAR_M)
    }

    /// True when a plane through `point` shows its upper side, the one `normal` points away from, to the
    /// camera.
    pub(crate) fn faces(&self, point: V3, normal: V3) -> bool {
        dot(sub(self.eye, point), normal) > 0.0
    }

    /// Height of the camera above the floor in metres.
    pub(crate) fn eye_height(&self) -> f32 {
        self.eye[2]
    }

    /// Depth of the floor seen in an image row; `None` above the horizon. The camera does not roll, so that
    /// all floor points of one row share it.
    pub(crate) fn floor_depth(&self, row: f32) -> Option<f32> {
        let slope = (row - self.centre_px[1]) * self.up[2] / self.focal_px - self.forward[2];
        (slope > 1e-4 && self.eye[2] > 0.0).then(|| self.eye[2] / slope)
    }

    /// Floor point seen at an image column when the floor there is at `depth`.
    pub(crate) fn floor_point(&self, column: f32, depth: f32) -> V3 {
        let side = (column - self.centre_px[0]) / self.focal_px * depth;
        let rise = (-self.eye[2] - depth * self.forward[2]) / self.up[2];
        let ray = add(add(scale(self.forward, depth), scale(self.right, side)), scale(self.up, rise));
        on_floor(add(self.eye, ray))
    }

    /// Pixels between two floor lines `spacing` apart that run across the line of sight, seen at a depth.
    pub(crate) fn floor_spacing_px(&self, spacing: f32, depth: f32) -> f32 {
        spacing * self.focal_px * self.eye[2] / (depth * depth)
    }

    /// Depth beyond which floor lines `spacing` apart are closer than `pixels`.
    pub(crate) fn floor_reach(&self, spacing: f32, pixels: f32) -> f32 {
        (spacing * self.focal_px * self.eye[2].max(0.0) / pixels).sqrt()
    }

    /// Directions of x, y and z in the image (y down), foreshortened as at the middle of the frame.
    pub(crate) fn axes(&self) -> [[f32; 2]; 3] {
        [0, 1, 2].map(|i| [self.right[i], -self.up[i]])
    }
}

/// Midpoint of the drones' mean position and that of the setpoints.
fn focus(scene: &Scene) -> V3 {
    match (centre(scene), mean(scene.setpoints_m.iter().copied())) {
        (Some(d), Some(s)) => mix(d, s, 0.5),
        (Some(p), None) | (None, Some(p)) => p,
        (None, None) => [0.0; 3],
    }
}

fn centre(scene: &Scene) -> Option<V3> {
    mean(scene.drones.iter().map(|drone| drone.pos_m))
}

fn mean(points: impl ExactSizeIterator<Item = V3>) -> Option<V3> {
    let count = points.len();
    let sum = points.fold([0.0; 3], add);
    (count > 0).then(|| scale(sum, 1.0 / count as f32))
}

/// Calls `visit` with every point that has to be inside the frame.
fn for_each_framed(scene: &Scene, focus: V3, mut visit: impl FnMut(V3)) {
    for point in scene.drones.iter().map(|d| d.pos_m).chain(scene.setpoints_m.iter().copied()) {
        visit(point);
        visit(on_floor(point));
    }
    scene.path_m.iter().copied().for_each(&mut visit);
    // The nearest marker stays in view. Farther ones are let go gradually, or a drone over one of a row of
    // markers would be shown from the end of the corridor; pulling them towards the focus keeps the framing
    // continuous.
    let near = centre(scene).unwrap_or(focus);
    let far = |m: &crate::Marker| length(sub([m.x_m, m.y_m, 0.0], on_floor(near)));
    let nearest = scene.markers.iter().map(far).fold(f32::INFINITY, f32::min);
    for marker in scene.markers {
        let weight = ((nearest - far(marker)) / MARKER_REACH_M).exp();
        marker.corners_m().into_iter().for_each(|corner| visit(mix(on_floor(focus), corner, weight)));
    }
}
