//! CSVs of other labs: firmware variables, and anything by a mapping, drafted or written.

#[path = "common/sound.rs"]
mod sound;

use std::fmt::Write;

use crazyflie_logs::draft::Draft;
use crazyflie_logs::inspect::{Inspection, SignVerdict};
use crazyflie_logs::{AttitudeSource, FlightLog, LogError, Mapping, Note, PositionSource};

/// A flight of 12 s: at rest for 1 s, it rises to 0.8 m and sways in x and y, tilted by its acceleration.
struct Sway {
    x_m: f64,
    y_m: f64,
    z_m: f64,
    roll_rad: f64,
    pitch_rad: f64,
    roll_rate_radps: f64,
    pitch_rate_radps: f64,
}

const G_MPS2: f64 = 9.80665;

fn sway(t: f64) -> Sway {
    let flies = if t > 2.5 { 1.0 } else { 0.0 };
    let (w, s) = (2.4, t - 2.5);
    let (sin, cos) = (w * s).sin_cos();
    let amplitude = 0.3 * flies;
    Sway {
        x_m: amplitude * (1.0 - cos),
        y_m: amplitude * sin * 0.7,
        z_m: 0.03 + 0.8 * ((t - 1.0) / 1.5).clamp(0.0, 1.0),
        pitch_rad: amplitude * w * w * cos / G_MPS2,
        roll_rad: amplitude * 0.7 * w * w * sin / G_MPS2,
        pitch_rate_radps: -amplitude * w * w * w * sin / G_MPS2,
        roll_rate_radps: amplitude * 0.7 * w * w * w * cos / G_MPS2,
    }
}

fn thrust(t: f64) -> f64 {
    if t < 0.8 { 0.0 } else { 40_000.0 }
}

fn times() -> impl Iterator<Item = f64> {
    (0..1200).map(|i| f64::from(i) * 0.01)
}

/// The log of cfclient: milliseconds, degrees, pitch inverted.
fn cfclient(separator: char, decimal: char) -> String {
    let header = [
        "Timestamp",
        "stateEstimate.x",
        "stateEstimate.y",
        "stateEstimate.z",
        "stabilizer.roll",
        "stabilizer.pitch",
        "stabilizer.yaw",
        "controller.roll",
        "controller.pitch",
        "controller.cmd_thrust",
        "pm.vbat",
    ];
    let mut text = header.join(&separator.to_string()) + "\n";
    for t in times() {
        let s = sway(t);
        let (roll, pitch) = (s.roll_rad.to_degrees(), -s.pitch_rad.to_degrees());
        let cells = [
            123_000.0 + (t * 1000.0).round(),
            s.x_m,
            s.y_m,
            s.z_m,
            roll,
            pitch,
            0.0,
            roll,
            pitch,
            thrust(t),
            3.9,
        ];
        let cells: Vec<String> =
            cells.iter().map(|v| v.to_string().replace('.', &decimal.to_string())).collect();
        text += &(cells.join(&separator.to_string()) + "\n");
    }
    text
}

fn close(a: &[f64], b: impl Iterator<Item = f64>, within: f64) {
    assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < within));
}

fn read(text: &str) -> FlightLog {
    let log = FlightLog::from_bytes("flight.csv", text.as_bytes()).unwrap();
    sound::check(&log);
    log
}

#[test]
fn firmware_variables_become_a_right_handed_flight() {
    let log = read(&cfclient(',', '.'));
    assert_eq!((log.provenance.format, log.provenance.position), ("firmware_csv", PositionSource::Estimate));
    assert!(log.len() == 1200 && (log.t_s[1] - 0.01).abs() < 1e-9);
    close(&log.pitch_rad, times().map(|t| sway(t).pitch_rad), 1e-12);
    close(log.cmd_pitch_rad.as_ref().unwrap(), times().map(|t| sway(t).pitch_rad), 1e-12);
    close(&log.roll_rad, times().map(|t| sway(t).roll_rad), 1e-12);
    close(log.cmd_thrust_pwm.as_ref().unwrap(), times().map(thrust), 1e-12);
    assert!(Inspection::from_log(&log).signs.iter().all(|check| check.verdict != SignVerdict::Contradicts));
}

