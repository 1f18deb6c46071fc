//! The project's own CSV: what is written is read back, and what is wrong is named.

#[path = "common/flight.rs"]
mod flight;

use crazyflie_logs::{FlightLog, LogError, MissingColumn, Note, PositionSource, Truth};
use flight::{Shape, flight, shape, text};
use proptest::prelude::*;

fn read(text: &str) -> Result<FlightLog, LogError> {
    FlightLog::from_bytes("flight.csv", text.as_bytes())
}

/// Replaces a cell; line 1 is the header.
fn with_cell(text: &str, line: usize, column: &str, value: &str) -> String {
    let mut rows: Vec<Vec<&str>> = text.lines().map(|l| l.split(',').collect()).collect();
    let index = rows[0].iter().position(|name| *name == column).unwrap();
    rows[line - 1][index] = value;
    rows.iter().map(|row| row.join(",") + "\n").collect()
}

fn same(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(x, y)| x == y)
}

/// Equal to the relative 1e-12 that conversion to degrees and back may cost.
fn close(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(x, y)| (x - y).abs() <= 1e-12 * x.abs())
}

fn all_same(a: &[Vec<f64>; 3], b: &[Vec<f64>; 3]) -> bool {
    a.iter().zip(b).all(|(x, y)| same(x, y))
}

fn option<T>(a: &Option<T>, b: &Option<T>, equal: impl Fn(&T, &T) -> bool) -> bool {
    match (a, b) {
        (Some(a), Some(b)) => equal(a, b),
        (None, None) => true,
        _ => false,
    }
}

fn close_option(a: &Option<Vec<f64>>, b: &Option<Vec<f64>>) -> bool {
    option(a, b, |a, b| close(a, b))
}

fn same_truth(a: &Truth, b: &Truth) -> bool {
    all_same(&a.pos_m, &b.pos_m)
        && all_same(&a.vel_mps, &b.vel_mps)
        && close(&a.roll_rad, &b.roll_rad)
        && close(&a.pitch_rad, &b.pitch_rad)
        && close(&a.yaw_rad, &b.yaw_rad)
}

/// With another column, the same in every row.
fn with_column(text: &str, name: &str, value: &str) -> String {
    let added = |(i, line): (usize, &str)| format!("{line},{}\n", if i == 0 { name } else { value });
    text.lines().enumerate().map(added).collect()
}

#[test]
fn a_flight_of_a_real_vehicle_is_a_recording() {
    let position = |fix_every: usize, age_s: f64, revision: &str| {
        let values = (0..64).map(|i| 0.01 * f64::from(i)).collect();
        let mut log = flight(&Shape { rows: 60, values, fix_every, by_height: false, with_truth: false });
        log.fixes.capture_t_s = log.fixes.row.iter().map(|row| log.t_s[*row] - age_s).collect();
        let mut bytes = Vec::new();
        log.write_csv(&mut bytes).unwrap();
        let text = String::from_utf8(bytes).unwrap();
        let log = read(&with_column(&text, "firmware_revision", revision)).unwrap();
        assert!(!log.notes.iter().any(|note| matches!(note, Note::IgnoredColumns { .. })), "{:?}", log.notes);
        log.provenance.position
    };
    assert_eq!(position(1, 0.0, "0"), PositionSource::Camera);
    assert_eq!(position(1, 0.0, "305419896"), PositionSource::Estimate);
    assert_eq!(position(1, 0.004, "305419896"), PositionSource::MotionCapture);
    assert_eq!(position(3, 0.05, "305419896"), PositionSource::Camera);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn what_is_written_is_read_back(shape in shape()) {
        let log = flight(&shape);
        let mut bytes = Vec::new();
        log.write_csv(&mut bytes).unwrap();
        let back = FlightLog::from_bytes("back", &bytes).unwrap();
        prop_assert!(back.notes.iter().all(|n| matches!(n, Note::NeverAirborne { .. })), "{:?}", back.notes);
        prop_assert_eq!(back.provenance.format, "project_csv");
        prop_assert_eq!(&back.airborne, &log.airborne);
        prop_assert!(same(&log.t_s, &back.t_s));
        prop_assert!(close_option(&log.cmd_roll_rad, &back.cmd_roll_rad));
        prop_assert!(close_option(&log.cmd_pitch_rad, &back.cmd_pitch_rad));
        prop_assert!(close_option(&log.cmd_yaw_rate_radps, &back.cmd_yaw_rate_radps));
        prop_assert_eq!(&log.cmd_thrust_pwm, &back.cmd_thrust_pwm);
        prop_assert_eq!(&log.cmd_height_m, &back.cmd_height_m);
        prop_assert_eq!(&log.setpoint_m, &back.setpoint_m);
        prop_assert!(close_option(&log.setpoint_yaw_rad, &back.setpoint_yaw_rad));
        prop_assert_eq!(&log.fixes.row, &back.fixes.row);
        prop_assert!(same(&log.fixes.capture_t_s, &back.fixes.capture_t_s));
        prop_assert!(all_same(&log.fixes.pos_m, &back.fixes.pos_m));
        prop_assert!(close_option(&log.fixes.yaw_rad, &back.fixes.yaw_rad));
        prop_assert!(close(&log.roll_rad, &back.roll_rad) && close(&log.pitch_rad, &back.pitch_rad));
        prop_assert!(close(&log.yaw_rad, &back.yaw_rad));
        prop_assert_eq!(&log.gyro_radps, &back.gyro_radps);
        prop_assert_eq!(&log.acc_mps2, &back.acc_mps2);
        prop_assert_eq!(&log.vbat_v, &back.vbat_v);
        prop_assert!(option(&log.truth, &back.truth, same_truth));
    }
}

