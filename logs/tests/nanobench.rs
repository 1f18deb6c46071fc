//! Tests of the reader on the 18 NanoBench recordings.

mod common;

use std::io::Write;
use std::path::Path;
use std::sync::OnceLock;

use common::{correlation, data, derivative, piece, slope};
use crazyflie_logs::{FlightLog, LogError, Note};

const FILES: [&str; 18] = [
    "B10_lissajous_fast_rep1",
    "B2_circle_fast_rep2",
    "B2_circle_medium_rep2",
    "B2_circle_slow_rep2",
    "B3_figure8_fast_rep1",
    "B3_figure8_medium_rep2",
    "B3_figure8_slow_rep1",
    "B5_helix_medium_rep1",
    "B6_linear_ramp_rep2",
    "B7_oval_fast_rep2",
    "B7_oval_fast_rep3",
    "B8_star_fast_rep1",
    "B8_star_medium_rep1",
    "B8_star_slow_rep1",
    "B9_trefoil_fast_rep14",
    "B9_trefoil_medium_rep10",
    "B9_trefoil_slow_rep12",
    "B9_trefoil_slow_rep15",
];
/// In these two the controller's packets never arrived: all four columns are constant from the first row to the last.
const NO_COMMANDS: [&str; 2] = ["B9_trefoil_medium_rep10", "B9_trefoil_slow_rep12"];

fn path(folder: &Path, name: &str) -> std::path::PathBuf {
    folder.join(format!("{name}.csv.gz"))
}

/// All files, read once.
static LOGS: OnceLock<Vec<FlightLog>> = OnceLock::new();

fn each(mut check: impl FnMut(&str, &FlightLog)) {
    let folder = data("nanobench");
    let logs = LOGS
        .get_or_init(|| FILES.iter().map(|name| FlightLog::read(&path(&folder, name)).unwrap()).collect());
    for (name, log) in FILES.into_iter().zip(logs) {
        check(name, log);
    }
}

#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn every_file_ends_at_its_last_packet() {
    each(|name, log| {
        assert_eq!(log.provenance.format, "nanobench_csv");
        let cut = log.notes.iter().find_map(|n| match n {
            Note::CutAfterLastPacket { kept_s, cut_s, .. } => Some((*kept_s, *cut_s)),
            _ => None,
        });
        // Measured with an independent script: every file loses its last 0.2 to 0.45 s.
        let (kept_s, cut_s) = cut.unwrap_or_else(|| panic!("{name}: nothing cut"));
        assert!((0.15..0.5).contains(&cut_s), "{name}: cut {cut_s}");
        assert_eq!(log.t_s[log.len() - 1], kept_s);
        assert_eq!(log.fixes.row.len(), log.len());
        assert_eq!(log.fixes.capture_t_s, log.t_s);
        let motors = log.onboard.as_ref().unwrap().motor_pwm.as_ref().unwrap();
        for pwm in motors.iter().chain(log.cmd_thrust_pwm.as_ref()) {
            assert_eq!(pwm.len(), log.len());
            assert!(pwm.iter().all(|v| (0.0..=65535.0).contains(v)), "{name}");
        }
        let vbat = log.vbat_v.as_ref().unwrap();
        assert!(vbat.iter().all(|v| (2.8..4.3).contains(v)), "{name}: battery");
    });
}

#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn dead_command_channels_are_absent_not_zero() {
    each(|name, log| {
        let dead = log.notes.iter().any(|n| matches!(n, Note::DeadChannels { .. }));
        assert_eq!(dead, NO_COMMANDS.contains(&name), "{name}");
        assert_eq!(log.cmd_pitch_rad.is_none(), dead, "{name}");
        assert_eq!(log.cmd_thrust_pwm.is_none(), dead, "{name}");
        assert!(log.cmd_yaw_rate_radps.is_none());
        assert!(log.setpoint_m.is_some() && log.gyro_radps.is_some(), "{name}");
    });
}

#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn the_airborne_interval_lies_between_take_off_and_landing() {
    each(|name, log| {
        let rows = log.airborne.clone();
        let z = &log.fixes.pos_m[2];
        // All but a bounce on landing, which is bridged.
        // 5 cm above where this flight's vehicle stood: markers stand at another height in each session
        let least_m = log.resting_height_m().unwrap() + 0.05;
        let low = z[rows.clone()].iter().filter(|z| **z <= least_m).count();
        assert!(low < 50, "{name}: {low} rows below {least_m} m");
        assert!(z[rows.start - 1] <= least_m && z[rows.end] <= least_m, "{name}");
        // Motors start at about 2 s in every file and the vehicle lands 3 s before the end.
        let (start_s, end_s) = (log.t_s[rows.start], log.t_s[rows.end - 1]);
        assert!((2.5..3.6).contains(&start_s), "{name}: take-off at {start_s}");
        assert!(log.t_s[log.len() - 1] - end_s > 2.0, "{name}: landing at {end_s}");
        assert!(end_s - start_s > 19.0, "{name}: flew {} s", end_s - start_s);
        let high = log.interval_above(0.3);
        assert!(rows.start < high.start && high.end < rows.end, "{name}");
    });
}