#[test]
fn decimal_commas_and_other_separators_read_alike() {
    let expected = read(&cfclient(',', '.'));
    for (separator, decimal) in [(';', ','), ('\t', ','), (';', '.')] {
        let mut log = read(&cfclient(separator, decimal));
        assert_eq!(log.notes.contains(&Note::DecimalCommas), decimal == ',');
        log.notes.retain(|note| *note != Note::DecimalCommas);
        assert!(log == expected, "{separator:?} {decimal:?}");
    }
    let two_commas = cfclient(';', ',').replacen("3,9\n", "3,9,1\n", 1);
    let error = FlightLog::from_bytes("flight.csv", two_commas.as_bytes()).unwrap_err();
    assert!(matches!(&error, LogError::BadValue { line: 2, column, .. } if column == "pm.vbat"), "{error}");
}

/// Packets of two log blocks in turn, as a script with cflib writes them: each has its own times.
#[test]
fn packets_of_several_blocks_are_brought_to_one_clock() {
    let mut text =
        "timestamp_ms,stateEstimate_x,stateEstimate_y,stateEstimate_z,stabilizer.roll,stabilizer.pitch,stabilizer.yaw\n".to_owned();
    for t in times() {
        let (s, later) = (sway(t), sway(t + 0.004));
        let ms = (t * 1000.0).round();
        let _ = writeln!(text, "{ms},,,,{},{},0", s.roll_rad.to_degrees(), -s.pitch_rad.to_degrees());
        if (ms / 10.0) as i64 % 2 == 0 {
            let _ = writeln!(text, "{},{},{},{},,,", ms + 4.0, later.x_m, later.y_m, later.z_m);
        }
    }
    let log = read(&text);
    assert_eq!(log.len(), 1200);
    assert!(
        log.notes.iter().any(|note| matches!(note, Note::Resampled { channels } if channels.len() == 3)),
        "{:?}",
        log.notes
    );
    // Interpolated over 20 ms: the curvature of 1.7 m/s2 leaves 0.1 mm.
    let tail = 300..1190;
    close(&log.fixes.pos_m[0][tail.clone()], times().skip(300).map(|t| sway(t).x_m), 2e-4);
}

const MAPPING: &str = r#"
frame = "ned"
[time]
column = "stamp"
unit = "us"
[channels]
x = { column = "north", unit = "mm" }
y = { column = "east", unit = "mm" }
z = { column = "down", unit = "mm" }
cmd_roll = { column = "u1", unit = "deg" }
cmd_pitch = { column = "u2", unit = "deg" }
cmd_thrust = { column = "u3", unit = "percent" }
"#;

/// Returns the smallest mapping: time, position in NED, and the input of the model.
fn unknown() -> String {
    let mut text = "stamp,north,east,down,u1,u2,u3,phi,theta\n".to_owned();
    for t in times() {
        let s = sway(t);
        let [roll, pitch] = [s.roll_rad, -s.pitch_rad].map(f64::to_degrees);
        let [x, y, z] = [s.x_m, -s.y_m, -s.z_m].map(|v| v * 1000.0);
        let percent = thrust(t) / 655.35;
        let _ = writeln!(text, "{},{x},{y},{z},{roll},{pitch},{percent},{roll},{pitch}", (t * 1e6).round());
    }
    text
}

/// The text with another value in a column of its first row.
fn with_cell(text: &str, column: usize, value: &str) -> String {
    let mut lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    lines[1][column] = value;
    lines.into_iter().map(|cells| cells.join(",") + "\n").collect()
}

#[test]
fn a_mapping_makes_any_csv_a_flight() {
    let mapped = |mapping: &str| {
        let log = FlightLog::from_mapped_bytes(
            "lab.csv",
            unknown().as_bytes(),
            Mapping::parse("lab.toml", mapping).unwrap(),
        )
        .unwrap();
        sound::check(&log);
        log
    };
    let log = mapped(MAPPING);
    close(&log.fixes.pos_m[1], times().map(|t| sway(t).y_m), 1e-12);
    close(&log.fixes.pos_m[2], times().map(|t| sway(t).z_m), 1e-12);
    close(log.cmd_pitch_rad.as_ref().unwrap(), times().map(|t| sway(t).pitch_rad), 1e-12);
    close(log.cmd_thrust_pwm.as_ref().unwrap(), times().map(thrust), 1e-6);
    assert_eq!(
        (log.provenance.attitude, log.provenance.position),
        (AttitudeSource::Motion, PositionSource::MotionCapture)
    );
    // Derived from the position alone, over windows of 0.2 s.
    close(&log.pitch_rad[350..1150], times().skip(350).map(|t| sway(t).pitch_rad), 0.01);
    assert!((log.resting_height_m().unwrap() - 0.03).abs() < 1e-9);
    let take_off_s = log.t_s[log.airborne.start];
    assert!((take_off_s - 1.1).abs() < 0.02, "{take_off_s}");
    let measured = mapped(&format!(
        "{MAPPING}roll = {{ column = \"phi\", unit = \"deg\" }}\npitch = {{ column = \"theta\", unit = \"deg\" }}\n"
    ));
    assert_eq!(measured.provenance.attitude, AttitudeSource::Imu);
    close(&measured.pitch_rad, times().map(|t| sway(t).pitch_rad), 1e-12);
}

