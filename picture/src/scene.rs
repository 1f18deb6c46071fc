//! A scene, and the frame that shows it.

use crate::PictureError;
use crate::draw::Canvas;
use crate::error::within;
use crate::vector::V3;
use crate::view::View;
use crate::{floor, props, vehicle};

/// Largest distance from the origin that is drawn, in metres; beyond it `f32` pixels are no longer
/// trustworthy.
const FARTHEST_M: f64 = 1.0e4;
/// Largest accepted frame side in pixels.
const LARGEST_SIDE: usize = 8192;

/// A drone: position of its centre of mass in metres (x right, y forward, z up), attitude in radians
/// (right-handed; positive pitch accelerates to +x, positive roll to -y), colour as RGB.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drone {
    /// Position of the centre of mass in metres.
    pub pos_m: [f32; 3],
    /// Roll about the body's x axis in radians.
    pub roll_rad: f32,
    /// Pitch about y in radians.
    pub pitch_rad: f32,
    /// Yaw about z in radians; at zero the nose points along +x.
    pub yaw_rad: f32,
    /// Colour of body and rotors, RGB.
    pub color: [u8; 3],
}

/// An ArUco marker flat on the floor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Marker {
    /// Centre, x in metres.
    pub x_m: f32,
    /// Centre, y in metres.
    pub y_m: f32,
    /// Rotation about z in radians.
    pub yaw_rad: f32,
    /// Side of the black square in metres, 0.197 by default.
    pub side_m: f32,
}

impl Default for Marker {
    fn default() -> Self {
        Self { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0, side_m: 0.197 }
    }
}

impl Marker {
    /// A floor point given in the marker's own frame, in units of its side: (-0.5, -0.5) is a corner.
    pub(crate) fn point(&self, u: f32, v: f32) -> V3 {
        let (s, c) = self.yaw_rad.sin_cos();
        let (x, y) = (u * self.side_m, v * self.side_m);
        [self.x_m + c * x - s * y, self.y_m + s * x + c * y, 0.0]
    }

    pub(crate) fn corners_m(&self) -> [V3; 4] {
        [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)].map(|(u, v)| self.point(u, v))
    }
}

/// Everything one frame shows. All lengths are metres in the room's frame: x right, y forward, z up.
#[derive(Debug, Clone, Copy, Default)]
pub struct Scene<'a> {
    /// The drones.
    pub drones: &'a [Drone],
    /// Positions flown so far by each drone, oldest first; they fade with age. Each has its drone's colour, a
    /// single one its own.
    pub trails_m: &'a [&'a [[f32; 3]]],
    /// Where the controllers want the drones to be.
    pub setpoints_m: &'a [[f32; 3]],
    /// Reference path; may be empty.
    pub path_m: &'a [[f32; 3]],
    /// Markers on the floor.
    pub markers: &'a [Marker],
    /// Last position that the camera reported.
    pub fix_m: Option<[f32; 3]>,
    /// Angle of view of each drone's downward camera over the image diagonal, in radians, between 0 and pi.
    /// The image is 3 wide (along the body's x) by 2 high, as 720 x 480.
    pub camera_fov_rad: Option<f32>,
}

/// Draws the scene into `out`: RGB, 8 bits each, row after row from the upper left, `height * width * 3`
/// bytes.
///
/// The camera frames the scene by itself, see [`View::frame`]; a drone that would be too small to read is
/// drawn larger than life, see [`View::exaggeration`]. The same input gives the same bytes.
///
/// # Errors
/// [`PictureError::ZeroSize`], [`PictureError::TooLarge`] (over 8192 pixels on a side),
/// [`PictureError::BufferLength`], [`PictureError::NonFinite`], and [`PictureError::OutOfRange`] for
/// positions farther than 10 km out, a marker side that is not between 1 mm and 100 m and an angle of view
/// not between 0.01 and 3.1 rad.
pub fn render(scene: &Scene, width: u32, height: u32, out: &mut [u8]) -> Result<(), PictureError> {
    let (columns, rows) = (width as usize, height as usize);
    if columns == 0 || rows == 0 {
        return Err(PictureError::ZeroSize { width: columns, height: rows });
    }
    let too_large = PictureError::TooLarge { width: columns, height: rows, limit: LARGEST_SIDE };
    if columns.max(rows) > LARGEST_SIDE {
        return Err(too_large);
    }
    if out.len() != columns * rows * 3 {
        return Err(PictureError::BufferLength { expected: columns * rows * 3, actual: out.len() });
    }
    check(scene)?;
    let view = View::frame(scene, width, height);
    let mut canvas = Canvas::new(view, width, height).ok_or(too_large)?;
    paint(scene, &mut canvas);
    canvas.write_rgb(out);
    Ok(())
}

/// Painter's order: what lies on the floor first, then everything in the air from far to near.
fn paint(scene: &Scene, canvas: &mut Canvas) {
    floor::paint(scene, canvas);
    let drones = scene.drones.iter();
    if let Some(fov) = scene.camera_fov_rad {
        drones.clone().for_each(|drone| props::footprint(canvas, drone, fov));
    }
    drones.for_each(|drone| vehicle::shadow(canvas, drone));
    let mut items = props::items(scene, canvas);
    items.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    for item in &items {
        props::paint(scene, item, canvas);
    }
    props::marks(scene, canvas);
    props::axes(canvas);
}

fn check(scene: &Scene) -> Result<(), PictureError> {
    let m = FARTHEST_M;
    for (i, drone) in scene.drones.iter().enumerate() {
        within("drone position", i, &drone.pos_m, -m, m)?;
        within("drone attitude", i, &[drone.roll_rad, drone.pitch_rad, drone.yaw_rad], f64::MIN, f64::MAX)?;
    }
    let trails = scene.trails_m.iter().map(|trail| ("trail", *trail));
    for (what, points) in trails.chain([("reference path", scene.path_m), ("setpoint", scene.setpoints_m)]) {
        points.iter().enumerate().try_for_each(|(i, point)| within(what, i, point, -m, m))?;
    }
    scene.fix_m.iter().try_for_each(|point| within("camera fix", 0, point, -m, m))?;
    for (i, marker) in scene.markers.iter().enumerate() {
        within("marker position", i, &[marker.x_m, marker.y_m], -m, m)?;
        within("marker yaw", i, &[marker.yaw_rad], f64::MIN, f64::MAX)?;
        within("marker side", i, &[marker.side_m], 1e-3, 100.0)?;
    }
    scene.camera_fov_rad.iter().try_for_each(|fov| within("camera angle of view", 0, &[*fov], 0.01, 3.1))
}