#[test]
fn column_order_is_free_and_unknown_columns_are_noted() {
    let text = text(true);
    let expected = read(&text).unwrap();
    let reordered: String = text
        .lines()
        .enumerate()
        .map(|(i, line)| {
            let mut cells: Vec<&str> = line.split(',').rev().collect();
            cells.insert(3, if i == 0 { "wind_guess" } else { "calm" });
            cells.join(",") + "\r\n"
        })
        .collect();
    let mut log = read(&format!("\u{feff}{reordered}")).unwrap();
    let note = Note::IgnoredColumns { columns: vec!["wind_guess".to_owned()] };
    assert!(log.notes.contains(&note));
    log.notes.retain(|n| *n != note);
    assert_eq!(log, expected);
}

#[test]
fn a_missing_column_is_named_with_what_it_may_have_been() {
    let text = text(false).replace("imu_roll_deg", "imu_rol_deg").replace("cmd_thrust_pwm", "cmd_trust_pwm");
    let error = read(&text).unwrap_err();
    let message = error.to_string();
    let LogError::MissingColumns { missing, format, .. } = error else { panic!("{message}") };
    assert_eq!(format, "a project CSV");
    let like = |name: &str, found: &str| MissingColumn {
        name: name.to_owned(),
        did_you_mean: Some(found.to_owned()),
    };
    let vertical = like("cmd_thrust_pwm or cmd_height_m", "cmd_trust_pwm");
    assert_eq!(missing, [like("imu_roll_deg", "imu_rol_deg"), vertical]);
    assert!(
        message.contains("flight.csv") && message.contains("did you mean that by \"imu_rol_deg\"?"),
        "{message}"
    );
}

#[test]
fn a_bad_value_is_named_with_file_line_column_and_expectation() {
    for (column, value) in [
        ("gyro_x_radps", "abc"),
        ("t_s", "NaN"),
        ("vbat_v", "inf"),
        ("vbat_v", ""),
        ("cmd_thrust_pwm", "4.6e6"),
    ] {
        let error = read(&with_cell(&text(true), 5, column, value)).unwrap_err();
        let message = error.to_string();
        for part in ["flight.csv", "line 5", column, value, "expected"] {
            assert!(message.contains(part), "{message} lacks {part}");
        }
        assert!(matches!(error, LogError::BadValue { line: 5, .. }), "{message}");
    }
}

#[test]
fn a_half_empty_marker_row_is_refused() {
    // Fixes are in rows 0, 3, 6, so line 5 holds one.
    let error = read(&with_cell(&text(false), 5, "marker_y_m", "")).unwrap_err();
    assert!(
        matches!(&error, LogError::BadValue { line: 5, column, .. } if column == "marker_y_m"),
        "{error}"
    );
}

#[test]
fn time_that_stands_still_or_runs_back_is_refused() {
    for value in ["0.01", "0.005"] {
        let error = read(&with_cell(&text(false), 4, "t_s", value)).unwrap_err();
        assert!(matches!(error, LogError::TimeNotIncreasing { line: 4, .. }), "{error}");
    }
}

#[test]
fn part_of_the_truth_is_refused() {
    let error = read(&text(true).replace("true_vy_mps", "true_vy")).unwrap_err();
    let LogError::MissingColumns { missing, .. } = error else { panic!("{error}") };
    assert_eq!(missing[0].did_you_mean.as_deref(), Some("true_vy"));
}

#[test]
fn odd_capture_times_are_noted() {
    let late = with_cell(&text(false), 5, "marker_t_s", "9.0");
    let log = read(&late).unwrap();
    assert!(log.notes.contains(&Note::CaptureInFuture { count: 1 }));
    assert!(log.notes.contains(&Note::CaptureOutOfOrder { count: 1 }));
}

#[test]
fn a_wrapping_yaw_is_made_continuous_and_a_gap_in_time_noted() {
    let mut turned = with_cell(&text(false), 2, "imu_yaw_deg", "179");
    for (line, yaw) in
        (3..14).zip(["-179", "-177", "-175", "-173", "-171", "-169", "-167", "-165", "-163", "-161", "-159"])
    {
        turned = with_cell(&turned, line, "imu_yaw_deg", yaw);
    }
    let log = read(&with_cell(&turned, 13, "t_s", "0.5")).unwrap();
    assert!((log.yaw_rad[11].to_degrees() - 201.0).abs() < 1e-9);
    assert!(log.notes.contains(&Note::Unwrapped { channel: "IMU yaw", jumps: 1 }));
    assert!(log.notes.iter().any(|n| matches!(n, Note::TimeGaps { count: 1, .. })));
}

#[test]
fn a_log_that_the_format_cannot_hold_is_refused() {
    let log = read(&text(true)).unwrap();
    let refused = |change: fn(&mut FlightLog)| {
        let mut log = log.clone();
        change(&mut log);
        match log.write_csv(Vec::new()) {
            Err(LogError::CannotWrite { channel, .. }) => channel,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(refused(|log| log.vbat_v = None), "vbat_v");
    assert_eq!(refused(|log| log.roll_rad[3] = f64::NAN), "imu_roll_deg");
    assert_eq!(refused(|log| log.pitch_rad.truncate(4)), "imu_pitch_deg");
    assert_eq!(refused(|log| log.fixes.row[1] = 700), "marker_x_m");
    assert!(refused(|log| log.cmd_thrust_pwm = None).contains("vertical"));
}
