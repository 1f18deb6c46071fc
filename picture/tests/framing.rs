//! Tests of the camera's framing of a scene.

use crazyflie_picture::{Drone, Marker, Scene, View};

const BLUE: [u8; 3] = [0, 0, 255];
const MARKER: [Marker; 1] = [Marker { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0, side_m: 0.197 }];

fn drone_at(pos_m: [f32; 3], color: [u8; 3]) -> Drone {
    Drone { pos_m, roll_rad: 0.0, pitch_rad: 0.0, yaw_rad: 0.0, color }
}

fn view(scene: &Scene) -> View {
    View::frame(scene, 480, 360)
}

#[test]
fn drone_setpoint_and_marker_stay_in_the_frame() {
    for (width, height) in [(480, 360), (200, 400), (1000, 200), (64, 64)] {
        for drone in [[0.0, 0.0, 0.03], [0.8, 0.0, 0.7], [-2.4, 2.4, 2.8], [30.0, -12.0, 5.0]] {
            for setpoint in [[0.0, 0.0, 0.7], [-1.0, 2.0, 1.5]] {
                let drones = [drone_at(drone, BLUE)];
                let scene =
                    Scene { drones: &drones, setpoints_m: &[setpoint], markers: &MARKER, ..Scene::default() };
                let camera = View::frame(&scene, width, height);
                for point in [drone, setpoint, [0.0; 3], [drone[0], drone[1], 0.0]] {
                    let [x, y] = camera.project(point).unwrap();
                    let inside = x > 0.0 && x < width as f32 && y > 0.0 && y < height as f32;
                    assert!(inside, "{point:?} at {x} {y} of {width} {height}");
                }
            }
        }
    }
}

#[test]
fn among_many_markers_the_nearest_is_framed_and_the_view_stays_close() {
    let markers: Vec<Marker> = (0..20).map(|i| Marker { x_m: i as f32, ..Marker::default() }).collect();
    let drones = [drone_at([7.2, 0.0, 0.7], BLUE)];
    let scene = Scene { drones: &drones, markers: &markers, ..Scene::default() };
    let camera = view(&scene);
    let [x, y] = camera.project([7.0, 0.0, 0.0]).unwrap();
    assert!((0.0..480.0).contains(&x) && (0.0..360.0).contains(&y));
    assert!(camera.exaggeration(drones[0].pos_m) < 3.0);
}

#[test]
fn the_camera_moves_smoothly() {
    let markers = [MARKER[0], Marker { x_m: 1.5, y_m: 0.5, ..MARKER[0] }];
    let mut before: Option<[f32; 2]> = None;
    for i in 0..400 {
        let t = i as f32 * 0.01;
        let drones = [drone_at([t - 1.0, 0.4 * (2.0 * t).sin(), 0.3 * t], BLUE)];
        let setpoints_m: &[_] = &[[0.0, 0.0, 0.7]];
        let scene = Scene { drones: &drones, markers: &markers, setpoints_m, ..Scene::default() };
        let now = view(&scene).project([0.0, 0.0, 0.0]).unwrap();
        if let Some(before) = before {
            assert!((now[0] - before[0]).hypot(now[1] - before[1]) < 6.0, "jump at {t}");
        }
        before = Some(now);
    }
}

#[test]
fn small_drones_are_drawn_larger_than_life() {
    for (x, height) in [(0.0, 360), (4.0, 360), (4.0, 1080)] {
        let drones = [drone_at([x, 0.0, 0.7], BLUE)];
        let scene = Scene { drones: &drones, markers: &MARKER, ..Scene::default() };
        let camera = View::frame(&scene, height * 4 / 3, height);
        let factor = camera.exaggeration(drones[0].pos_m);
        let half = 0.046 * factor;
        // Across the line of sight, where nothing is foreshortened.
        let (s, c) = 43.0_f32.to_radians().sin_cos();
        let ends = [-half, half].map(|r| camera.project([x + r * c, r * s, 0.7]).unwrap());
        let span = (ends[1][0] - ends[0][0]).hypot(ends[1][1] - ends[0][1]);
        assert!(factor >= 1.0 && span > 0.99 * height as f32 / 9.0, "{factor} {span}");
    }
}
