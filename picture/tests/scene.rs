//! Tests of frames: where things are drawn, and which are refused.

use crazyflie_picture::{Drone, Marker, Scene, View, render};

const SIZE: (u32, u32) = (480, 360);
const BLUE: [u8; 3] = [0, 0, 255];
const GREEN: [u8; 3] = [0, 200, 0];
const MARKER: [Marker; 1] = [Marker { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0, side_m: 0.197 }];

fn drone_at(pos_m: [f32; 3], color: [u8; 3]) -> Drone {
    Drone { pos_m, roll_rad: 0.0, pitch_rad: 0.0, yaw_rad: 0.0, color }
}

fn frame(scene: &Scene) -> Vec<u8> {
    let mut rgb = vec![7; (SIZE.0 * SIZE.1 * 3) as usize];
    render(scene, SIZE.0, SIZE.1, &mut rgb).unwrap();
    rgb
}

fn view(scene: &Scene) -> View {
    View::frame(scene, SIZE.0, SIZE.1)
}

fn pixel(rgb: &[u8], [x, y]: [f32; 2]) -> [i32; 3] {
    let start = (y as usize * SIZE.0 as usize + x as usize) * 3;
    [0, 1, 2].map(|channel| i32::from(rgb[start + channel]))
}

/// Mean column and row of the pixels that pass.
fn centre_of(rgb: &[u8], pass: impl Fn([i32; 3], [f32; 2]) -> bool) -> [f32; 2] {
    let mut sum = [0.0_f32; 3];
    for i in 0..rgb.len() / 3 {
        let at = [(i % SIZE.0 as usize) as f32, (i / SIZE.0 as usize) as f32];
        if pass(pixel(rgb, at), at) {
            sum = [sum[0] + at[0], sum[1] + at[1], sum[2] + 1.0];
        }
    }
    assert!(sum[2] > 20.0, "hardly any such pixel: {}", sum[2]);
    [sum[0] / sum[2], sum[1] / sum[2]]
}

fn bluish([r, g, b]: [i32; 3], _: [f32; 2]) -> bool {
    b > r + 90 && b > g + 90
}

fn greenish([r, g, b]: [i32; 3], _: [f32; 2]) -> bool {
    g > r + 60 && g > b + 60
}

/// The nose and the two front rotors.
fn vermilion([r, g, b]: [i32; 3]) -> bool {
    r > g + 40 && g > b
}

#[test]
fn larger_x_is_drawn_further_right() {
    let drones = [drone_at([-0.5, 0.0, 0.7], BLUE), drone_at([0.5, 0.0, 0.7], GREEN)];
    let scene = Scene { drones: &drones, markers: &MARKER, ..Scene::default() };
    let rgb = frame(&scene);
    let (low, high) = (centre_of(&rgb, bluish), centre_of(&rgb, greenish));
    assert!(high[0] > low[0] + 50.0, "{low:?} {high:?}");
    for (seen, drone) in [(low, drones[0]), (high, drones[1])] {
        let expected = view(&scene).project(drone.pos_m).unwrap();
        assert!((seen[0] - expected[0]).abs() < 12.0 && (seen[1] - expected[1]).abs() < 12.0);
    }
}

#[test]
fn larger_z_is_drawn_higher() {
    let drones = [drone_at([0.0, 0.0, 0.3], BLUE), drone_at([0.0, 0.0, 0.9], GREEN)];
    let rgb = frame(&Scene { drones: &drones, ..Scene::default() });
    let (low, high) = (centre_of(&rgb, bluish), centre_of(&rgb, greenish));
    assert!(high[1] < low[1] - 50.0, "{low:?} {high:?}");
    assert!((high[0] - low[0]).abs() < 5.0);
}

#[test]
fn larger_y_is_drawn_further_away() {
    let scene = Scene { markers: &MARKER, ..Scene::default() };
    let camera = view(&scene);
    let rows = [-0.3, 0.0, 0.3].map(|y| camera.project([0.0, y, 0.0]).unwrap()[1]);
    assert!(rows[0] > rows[1] && rows[1] > rows[2]);
}

/// Mean row of the front left rotor, the one at +x and +y, which is seen at the right end of the drone.
fn front_left_row(roll_rad: f32, pitch_rad: f32) -> f32 {
    let drones = [Drone { roll_rad, pitch_rad, ..drone_at([0.0, 0.0, 0.7], BLUE) }];
    let scene = Scene { drones: &drones, markers: &MARKER, ..Scene::default() };
    let middle = view(&scene).project(drones[0].pos_m).unwrap();
    let near = |at: [f32; 2]| (at[1] - middle[1]).abs() < 40.0;
    centre_of(&frame(&scene), |p, at| vermilion(p) && at[0] > middle[0] + 12.0 && near(at))[1]
}

#[test]
fn positive_roll_lifts_the_left_rotors() {
    // The thrust then leans to -y, where the vehicle goes.
    assert!(front_left_row(0.35, 0.0) < front_left_row(0.0, 0.0) - 2.0);
    assert!(front_left_row(-0.35, 0.0) > front_left_row(0.0, 0.0) + 2.0);
}

#[test]
fn positive_pitch_lowers_the_nose() {
    assert!(front_left_row(0.0, 0.35) > front_left_row(0.0, 0.0) + 2.0);
    assert!(front_left_row(0.0, -0.35) < front_left_row(0.0, 0.0) - 2.0);
}

