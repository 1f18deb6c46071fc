//! Writes sample pictures to a folder: `cargo run --release --example gallery -- FOLDER`.
//!
//! The flights are formulas that look like the thesis's experiments, not simulations.

use std::error::Error;
use std::f32::consts::TAU;
use std::f64::consts::TAU as TAU64;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use crazyflie_picture::{
    Band, Drone, HLine, Marker, PALETTE, Panel, Path3, Scene, Series, Style, ansi, chart, path3d, render,
};

const MARKERS: [Marker; 1] = [Marker { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0, side_m: 0.197 }];

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).map(PathBuf::from).ok_or("usage: gallery FOLDER")?;
    fs::create_dir_all(&folder)?;
    scenes(&folder)?;
    fs::write(folder.join("step.svg"), step_response()?)?;
    fs::write(folder.join("noise.svg"), long_series()?)?;
    fs::write(folder.join("path3d.svg"), trajectory()?)?;
    Ok(())
}

fn drone(pos_m: [f32; 3], roll_rad: f32, pitch_rad: f32, color: usize) -> Drone {
    Drone { pos_m, roll_rad, pitch_rad, yaw_rad: 0.0, color: PALETTE[color] }
}

fn scenes(folder: &Path) -> Result<(), Box<dyn Error>> {
    let approach = |t: f32| [0.8 * (-0.9 * t).exp() * (1.9 * t).cos(), 0.05 * (2.3 * t).sin(), 0.7];
    let trail: Vec<[f32; 3]> = (0..=130).map(|i| approach(i as f32 * 0.02)).collect();
    let flying = [drone(trail[130], 0.06, -0.17, 0)];
    let view = Scene {
        drones: &flying,
        trails_m: &[&trail],
        setpoints_m: &[[0.0, 0.0, 0.7]],
        markers: &MARKERS,
        fix_m: Some([-0.02, 0.08, 0.72]),
        camera_fov_rad: Some(120.0_f32.to_radians()),
        ..Scene::default()
    };
    let start = [drone([0.8, 0.0, 0.7], 0.0, -0.17, 0)];
    let ring = |i: usize| {
        let (y, x) = (i as f32 / 80.0 * TAU).sin_cos();
        [0.8 * x, 0.8 * y, 0.7 + 0.2 * x]
    };
    let path: Vec<[f32; 3]> = (0..=80).map(ring).collect();
    let pair = [drone(path[4], -0.2, 0.0, 0), drone(path[46], 0.2, 0.0, 6)];
    let hovering = [drone([0.0, 0.0, 0.7], 0.0, 0.0, 0)];
    let landed = [drone([0.0, 0.0, 0.03], 0.0, 0.0, 0)];
    let plain = Scene { markers: &MARKERS, ..Scene::default() };
    save(folder, "approach", &view, (480, 360))?;
    save(folder, "approach_large", &view, (1200, 900))?;
    save(folder, "start", &Scene { drones: &start, trails_m: &[], fix_m: None, ..view }, (480, 360))?;
    save(
        folder,
        "pair",
        &Scene { drones: &pair, path_m: &path, trails_m: &[&path[..5]], ..plain },
        (640, 400),
    )?;
    save(folder, "hover", &Scene { drones: &hovering, ..plain }, (480, 360))?;
    save(folder, "ground", &Scene { drones: &landed, ..plain }, (480, 360))?;
    save(folder, "small", &view, (96, 96))
}

/// Renders, times, and writes a PNG and a terminal text.
fn save(folder: &Path, name: &str, scene: &Scene, (width, height): (u32, u32)) -> Result<(), Box<dyn Error>> {
    let mut rgb = vec![0; width as usize * height as usize * 3];
    let (frames, clock) = (100, Instant::now());
    for _ in 0..frames {
        render(scene, width, height, &mut rgb)?;
    }
    let each = clock.elapsed().as_secs_f64() * 1e3 / f64::from(frames);
    println!("{name}: {width} x {height} in {each:.2} ms");
    let rgba = rgb.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect();
    let size = tiny_skia::IntSize::from_wh(width, height).ok_or("no size")?;
    let picture = tiny_skia::Pixmap::from_vec(rgba, size).ok_or("no picture")?;
    picture.save_png(folder.join(format!("{name}.png")))?;
    let text = ansi(&rgb, width as usize, height as usize, 80)?;
    Ok(fs::write(folder.join(format!("{name}.ansi")), text)?)
}

