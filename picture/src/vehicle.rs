//! The drone itself and its shadow.

use crate::Drone;
use crate::draw::{Canvas, Ink, blend};
use crate::vector::{Rotation, V3, add, dot, mix, on_floor, scale};
use crate::view::SPAN_M;

const ARM_M: f32 = SPAN_M / 2.0;
const ROTOR_M: f32 = 0.0225;
/// Rotors turn this far above the arms.
const ROTOR_RISE_M: f32 = 0.012;
const NOSE_M: f32 = 0.052;
/// Half sides of the body (board, battery) and of the camera casing 2 cm below it.
const BODY_M: V3 = [0.019, 0.015, 0.007];
const CAMERA_M: V3 = [0.007, 0.007, 0.005];
const CAMERA_DROP_M: f32 = 0.017;
const CORNERS: usize = 20;
const DARK: [u8; 3] = [38, 44, 52];
const NOSE: [u8; 3] = [213, 94, 0];
const NOSE_ON_WARM: [u8; 3] = [0, 90, 181];

/// Body points to room points, at the size the drone is drawn with.
struct Pose {
    centre: V3,
    turn: Rotation,
    size: f32,
}

impl Pose {
    fn new(canvas: &Canvas, drone: &Drone) -> Self {
        let turn = Rotation::new(drone.roll_rad, drone.pitch_rad, drone.yaw_rad);
        Self { centre: drone.pos_m, turn, size: canvas.view.exaggeration(drone.pos_m) }
    }

    fn to_world(&self, body: V3) -> V3 {
        add(self.centre, scale(self.turn.apply(body), self.size))
    }

    fn rotor(&self, hub: V3) -> Vec<V3> {
        let corner = |i: usize| {
            let (s, c) = (i as f32 * std::f32::consts::TAU / CORNERS as f32).sin_cos();
            self.to_world(add(hub, [ROTOR_M * c, ROTOR_M * s, ROTOR_RISE_M]))
        };
        (0..CORNERS).map(corner).collect()
    }
}

/// Ends of the arms: front left, front right, rear right, rear left.
fn hubs() -> [V3; 4] {
    let d = ARM_M * std::f32::consts::FRAC_1_SQRT_2;
    [[d, d, 0.0], [d, -d, 0.0], [-d, -d, 0.0], [-d, d, 0.0]]
}

/// The shape of rotors, arms and body, cast straight down.
pub(crate) fn shadow(canvas: &mut Canvas, drone: &Drone) {
    if drone.pos_m[2] < 0.0 {
        return;
    }
    let pose = Pose::new(canvas, drone);
    let mut shapes: Vec<Vec<V3>> = hubs().map(|hub| pose.rotor(hub)).into();
    shapes.push(bar(&pose, hubs()[0], hubs()[2], 0.005));
    shapes.push(bar(&pose, hubs()[1], hubs()[3], 0.005));
    shapes.push(bar(&pose, [-BODY_M[0], 0.0, 0.0], [BODY_M[0], 0.0, 0.0], BODY_M[1]));
    for shape in &mut shapes {
        shape.iter_mut().for_each(|point| *point = on_floor(*point));
    }
    // A higher drone leaves a weaker shadow.
    let strength = 95.0 / (1.0 + 0.35 * drone.pos_m[2]);
    canvas.fill(shapes.iter().map(Vec::as_slice), Ink([20, 30, 45], strength as u8));
}

/// A flat strip from one body point to another, counter-clockwise like the rotors so that shapes merge.
fn bar(pose: &Pose, from: V3, to: V3, half_width: f32) -> Vec<V3> {
    let (x, y) = (to[0] - from[0], to[1] - from[1]);
    let k = half_width / x.hypot(y);
    let side = [-y * k, x * k, 0.0];
    let back = scale(side, -1.0);
    [add(from, back), add(to, back), add(to, side), add(from, side)].map(|p| pose.to_world(p)).into()
}

/// One piece of the drone, to be drawn from far to near.
enum Part {
    Arm(usize),
    Body,
    Nose,
}