#[test]
fn yaw_turns_the_nose_towards_y() {
    let nose = |yaw_rad: f32| {
        let drones = [Drone { yaw_rad, ..drone_at([0.0, 0.0, 0.7], BLUE) }];
        let rgb = frame(&Scene { drones: &drones, markers: &MARKER, ..Scene::default() });
        centre_of(&rgb, |p, _| vermilion(p))
    };
    // From +x, right and near, to +y, right and far.
    let (ahead, left) = (nose(0.0), nose(std::f32::consts::FRAC_PI_2));
    assert!(left[1] < ahead[1] - 3.0, "{ahead:?} {left:?}");
}

#[test]
fn the_shadow_lies_on_the_floor_straight_below() {
    let here = [0.3, 0.2, 0.6];
    // A setpoint at the same place keeps the camera where it is when the drone is taken away.
    let without = Scene { setpoints_m: &[here], markers: &MARKER, ..Scene::default() };
    let drones = [drone_at(here, BLUE)];
    let with = Scene { drones: &drones, ..without };
    let camera = view(&with);
    assert_eq!(camera, view(&without));
    let (lit, shaded) = (frame(&without), frame(&with));
    let reach = 0.0325 * camera.exaggeration(here);
    for (x, y) in [(reach, reach), (reach, -reach), (-reach, reach), (-reach, -reach)] {
        let floor = camera.project([here[0] + x, here[1] + y, 0.0]).unwrap();
        let (lit, shaded) = (pixel(&lit, floor), pixel(&shaded, floor));
        assert!(lit.iter().zip(shaded).all(|(lit, shaded)| shaded < lit - 25), "{lit:?} {shaded:?}");
    }
    assert!(camera.project(here).unwrap()[1] < camera.project([0.3, 0.2, 0.0]).unwrap()[1] - 80.0);
}

#[test]
fn the_marker_is_black_with_a_white_border_and_bits() {
    let scene = Scene { markers: &MARKER, setpoints_m: &[[0.4, 0.0, 0.5]], ..Scene::default() };
    let (rgb, camera) = (frame(&scene), view(&scene));
    let cell = 0.197 / 7.0;
    let shade = |x: f32, y: f32| pixel(&rgb, camera.project([x, y, 0.0]).unwrap())[1];
    for side in [-3.0, 3.0] {
        assert!(shade(side * cell, 0.0) < 60 && shade(0.0, side * cell) < 60, "black border");
        assert!(shade(side * 1.32 * cell, 0.0) > 245, "white paper");
    }
    // First row of marker 582: black, white, black, black, white.
    let row: Vec<bool> = (0..5).map(|i| shade((i as f32 - 2.0) * cell, 2.0 * cell) > 128).collect();
    assert_eq!(row, [false, true, false, false, true]);
}

#[test]
fn the_trail_fades_with_age() {
    let trail: Vec<[f32; 3]> = (0..=200).map(|i| [i as f32 * 0.003 - 0.3, 0.0, 0.7]).collect();
    let without = Scene { setpoints_m: &[[0.0, 0.0, 0.7]], markers: &MARKER, ..Scene::default() };
    let with = Scene { trails_m: &[&trail], ..without };
    let (plain, drawn, camera) = (frame(&without), frame(&with), view(&with));
    let change = |point: [f32; 3]| {
        let px = camera.project(point).unwrap();
        pixel(&plain, px)[0] - pixel(&drawn, px)[0]
    };
    let (old, new) = (change([-0.27, 0.0, 0.7]), change([0.27, 0.0, 0.7]));
    assert!(old > 3 && new > old + 60, "{old} {new}");
}

#[test]
fn the_camera_footprint_tints_what_it_covers() {
    let drones = [drone_at([0.0, 0.0, 0.7], BLUE)];
    let without = Scene { drones: &drones, markers: &MARKER, ..Scene::default() };
    let with = Scene { camera_fov_rad: Some(120.0_f32.to_radians()), ..without };
    let (plain, tinted, camera) = (frame(&without), frame(&with), view(&with));
    let changed = |x: f32, y: f32| {
        let px = camera.project([x, y, 0.0]).unwrap();
        pixel(&plain, px) != pixel(&tinted, px)
    };
    // From 0.68 m the 3:2 image of 120 degrees over its diagonal reaches 0.98 m along x and 0.65 m along y.
    assert!(changed(-0.6, 0.3) && changed(0.1, -0.3) && changed(-0.2, 0.6));
    assert!(!changed(-0.3, 0.8));
}

#[test]
fn the_same_scene_gives_the_same_bytes() {
    let drones = [drone_at([0.3, 0.1, 0.7], BLUE)];
    let path: Vec<[f32; 3]> = (0..50).map(|i| [0.1 * i as f32, 0.0, 0.5]).collect();
    let scene = Scene {
        drones: &drones,
        trails_m: &[&path],
        setpoints_m: &[[0.0, 0.0, 0.7]],
        path_m: &path,
        markers: &MARKER,
        fix_m: Some([0.1, 0.0, 0.6]),
        camera_fov_rad: Some(2.0),
    };
    assert_eq!(frame(&scene), frame(&scene));
}