#[test]
fn a_log_that_begins_and_ends_in_the_air_stands_nowhere() {
    let all = unknown();
    let mut lines: Vec<&str> = all.lines().collect();
    lines.drain(1..300);
    let mapping = Mapping::parse("lab.toml", MAPPING).unwrap();
    let log = FlightLog::from_mapped_bytes("lab.csv", (lines.join("\n") + "\n").as_bytes(), mapping).unwrap();
    assert_eq!((log.resting_height_m(), log.airborne.clone()), (None, 0..log.len()));
}

#[test]
fn a_vehicle_that_hovers_still_does_not_stand() {
    // Still at its lowest for the first second, but on its motors.
    let hovers = cfclient(',', '.').replace(",0,3.9\n", ",40000,3.9\n");
    assert_eq!(read(&hovers).resting_height_m(), None);
    assert!(read(&cfclient(',', '.')).resting_height_m().is_some());
}

#[test]
fn what_a_mapping_asks_for_and_the_file_lacks_is_named() {
    let with = |mapping: &str, text: &str| {
        FlightLog::from_mapped_bytes("lab.csv", text.as_bytes(), Mapping::parse("lab.toml", mapping).unwrap())
            .unwrap_err()
            .to_string()
    };
    let message = with(&MAPPING.replace("\"north\"", "\"nort\""), &unknown());
    assert!(
        message.contains("lab.csv")
            && message.contains("\"nort\"")
            && message.contains("did you mean \"north\"?"),
        "{message}"
    );
    let message = with(MAPPING, &with_cell(&unknown(), 6, "101"));
    assert!(
        message.contains("line 2, column \"u3\"") && message.contains("101") && message.contains("0 to 100"),
        "{message}"
    );
    let message = with(MAPPING, &with_cell(&unknown(), 1, "abc"));
    assert!(message.contains("line 2, column \"north\": found \"abc\""), "{message}");
    let error = FlightLog::from_bytes("lab.csv", unknown().as_bytes()).unwrap_err();
    assert!(
        matches!(&error, LogError::UnknownFormat { .. }) && error.to_string().contains("inspect"),
        "{error}"
    );
}

/// Columns as a lab may name them, with a pitch of the wrong sign: the flight itself reveals it.
#[test]
fn a_draft_guesses_names_units_and_signs() {
    let mut text =
        "time;mocap_x;mocap_y;mocap_z;Roll [deg];Pitch [deg];gyroX;gyroY;gyroZ;roll_cmd;pitch_cmd;thrust;temperature\n".to_owned();
    for t in times() {
        let s = sway(t);
        let [roll, pitch] = [s.roll_rad, -s.pitch_rad].map(f64::to_degrees);
        let [p, q] = [s.roll_rate_radps, -s.pitch_rate_radps];
        let [x, y, z] = [s.x_m, s.y_m, s.z_m].map(|v| v * 1000.0);
        let _ = writeln!(
            text,
            "{t};{x};{y};{z};{roll};{pitch};{p};{q};0;{roll};{pitch};{};21.5",
            thrust(t) / 65_535.0
        );
    }
    let draft = Draft::from_bytes("lab.csv", text.as_bytes()).unwrap();
    println!("{}", draft.text);
    for line in [
        "column = \"time\"\nunit = \"s\"",
        "x = { column = \"mocap_x\", unit = \"mm\" }",
        "roll = { column = \"Roll [deg]\", unit = \"deg\" }",
        "pitch = { column = \"Pitch [deg]\", unit = \"deg\", sign = -1 }",
        "cmd_pitch = { column = \"pitch_cmd\", unit = \"deg\", sign = -1 }",
        "gyro_y = { column = \"gyroY\", unit = \"rad/s\", sign = -1 }",
        "cmd_thrust = { column = \"thrust\", unit = \"fraction\" }",
        "#   temperature: 21.5",
    ] {
        assert!(draft.text.contains(line), "{line} is not in\n{}", draft.text);
    }
    let log = draft.log.unwrap();
    sound::check(&log);
    close(&log.pitch_rad, times().map(|t| sway(t).pitch_rad), 1e-9);
    assert!(Inspection::from_log(&log).signs.iter().all(|check| check.verdict != SignVerdict::Contradicts));
}