/// Draws the drone with its true attitude.
pub(crate) fn paint(canvas: &mut Canvas, drone: &Drone) {
    let pose = Pose::new(canvas, drone);
    let pixels = canvas.view.pixels_per_m(drone.pos_m) * pose.size;
    let up = pose.turn.apply([0.0, 0.0, 1.0]);
    let upright = canvas.view.faces(drone.pos_m, up);
    let mut parts: Vec<(f32, Part)> = Vec::with_capacity(6);
    for (i, hub) in hubs().into_iter().enumerate() {
        parts.push((canvas.view.depth(pose.to_world(hub)), Part::Arm(i)));
    }
    parts.push((canvas.view.depth(drone.pos_m), Part::Body));
    parts.push((canvas.view.depth(pose.to_world([0.5 * NOSE_M, 0.0, 0.0])), Part::Nose));
    parts.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (_, part) in parts {
        match part {
            Part::Arm(i) => arm(canvas, &pose, drone, i, upright, pixels),
            Part::Body => body(canvas, &pose, drone, upright),
            Part::Nose => nose(canvas, &pose, drone, pixels),
        }
    }
}

fn arm(canvas: &mut Canvas, pose: &Pose, drone: &Drone, index: usize, upright: bool, pixels: f32) {
    let hub = hubs()[index];
    let tip = add(hub, [0.0, 0.0, ROTOR_RISE_M]);
    let disc = pose.rotor(hub);
    let front = index < 2;
    let tint = if front { nose_color(drone) } else { drone.color };
    let frame = |canvas: &mut Canvas| {
        canvas.line(&[pose.to_world([0.0; 3]), pose.to_world(hub)], 0.0065 * pixels, Ink(DARK, 255));
        canvas.line(
            &[pose.to_world(add(hub, [0.0, 0.0, -0.007])), pose.to_world(tip)],
            0.0075 * pixels,
            Ink([96, 104, 114], 255),
        );
    };
    let rotor = |canvas: &mut Canvas| {
        let mut rim = disc.clone();
        rim.extend(disc.first());
        canvas.fill([&disc[..]], Ink(tint, 120));
        canvas.line(&rim, (0.0028 * pixels).max(1.0), Ink(blend(tint, [0; 3], 0.15), 255));
    };
    stack(canvas, upright, frame, rotor);
}

/// Draws two parts: seen from above the upper one covers the lower one, seen from below it is the other way round.
fn stack(canvas: &mut Canvas, upright: bool, lower: impl Fn(&mut Canvas), upper: impl Fn(&mut Canvas)) {
    let parts: [&dyn Fn(&mut Canvas); 2] = if upright { [&lower, &upper] } else { [&upper, &lower] };
    parts.into_iter().for_each(|draw| draw(canvas));
}

fn nose(canvas: &mut Canvas, pose: &Pose, drone: &Drone, pixels: f32) {
    let ink = Ink(nose_color(drone), 255);
    let (root, tip) = ([BODY_M[0], 0.0, 0.0], [NOSE_M, 0.0, 0.0]);
    canvas.line(&[pose.to_world(root), pose.to_world(mix(root, tip, 0.7))], 0.006 * pixels, ink);
    let head = [[NOSE_M - 0.012, 0.008, 0.0], [NOSE_M - 0.012, -0.008, 0.0], [NOSE_M + 0.004, 0.0, 0.0]];
    canvas.fill([&head.map(|p| pose.to_world(p))[..]], ink);
}

/// Vermilion, or blue where the drone itself is warm.
fn nose_color(drone: &Drone) -> [u8; 3] {
    let apart = |i: usize| i32::from(drone.color[i]) - i32::from(NOSE[i]);
    let distance: i32 = (0..3).map(|i| apart(i).pow(2)).sum();
    if distance < 110 * 110 { NOSE_ON_WARM } else { NOSE }
}

fn body(canvas: &mut Canvas, pose: &Pose, drone: &Drone, upright: bool) {
    let camera = |canvas: &mut Canvas| cuboid(canvas, pose, [0.0, 0.0, -CAMERA_DROP_M], CAMERA_M, DARK);
    let board = |canvas: &mut Canvas| cuboid(canvas, pose, [0.0; 3], BODY_M, drone.color);
    stack(canvas, upright, camera, board);
}

/// A box; of a convex body the faces that look at the camera never cover each other, so order does not
/// matter.
fn cuboid(canvas: &mut Canvas, pose: &Pose, centre: V3, half: V3, color: [u8; 3]) {
    let light = [0.30, -0.45, 0.84];
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let mut out = [0.0; 3];
            out[axis] = sign;
            let normal = pose.turn.apply(out);
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let face = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(a, b)| {
                let mut corner = centre;
                corner[axis] += sign * half[axis];
                corner[u] += a * half[u];
                corner[v] += b * half[v];
                pose.to_world(corner)
            });
            if canvas.view.faces(face[0], normal) {
                let shade = 0.5 - 0.5 * dot(normal, light);
                canvas.fill([&face[..]], Ink(blend(color, [12, 16, 24], 0.7 * shade), 255));
            }
        }
    }
}
