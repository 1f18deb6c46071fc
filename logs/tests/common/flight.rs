//! Made-up flights in the project's own format.
#![allow(dead_code)] // each test file uses its own part

use crazyflie_logs::{AttitudeSource, Fixes, FlightLog, PositionSource, Provenance, Truth};
use proptest::prelude::*;

/// Parameters of a made-up flight.
#[derive(Debug, Clone)]
pub struct Shape {
    pub rows: usize,
    pub values: Vec<f64>,
    pub fix_every: usize,
    pub by_height: bool,
    pub with_truth: bool,
}

pub fn shape() -> impl Strategy<Value = Shape> {
    let value = -1.5..1.5_f64;
    (2..40_usize, prop::collection::vec(value, 64), 1..5_usize, any::<bool>(), any::<bool>()).prop_map(
        |(rows, values, fix_every, by_height, with_truth)| Shape {
            rows,
            values,
            fix_every,
            by_height,
            with_truth,
        },
    )
}

/// A flight whose every channel is another slice of the shape's values; yaws stay within 90 degrees, so none
/// wraps.
pub fn flight(shape: &Shape) -> FlightLog {
    let rows = shape.rows;
    let mut channel = 0;
    let mut next = |count: usize| -> Vec<f64> {
        channel += 7;
        (0..count).map(|i| shape.values[(channel + i * 3) % shape.values.len()]).collect()
    };
    let fix_rows: Vec<usize> = (0..rows).step_by(shape.fix_every).collect();
    let fixes = fix_rows.len();
    let mut xyz = |count: usize| [next(count), next(count), next(count)];
    let t_s: Vec<f64> = (0..rows).map(|i| i as f64 * 0.01).collect();
    let [roll_rad, pitch_rad, yaw_rad] = xyz(rows);
    let [true_roll, true_pitch, true_yaw] = xyz(rows);
    let [cmd_roll, cmd_pitch, cmd_yaw_rate] = xyz(rows);
    let [vbat, setpoint_yaw, height] = xyz(rows);
    let mut log = FlightLog {
        provenance: Provenance {
            format: "project_csv",
            position: PositionSource::Camera,
            attitude: AttitudeSource::Imu,
            onboard_interpolated: false,
        },
        airborne: 0..0,
        cmd_roll_rad: Some(cmd_roll),
        cmd_pitch_rad: Some(cmd_pitch),
        cmd_yaw_rate_radps: Some(cmd_yaw_rate),
        cmd_thrust_pwm: (!shape.by_height).then(|| height.iter().map(|h| 30_000.0 + 10_000.0 * h).collect()),
        cmd_height_m: shape.by_height.then_some(height),
        setpoint_m: Some(xyz(rows)),
        setpoint_yaw_rad: Some(setpoint_yaw),
        fixes: Fixes {
            capture_t_s: fix_rows.iter().map(|row| t_s[*row] - 0.05).collect(),
            row: fix_rows,
            pos_m: xyz(fixes),
            yaw_rad: Some(xyz(fixes)[0].clone()),
        },
        vel_mps: None,
        roll_rad,
        pitch_rad,
        yaw_rad,
        gyro_radps: Some(xyz(rows)),
        acc_mps2: Some(xyz(rows)),
        vbat_v: Some(vbat),
        onboard: None,
        truth: shape.with_truth.then(|| Truth {
            pos_m: xyz(rows),
            vel_mps: xyz(rows),
            roll_rad: true_roll,
            pitch_rad: true_pitch,
            yaw_rad: true_yaw,
        }),
        t_s,
        notes: Vec::new(),
    };
    log.airborne = log.interval_above(0.05);
    log
}

/// A small flight as text.
pub fn text(with_truth: bool) -> String {
    let values = (0..64).map(|i| (f64::from(i) * 0.7).sin()).collect();
    let log = flight(&Shape { rows: 12, values, fix_every: 3, by_height: false, with_truth });
    let mut bytes = Vec::new();
    log.write_csv(&mut bytes).unwrap();
    String::from_utf8(bytes).unwrap()
}