#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn commands_and_tilt_have_right_handed_signs() {
    each(|name, log| {
        let rows = log.interval_above(0.3);
        let part = |x: &[f64]| x[rows.clone()].to_vec();
        let (roll, pitch, yaw) = (part(&log.roll_rad), part(&log.pitch_rad), part(&log.yaw_rad));
        if let (Some(cmd_roll), Some(cmd_pitch)) = (&log.cmd_roll_rad, &log.cmd_pitch_rad) {
            // The vertical ramp B6 hardly tilts: 0.32 and 0.61 there, 0.7 or more in the others.
            assert!(correlation(&part(cmd_pitch), &pitch) > 0.5, "{name}: pitch");
            assert!(correlation(&part(cmd_roll), &roll) > 0.25, "{name}: roll");
        }
        let onboard = log.onboard.as_ref().unwrap().attitude_rad.as_ref().unwrap();
        assert!(correlation(&part(&onboard[0]), &roll) > 0.6, "{name}: onboard roll");
        assert!(correlation(&part(&onboard[1]), &pitch) > 0.6, "{name}: onboard pitch");
        // Acceleration over 0.14 s, turned by yaw into the vehicle's heading.
        let reach = 7;
        let t = part(&log.t_s);
        let velocity = log.vel_mps.as_ref().unwrap();
        let (ax, ay) =
            (derivative(&t, &part(&velocity[0]), reach), derivative(&t, &part(&velocity[1]), reach));
        let inner = reach..t.len() - reach;
        let yaw = &yaw[inner.clone()];
        let turned = || ax.iter().zip(&ay).zip(yaw);
        let ahead: Vec<f64> = turned().map(|((x, y), a)| a.cos() * x + a.sin() * y).collect();
        let left: Vec<f64> = turned().map(|((x, y), a)| -a.sin() * x + a.cos() * y).collect();
        assert!(correlation(&pitch[inner.clone()], &ahead) > 0.35, "{name}: +pitch to +x");
        assert!(correlation(&roll[inner.clone()], &left) < -0.8, "{name}: +roll to -y");
        if name != "B6_linear_ramp_rep2" {
            // About g per radian: the angles are radians (degrees would give 0.17).
            let gain = slope(&pitch[inner], &ahead);
            assert!((5.0..11.0).contains(&gain), "{name}: {gain} m/s2 per radian");
        }
    });
}

#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn measured_velocity_and_gyro_agree_with_position_and_attitude() {
    each(|name, log| {
        let rows = log.interval_above(0.3);
        let part = |x: &[f64]| x[rows.clone()].to_vec();
        let t = part(&log.t_s);
        let velocity = log.vel_mps.as_ref().unwrap();
        for (x, v) in log.fixes.pos_m.iter().zip(velocity) {
            let from_position = derivative(&t, &part(x), 1);
            let v = part(v);
            let off: f64 = from_position.iter().zip(&v[1..]).map(|(a, b)| (a - b).abs()).sum();
            let mean_off = off / from_position.len() as f64;
            assert!(mean_off < 0.01, "{name}: velocity off by {mean_off} m/s");
        }
        // The gyro is in rad/s: the slope is near 1 (0.017 or 57 otherwise). Weakly excited axes have less.
        let reach = 7;
        let rate = derivative(&t, &part(&log.roll_rad), reach);
        let gyro = part(&log.gyro_radps.as_ref().unwrap()[0]);
        let gain = slope(&rate, &gyro[reach..gyro.len() - reach]);
        assert!((0.5..1.3).contains(&gain), "{name}: gyro gain {gain}");
        let acc = part(&log.acc_mps2.as_ref().unwrap()[2]);
        let mean = acc.iter().sum::<f64>() / acc.len() as f64;
        assert!((9.5..10.2).contains(&mean), "{name}: mean specific force {mean}");
    });
}

