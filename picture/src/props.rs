//! Props in the air besides the drones: trail, reference path, setpoint, camera fix, height lines, view
//! cones.

use std::ops::Range;

use crate::draw::{Canvas, Ink};
use crate::scene::Scene;
use crate::vector::{Rotation, V3, add, mix, on_floor, scale};
use crate::{Drone, vehicle};

const TRAIL: [u8; 3] = [0, 114, 178];
const PATH: [u8; 3] = [90, 100, 112];
const SETPOINT: [u8; 3] = [0, 138, 100];
const FIX: [u8; 3] = [176, 80, 140];
const CONE: [u8; 3] = [214, 150, 0];
const PLUMB: [u8; 3] = [70, 82, 96];
/// The camera sits this far below the centre of mass.
const CAMERA_DROP_M: f32 = 0.02;
/// Rays of the camera that meet the floor later than this, or never, end here.
const LONGEST_RAY_M: f32 = 12.0;
/// A line is cut into so many pieces, each sorted and (for the trail) faded by itself.
const PIECES: usize = 40;
/// Points of a line nearer than this to the last one drawn add nothing.
const STEP_PX: f32 = 1.5;

/// Something in the air, with the depth that decides what covers what.
pub(crate) struct Item {
    pub(crate) depth: f32,
    what: What,
}

enum What {
    Trail { points: Vec<V3>, newness: f32, color: [u8; 3] },
    Path { points: Vec<V3> },
    Plumb { from: V3, ink: Ink },
    Ray { from: V3, to: V3 },
    Drone(usize),
}

/// Everything in the air, unsorted.
pub(crate) fn items(scene: &Scene, canvas: &Canvas) -> Vec<Item> {
    let view = canvas.view;
    let mut items = Vec::new();
    let mut push = |at: V3, what: What| items.push(Item { depth: view.depth(at), what });
    for (i, trail) in scene.trails_m.iter().enumerate() {
        let own = scene.drones.get(i).map(|drone| drone.color).filter(|_| scene.trails_m.len() > 1);
        for (points, newness) in pieces(canvas, trail) {
            push(middle(&points), What::Trail { points, newness, color: own.unwrap_or(TRAIL) });
        }
    }
    for (points, _) in pieces(canvas, scene.path_m) {
        push(middle(&points), What::Path { points });
    }
    for (i, drone) in scene.drones.iter().enumerate() {
        push(drone.pos_m, What::Drone(i));
        let from = drone.pos_m;
        push(mix(from, on_floor(from), 0.5), What::Plumb { from, ink: Ink(PLUMB, 190) });
        if let Some(fov) = scene.camera_fov_rad {
            let (from, corners) = rays(drone, fov);
            corners.into_iter().for_each(|to| push(mix(from, to, 0.5), What::Ray { from, to }));
        }
    }
    for at in scene.setpoints_m {
        push(mix(*at, on_floor(*at), 0.5), What::Plumb { from: *at, ink: Ink(SETPOINT, 150) });
    }
    items
}

pub(crate) fn paint(scene: &Scene, item: &Item, canvas: &mut Canvas) {
    match &item.what {
        What::Trail { points, newness, color } => {
            let ink = Ink(*color, (30.0 + 200.0 * newness) as u8);
            canvas.line(points, canvas.pen(1.2 + 1.3 * newness), ink);
        }
        What::Path { points } => canvas.line(points, canvas.pen(1.4), Ink(PATH, 170)),
        What::Plumb { from, ink } => plumb(canvas, *from, *ink),
        What::Ray { from, to } => canvas.line(&[*from, *to], canvas.pen(1.0), Ink(CONE, 150)),
        What::Drone(index) => scene.drones.get(*index).into_iter().for_each(|d| vehicle::paint(canvas, d)),
    }
}

/// The part of the floor that the drone's camera sees.
pub(crate) fn footprint(canvas: &mut Canvas, drone: &Drone, fov: f32) {
    let (_, corners) = rays(drone, fov);
    canvas.fill([&corners[..]], Ink(CONE, 30));
    let mut outline = corners.to_vec();
    outline.extend(corners.first());
    canvas.line(&outline, canvas.pen(1.0), Ink(CONE, 170));
}

/// Returns the position of the camera, and the points at which the rays through its image corners meet the floor.
fn rays(drone: &Drone, fov: f32) -> (V3, [V3; 4]) {
    let turn = Rotation::new(drone.roll_rad, drone.pitch_rad, drone.yaw_rad);
    let from = add(drone.pos_m, turn.apply([0.0, 0.0, -CAMERA_DROP_M]));
    let diagonal = (0.5 * fov).tan();
    // A 3:2 image has half sides of 3 and 2 parts of sqrt(13) of the half diagonal.
    let (x, y) = (diagonal * 3.0 / 13.0_f32.sqrt(), diagonal * 2.0 / 13.0_f32.sqrt());
    let corners = [(x, y), (-x, y), (-x, -y), (x, -y)].map(|(x, y)| {
        let ray = turn.apply([x, y, -1.0]);
        let longest = LONGEST_RAY_M / (x.hypot(y)).hypot(1.0);
        let reach = if ray[2] < 0.0 { (-from[2].max(0.0) / ray[2]).min(longest) } else { longest };
        on_floor(add(from, scale(ray, reach)))
    });
    (from, corners)
}

