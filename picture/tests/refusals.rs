//! Scenes that are refused, and odd scenes that are drawn.

use crazyflie_picture::{Drone, Marker, PictureError, Scene, render};

const BLUE: [u8; 3] = [0, 0, 255];
const GREEN: [u8; 3] = [0, 200, 0];

fn drone_at(pos_m: [f32; 3], color: [u8; 3]) -> Drone {
    Drone { pos_m, roll_rad: 0.0, pitch_rad: 0.0, yaw_rad: 0.0, color }
}

#[test]
fn odd_scenes_are_drawn_all_the_same() {
    let drones = [
        drone_at([0.0, 0.0, -2.0], BLUE),
        Drone { roll_rad: 3.1, pitch_rad: -1.5, yaw_rad: 40.0, ..drone_at([9.9e3, -9.9e3, 9.9e3], GREEN) },
    ];
    let far: Vec<[f32; 3]> = (0..2000).map(|i| [5.0 * i as f32, 0.0, (i % 7) as f32]).collect();
    let full = Scene {
        drones: &drones,
        trails_m: &[&far],
        path_m: &far[..1],
        camera_fov_rad: Some(3.1),
        ..Scene::default()
    };
    for scene in [Scene::default(), full, Scene { drones: &drones[..1], ..full }] {
        for (width, height) in [(1, 1), (3, 50), (320, 240)] {
            render(&scene, width, height, &mut vec![0; (width * height * 3) as usize]).unwrap();
        }
    }
}

#[test]
fn wrong_sizes_are_refused() {
    let scene = Scene::default();
    let zero = render(&scene, 0, 10, &mut []);
    assert_eq!(zero, Err(PictureError::ZeroSize { width: 0, height: 10 }));
    let short = render(&scene, 10, 10, &mut [0; 299]);
    assert_eq!(short, Err(PictureError::BufferLength { expected: 300, actual: 299 }));
    let huge = render(&scene, u32::MAX, u32::MAX, &mut []);
    assert!(matches!(huge, Err(PictureError::TooLarge { .. })));
}

#[test]
fn numbers_that_cannot_be_drawn_are_named_and_nothing_is_written() {
    let mut drones = [drone_at([0.0; 3], BLUE), drone_at([0.0; 3], BLUE)];
    drones[1].pitch_rad = f32::NAN;
    let points = [[0.0; 3], [0.0; 3], [0.0, f32::INFINITY, 0.0]];
    let flat = [Marker { side_m: 0.0, ..Marker::default() }];
    let cases = [
        (Scene { drones: &drones, ..Scene::default() }, "drone attitude", 1),
        (Scene { trails_m: &[&points], ..Scene::default() }, "trail", 2),
        (Scene { path_m: &points, ..Scene::default() }, "reference path", 2),
        (Scene { setpoints_m: &[points[2]], ..Scene::default() }, "setpoint", 0),
        (Scene { fix_m: Some([0.0, 0.0, 1e5]), ..Scene::default() }, "camera fix", 0),
        (Scene { markers: &flat, ..Scene::default() }, "marker side", 0),
        (Scene { camera_fov_rad: Some(4.0), ..Scene::default() }, "camera angle of view", 0),
    ];
    for (scene, name, element) in cases {
        let mut rgb = vec![7; 300];
        let error = render(&scene, 10, 10, &mut rgb).unwrap_err();
        let (PictureError::NonFinite { what, index } | PictureError::OutOfRange { what, index, .. }) = error
        else {
            panic!("{error}");
        };
        assert_eq!((what.as_str(), index), (name, element));
        assert!(rgb.iter().all(|byte| *byte == 7));
    }
}