#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn skew_and_yaw_are_compared_with_motion_capture() {
    each(|name, log| {
        let skew = log.notes.iter().find_map(|n| match n {
            Note::ClockSkew { median_s, lowest_s, highest_s } => Some((*median_s, *lowest_s, *highest_s)),
            _ => None,
        });
        let (median_s, lowest_s, highest_s) = skew.unwrap_or_else(|| panic!("{name}: no skew"));
        assert!(lowest_s <= median_s && median_s <= highest_s);
        // Tens of milliseconds, and it wanders: 79 ms in one third of B9_trefoil_slow_rep12.
        assert!(median_s.abs() < 0.03, "{name}: {median_s}");
        assert!(lowest_s > -0.1 && highest_s < 0.1, "{name}: {lowest_s} to {highest_s}");
        let yaw = log.notes.iter().find_map(|n| match n {
            Note::YawOffset { median_rad } => Some(*median_rad),
            _ => None,
        });
        assert!(yaw.unwrap().abs() < 0.02, "{name}");
        let cut = log.notes.iter().find_map(|n| match n {
            Note::CutAfterLastPacket { cut_s, .. } => Some(*cut_s),
            _ => None,
        });
        println!(
            "{name:24} kept {:6.2} s  cut {:4.2} s  airborne {:5.2} to {:5.2} s  skew {:4.0} ({:4.0} to {:4.0}) ms  commands {}",
            log.t_s[log.len() - 1],
            cut.unwrap_or(0.0),
            log.t_s[log.airborne.start],
            log.t_s[log.airborne.end - 1],
            median_s * 1e3,
            lowest_s * 1e3,
            highest_s * 1e3,
            if log.cmd_pitch_rad.is_some() { "yes" } else { "none" },
        );
        for note in &log.notes {
            println!("    {note}");
        }
    });
}

/// Traps in the columns' names: one is the yaw setpoint, the other its rate, both with the sign of the
/// measured yaw.
#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn the_yaw_setpoint_and_its_rate_belong_together() {
    each(|name, log| {
        let rate = log.onboard.as_ref().unwrap().setpoint_yaw_rate_radps.as_ref().unwrap();
        let Some(yaw) = &log.setpoint_yaw_rad else {
            assert!(NO_COMMANDS.contains(&name), "{name}");
            return;
        };
        // On the ground the setpoint is the estimated yaw, so it shows the sign.
        let estimate = &log.onboard.as_ref().unwrap().attitude_rad.as_ref().unwrap()[2];
        assert!((yaw[100] - estimate[100]).abs() < 0.005, "{name}");
        // Take-off turns to 0 within 2 s of the start at about 2 s: the rate integrates to what the setpoint
        // turned.
        let (start, end) = (190, 430);
        let turned = yaw[end] - yaw[start];
        let integral: f64 = (start..end).map(|i| rate[i] * (log.t_s[i + 1] - log.t_s[i])).sum();
        if turned.abs() > 0.005 {
            let ratio = integral / turned;
            assert!((0.8..1.2).contains(&ratio), "{name}: {ratio}");
        }
    });
}

/// A group of packets that stops in flight, extrapolated far beyond any range, ends the log there.
#[test]
#[ignore = "needs ../shared/data: make recorded"]
fn packets_lost_in_flight_cut_the_log_there() {
    let folder = data("nanobench");
    let bytes = std::fs::read(path(&folder, "B2_circle_fast_rep2")).unwrap();
    let mut text = String::new();
    std::io::Read::read_to_string(&mut flate2::read::GzDecoder::new(&bytes[..]), &mut text).unwrap();
    let mut rows: Vec<Vec<String>> =
        text.lines().map(|l| l.split(',').map(str::to_owned).collect()).collect();
    let last = 1 + 1500;
    for column in 0..rows[0].len() {
        if !rows[0][column].starts_with("pid_controller") {
            continue;
        }
        let number = |row: &Vec<String>, at: usize| row[at].parse::<f64>().unwrap();
        let (t1, t0) = (number(&rows[last], 0), number(&rows[last - 1], 0));
        let (x1, x0) = (number(&rows[last], column), number(&rows[last - 1], column));
        for row in rows.iter_mut().skip(last + 1) {
            let t = number(row, 0);
            row[column] = format!("{:.9}", x1 + (x1 - x0) / (t1 - t0) * (t - t1));
        }
    }
    let mut changed = Vec::new();
    for row in &rows {
        writeln!(changed, "{}", row.join(",")).unwrap();
    }
    let log = FlightLog::from_bytes("extrapolated", &changed).unwrap();
    // The straight line starts one row before the last real one.
    assert_eq!(log.len(), 1500);
    assert!(log.cmd_thrust_pwm.as_ref().unwrap().iter().all(|v| (0.0..=65535.0).contains(v)));
    assert_eq!(log.airborne.end, log.len());
}

#[test]
fn a_motion_capture_angle_in_degrees_is_refused() {
    let bytes = std::fs::read(piece("nanobench_start.csv.gz")).unwrap();
    let mut text = String::new();
    std::io::Read::read_to_string(&mut flate2::read::GzDecoder::new(&bytes[..]), &mut text).unwrap();
    let mut rows: Vec<Vec<String>> =
        text.lines().take(50).map(|l| l.split(',').map(str::to_owned).collect()).collect();
    rows[7][8] = "-12.5".to_owned();
    let text: Vec<String> = rows.iter().map(|r| r.join(",") + "\n").collect();
    match FlightLog::from_bytes("degrees", text.concat().as_bytes()) {
        Err(LogError::BadValue { line: 8, column, .. }) => assert_eq!(column, "roll"),
        other => panic!("{other:?}"),
    }
}
