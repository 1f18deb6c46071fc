//! Logs that are what their type promises.

#![allow(dead_code)] // each test file uses its own part

use crazyflie_logs::{FlightLog, LogError, Mapping};

/// Reads a log of any format. A mapping and its CSV are in one input, a line of dashes between them.
pub fn read(bytes: &[u8]) -> Result<FlightLog, LogError> {
    let text = String::from_utf8_lossy(bytes);
    match text.split_once("\n---\n") {
        Some((mapping, csv)) => {
            FlightLog::from_mapped_bytes("log", csv.as_bytes(), Mapping::parse("log", mapping)?)
        }
        None => FlightLog::from_bytes("log", bytes),
    }
}

/// Checks conditions of every log, however odd its file was.
pub fn check(log: &FlightLog) {
    let rows = log.len();
    assert!(rows > 0 && log.airborne.end <= rows);
    assert!(log.t_s.windows(2).all(|w| w[0] < w[1]));
    let sound = |channel: &Vec<f64>| assert!(channel.len() == rows && channel.iter().all(|v| v.is_finite()));
    [&log.t_s, &log.roll_rad, &log.pitch_rad, &log.yaw_rad].into_iter().for_each(sound);
    let commands = [
        &log.cmd_roll_rad,
        &log.cmd_pitch_rad,
        &log.cmd_yaw_rate_radps,
        &log.cmd_thrust_pwm,
        &log.vbat_v,
        &log.setpoint_yaw_rad,
    ];
    commands.into_iter().flatten().for_each(sound);
    [&log.gyro_radps, &log.acc_mps2, &log.setpoint_m].into_iter().flatten().flatten().for_each(sound);
    if let Some(onboard) = &log.onboard {
        [&onboard.pos_m, &onboard.vel_mps, &onboard.attitude_rad, &onboard.acc_world_mps2]
            .into_iter()
            .flatten()
            .flatten()
            .for_each(sound);
        [&onboard.motor_pwm, &onboard.motor_request_pwm].into_iter().flatten().flatten().for_each(sound);
    }
    let fixes = &log.fixes;
    assert!(fixes.row.windows(2).all(|w| w[0] < w[1]) && fixes.row.last().is_none_or(|last| *last < rows));
    for channel in fixes.pos_m.iter().chain([&fixes.capture_t_s]).chain(&fixes.yaw_rad) {
        assert!(channel.len() == fixes.row.len() && channel.iter().all(|v| v.is_finite()));
    }
    for note in &log.notes {
        assert!(!note.to_string().is_empty(), "{note:?}");
    }
}