fn step_response() -> Result<String, Box<dyn Error>> {
    let time: Vec<f64> = (0..400).map(|i| f64::from(i) * 0.02).collect();
    let sample = |f: &dyn Fn(f64) -> f64| time.iter().map(|t| f(*t)).collect::<Vec<f64>>();
    let old = sample(&|t| 0.8 * (-0.55 * t).exp() * (1.9 * t).cos());
    let new = sample(&|t| 0.8 * (-1.7 * t).exp() * (1.3 * t).cos());
    let pitch = sample(&|t| -10.0 * (-0.6 * t).exp() * (1.9 * t + 0.4).cos());
    let command = sample(&|t| (-10.0 * (-0.6 * t).exp() * (1.9 * t + 0.9).cos()).clamp(-7.5, 7.5));
    let height = sample(&|t| 0.7 * (1.0 - (-1.6 * t).exp()));
    let target = sample(&|t| if t < 0.4 { 0.0 } else { 0.7 });
    let pwm = sample(&|t| 42_000.0 + 9_000.0 * (-1.2 * t).exp() * (3.0 * t).cos());
    let camera: Vec<f64> = time.iter().step_by(12).copied().collect();
    let fixes: Vec<f64> =
        height.iter().step_by(12).enumerate().map(|(i, h)| h + 0.03 * (i as f64 * 7.0).sin()).collect();
    let line = |label, y, style, color: usize| Series { label, x: &time, y, style, color: PALETTE[color] };
    let panel =
        |title, y_label, series| Panel { title, x_label: "time (s)", y_label, series, ..Panel::default() };
    let mut panels = vec![
        panel(
            "Approach from 0.8 m",
            "x (m)",
            vec![
                line("crazyflie_ros defaults", &old, Style::Dashed, 1),
                line("thesis gains (table 7.1)", &new, Style::Solid, 0),
            ],
        ),
        panel(
            "Pitch",
            "angle (deg)",
            vec![line("command", &command, Style::Step, 1), line("measured", &pitch, Style::Solid, 0)],
        ),
        panel(
            "Take-off",
            "height (m)",
            vec![
                line("command", &target, Style::Step, 1),
                line("height", &height, Style::Solid, 0),
                Series {
                    label: "camera fixes",
                    x: &camera,
                    y: &fixes,
                    style: Style::Points,
                    color: PALETTE[3],
                },
            ],
        ),
        panel("Thrust", "PWM (counts)", vec![line("thrust", &pwm, Style::Solid, 0)]),
    ];
    panels[0].bands.push(Band { label: "over the marker", low: -0.0985, high: 0.0985, color: PALETTE[2] });
    panels[1].hlines.push(HLine { label: "limit", y: 7.5, color: PALETTE[4] });
    panels[1].hlines.push(HLine { label: "", y: -7.5, color: PALETTE[4] });
    Ok(chart(&panels, 2, "Flight to the marker and hover at 0.7 m")?)
}

fn long_series() -> Result<String, Box<dyn Error>> {
    let time: Vec<f64> = (0..100_000).map(|i| f64::from(i) * 0.01).collect();
    let noise = |t: &f64| (t * 91.7).sin() * (t * 13.3).cos() + 0.2 * (t * 0.05).sin() - 0.003;
    let rate: Vec<f64> = time.iter().map(noise).collect();
    let label = "gyro x";
    let series = vec![Series { label, x: &time, y: &rate, style: Style::Solid, color: PALETTE[0] }];
    let panel = Panel { x_label: "time (s)", y_label: "rate (rad/s)", series, ..Panel::default() };
    Ok(chart(&[panel], 1, "100 000 samples of angular rate")?)
}

fn trajectory() -> Result<String, Box<dyn Error>> {
    let turn = |i: u32| f64::from(i) / 400.0 * TAU64;
    let wanted: Vec<[f64; 3]> =
        (0..=400).map(|i| [0.8 * turn(i).sin(), 0.5 * (2.0 * turn(i)).sin(), 0.7]).collect();
    let lag = |i: u32| {
        let a = turn(i) - 0.15;
        [0.84 * a.sin(), 0.55 * (2.0 * a).sin(), 0.7 * (1.0 - (-f64::from(i) / 25.0).exp())]
    };
    let flown: Vec<[f64; 3]> = (0..=400).map(lag).collect();
    let paths = [
        Path3 { label: "reference", points_m: &wanted, style: Style::Dashed, color: PALETTE[1] },
        Path3 { label: "flown", points_m: &flown, style: Style::Solid, color: PALETTE[0] },
    ];
    Ok(path3d(&paths, "Figure of eight over the marker")?)
}