/// Thins a line to what the frame resolves and cuts it into pieces that share their end points, each with its
/// place along the line (0 at the first point, 1 at the last).
fn pieces(canvas: &Canvas, line: &[V3]) -> Vec<(Vec<V3>, f32)> {
    let mut kept: Vec<(V3, usize)> = Vec::new();
    let mut before: Option<[f32; 2]> = None;
    for (i, &point) in line.iter().enumerate() {
        let projected = canvas.view.project(point);
        let near = projected.zip(before).is_some_and(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]) < STEP_PX);
        if !near || i + 1 == line.len() {
            kept.push((point, i));
            before = projected;
        }
    }
    let last = line.len().saturating_sub(1).max(1) as f32;
    let piece = |range: Range<usize>| {
        let part = &kept[range];
        let newness = part.last().map_or(0.0, |(_, i)| *i as f32 / last);
        (part.iter().map(|(point, _)| *point).collect(), newness)
    };
    let steps = kept.len().saturating_sub(1);
    let length = steps.div_ceil(PIECES).max(1);
    (0..steps).step_by(length).map(|from| piece(from..(from + length).min(steps) + 1)).collect()
}

fn middle(points: &[V3]) -> V3 {
    points.get(points.len() / 2).copied().unwrap_or_default()
}

/// A vertical line to the floor, with a tick at every quarter of a metre to read the height by.
fn plumb(canvas: &mut Canvas, from: V3, ink: Ink) {
    canvas.line_dashed(&[on_floor(from), from], canvas.pen(1.0), ink, Some(canvas.pen(3.0)));
    let half = canvas.pen(2.5);
    let ticks = ((from[2] / 0.25).floor().max(0.0) as usize).min(40);
    for k in 1..=ticks {
        if let Some([x, y]) = canvas.view.project([from[0], from[1], k as f32 * 0.25]) {
            canvas.line_px(&[[x - half, y], [x + half, y]], canvas.pen(1.0), ink);
        }
    }
}

/// Setpoint and camera fix, after everything else: a drone that is where it should be must not hide the
/// setpoint.
pub(crate) fn marks(scene: &Scene, canvas: &mut Canvas) {
    scene.fix_m.iter().for_each(|at| fix(canvas, *at));
    scene.setpoints_m.iter().for_each(|at| setpoint(canvas, *at));
}

/// A diamond with a cross in it.
fn setpoint(canvas: &mut Canvas, at: V3) {
    let Some([x, y]) = canvas.view.project(at) else {
        return;
    };
    let r = canvas.pen(7.0);
    let diamond = [[x, y - r], [x + r, y], [x, y + r], [x - r, y], [x, y - r], [x + r, y]];
    canvas.line_px(&diamond, canvas.pen(4.0), Ink([255; 3], 150));
    canvas.line_px(&diamond, canvas.pen(1.8), Ink(SETPOINT, 255));
    let c = 0.5 * r;
    canvas.line_px(&[[x - c, y], [x + c, y]], canvas.pen(1.4), Ink(SETPOINT, 255));
    canvas.line_px(&[[x, y - c], [x, y + c]], canvas.pen(1.4), Ink(SETPOINT, 255));
}

/// A saltire, so that it cannot be taken for the setpoint.
fn fix(canvas: &mut Canvas, at: V3) {
    let Some([x, y]) = canvas.view.project(at) else {
        return;
    };
    let r = canvas.pen(5.0);
    for (width, ink) in [(4.0, Ink([255; 3], 200)), (2.0, Ink(FIX, 255))] {
        canvas.line_px(&[[x - r, y - r], [x + r, y + r]], canvas.pen(width), ink);
        canvas.line_px(&[[x - r, y + r], [x + r, y - r]], canvas.pen(width), ink);
    }
}

/// Directions of the room's axes in the lower left corner, with their letters drawn as strokes.
pub(crate) fn axes(canvas: &mut Canvas) {
    const COLORS: [[u8; 3]; 3] = [[200, 60, 40], [30, 130, 70], [30, 80, 180]];
    const LETTERS: [&[&[[f32; 2]]]; 3] = [
        &[&[[-1.0, -1.0], [1.0, 1.0]], &[[-1.0, 1.0], [1.0, -1.0]]],
        &[&[[-1.0, -1.0], [0.0, 0.2]], &[[1.0, -1.0], [-0.6, 1.6]]],
        &[&[[-0.9, -1.0], [0.9, -1.0], [-0.9, 1.0], [0.9, 1.0]]],
    ];
    let (arm, letter) = (canvas.pen(24.0), canvas.pen(3.0));
    let origin = [canvas.pen(18.0), canvas.height() - canvas.pen(18.0)];
    for ((direction, color), strokes) in canvas.view.axes().into_iter().zip(COLORS).zip(LETTERS) {
        let along = |r: f32| [origin[0] + r * direction[0], origin[1] + r * direction[1]];
        let ink = Ink(color, 255);
        canvas.line_px(&[origin, along(arm)], canvas.pen(1.6), ink);
        let length = direction[0].hypot(direction[1]).max(0.1);
        let [x, y] = along(arm + 2.4 * letter / length);
        for stroke in strokes {
            let stroke: Vec<[f32; 2]> =
                stroke.iter().map(|p| [x + letter * p[0], y + letter * p[1]]).collect();
            canvas.line_px(&stroke, canvas.pen(1.3), ink);
        }
    }
}
