//! The frame that shows a scene.

use crate::PictureError;
use crate::draw::Canvas;
use crate::error::within;
use crate::scene::Scene;
use crate::view::View;
use crate::{floor, props, vehicle};

/// Largest distance from the origin that is drawn, in metres; beyond it `f32` pixels are no longer
/// trustworthy.
const FARTHEST_M: f32 = 1.0e4;
/// Largest accepted frame side in pixels.
const LARGEST_SIDE: usize = 8192;

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
        within("drone attitude", i, &[drone.roll_rad, drone.pitch_rad, drone.yaw_rad], f32::MIN, f32::MAX)?;
    }
    let trails = scene.trails_m.iter().map(|trail| ("trail", *trail));
    for (what, points) in trails.chain([("reference path", scene.path_m), ("setpoint", scene.setpoints_m)]) {
        points.iter().enumerate().try_for_each(|(i, point)| within(what, i, point, -m, m))?;
    }
    scene.fix_m.iter().try_for_each(|point| within("camera fix", 0, point, -m, m))?;
    for (i, marker) in scene.markers.iter().enumerate() {
        within("marker position", i, &[marker.x_m, marker.y_m], -m, m)?;
        within("marker yaw", i, &[marker.yaw_rad], f32::MIN, f32::MAX)?;
        within("marker side", i, &[marker.side_m], 1e-3, 100.0)?;
    }
    scene.camera_fov_rad.iter().try_for_each(|fov| within("camera angle of view", 0, &[*fov], 0.01, 3.1))
}
