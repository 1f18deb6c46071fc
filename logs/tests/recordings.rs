//! Small recordings of other systems in the corpus, whose content is known by formula.

#[path = "common/sound.rs"]
mod sound;

use crazyflie_logs::{AttitudeSource, FlightLog, LogError, Mapping, Note, PositionSource};

fn read(file: &str) -> FlightLog {
    let path = format!("{}/../fuzz/corpus/flight_log/{file}", env!("CARGO_MANIFEST_DIR"));
    let log = FlightLog::from_bytes(file, &std::fs::read(path).unwrap()).unwrap();
    sound::check(&log);
    log
}

/// Returns the height: at rest for half a second, then rising by 1 m/s.
fn height_m(t: f64) -> f64 {
    if t < 0.5 { 0.02 } else { (0.02 + t - 0.5).min(0.6) }
}

fn furthest(t_s: &[f64], values: &[f64], expected: impl Fn(f64) -> f64) -> f64 {
    t_s.iter().zip(values).map(|(t, v)| (v - expected(*t)).abs()).fold(0.0, f64::max)
}

#[test]
fn a_ulog_is_turned_from_ned_to_z_up() {
    let log = read("ulog/hover.ulg");
    assert_eq!((log.provenance.format, log.provenance.position), ("ulog", PositionSource::Estimate));
    assert_eq!((log.len(), log.provenance.attitude), (80, AttitudeSource::Imu));
    let fixes = &log.fixes;
    assert_eq!(fixes.row.len(), 40);
    assert!(furthest(&fixes.capture_t_s, &fixes.pos_m[0], |t| 0.1 * t) < 1e-6);
    assert!(furthest(&fixes.capture_t_s, &fixes.pos_m[2], height_m) < 1e-6);
    // Nose up in FRD is a negative pitch in z-up; the set-point comes with every third row.
    assert!(furthest(&log.t_s, &log.pitch_rad, |t| -0.05 * t.sin()) < 1e-6);
    assert!(
        furthest(&log.t_s, log.cmd_pitch_rad.as_ref().unwrap(), |t| -0.05 * t.sin()) < 0.05 * 0.04 + 1e-6
    );
    let thrust = log.cmd_thrust_pwm.as_ref().unwrap();
    assert!(thrust.iter().all(|pwm| (pwm - 0.6 * 65_535.0).abs() < 0.01), "{}", thrust[0]);
    assert!((log.vbat_v.as_ref().unwrap()[5] - 3.9).abs() < 1e-6);
    let cut = read("ulog/cut.ulg");
    assert!(cut.len() < log.len() && cut.notes.iter().any(|note| matches!(note, Note::CutShort { .. })));
}

#[test]
fn a_ulog_whose_format_names_itself_is_no_flight() {
    let bytes =
        std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../fuzz/corpus/flight_log/ulog/self-nested.ulg"))
            .unwrap();
    let error = FlightLog::from_bytes("x.ulg", &bytes).unwrap_err();
    assert!(matches!(error, LogError::MissingSignals { .. }), "{error}");
}

#[test]
fn a_ros2_bag_in_sqlite_reads_as_an_mcap_of_the_same_messages_does() {
    let log = read("ros2_bag/cf.db3");
    assert_eq!((log.provenance.format, log.provenance.position), ("ros2_bag", PositionSource::Camera));
    assert_eq!((log.len(), log.fixes.row.len()), (80, 40));
    assert!(furthest(&log.fixes.capture_t_s, &log.fixes.pos_m[0], |t| 0.1 * t) < 1e-6);
    assert!(furthest(&log.fixes.capture_t_s, &log.fixes.pos_m[2], height_m) < 1e-6);
    assert!(furthest(&log.t_s, &log.gyro_radps.as_ref().unwrap()[0], |t| 0.1 * t.cos()) < 1e-6);
    // Degrees, held for 40 ms.
    let pitch = log.cmd_pitch_rad.as_ref().unwrap();
    assert!(furthest(&log.t_s, pitch, |t| (2.0 * t.sin()).to_radians()) < 2_f64.to_radians() * 0.041);
    let odometry = read("ros2_bag/odometry.db3");
    assert!(furthest(&odometry.fixes.capture_t_s, &odometry.fixes.pos_m[2], height_m) < 1e-6);
    assert!(
        odometry
            .notes
            .iter()
            .any(|note| matches!(note, Note::IgnoredTopics { topics } if topics[0].contains("/rosout")))
    );
}

#[test]
fn a_database_that_is_no_bag_is_refused_by_name() {
    let bytes = [&b"SQLite format 3\0"[..], &[0; 500]].concat();
    let error = FlightLog::from_bytes("x.db3", &bytes).unwrap_err();
    assert!(matches!(error, LogError::BadDatabase { .. }) && error.to_string().contains("x.db3"), "{error}");
}

#[test]
fn a_mapping_reads_the_fields_of_a_ulog_and_the_variables_of_a_card() {
    let corpus = concat!(env!("CARGO_MANIFEST_DIR"), "/../fuzz/corpus/flight_log/");
    let read = |file: &str, mapping: &str| {
        let bytes = std::fs::read(format!("{corpus}{file}")).unwrap();
        FlightLog::from_mapped_bytes(file, &bytes, Mapping::parse("m.toml", mapping).unwrap())
    };
    let channels = |columns: [&str; 4], unit: &str| {
        let [x, y, z, vbat] = columns;
        format!(
            "[channels]\nx = {{ column = \"{x}\", unit = \"{unit}\" }}\ny = {{ column = \"{y}\", unit = \"{unit}\" }}\n\
             z = {{ column = \"{z}\", unit = \"{unit}\" }}\nvbat = {{ column = \"{vbat}\" }}\n"
        )
    };
    let topic = |field: &str| format!("vehicle_local_position.{field}");
    let [x, y, z] = ["x", "y", "z"].map(topic);
    let ulog = format!("frame = \"ned\"\n{}", channels([&x, &y, &z, "battery_status.voltage_v"], "m"));
    let (mapped, own) = (read("ulog/hover.ulg", &ulog).unwrap(), crate::read("ulog/hover.ulg"));
    let top = |log: &FlightLog| log.fixes.pos_m[2].iter().copied().fold(f64::MIN, f64::max);
    assert!((top(&mapped) - top(&own)).abs() < 1e-9 && mapped.vbat_v.is_some());
    let error = read("ulog/hover.ulg", &ulog.replace("voltage_v", "voltage")).unwrap_err().to_string();
    assert!(error.contains("battery_status.voltage\"") && error.contains("did you mean"), "{error}");
    let own = crate::read("micro_sd/hop");
    let card = channels(["stateEstimate.x", "stateEstimate.y", "stateEstimate.z", ""], "m");
    let (card, _) = card.split_once("vbat").unwrap();
    assert!((top(&read("micro_sd/hop", card).unwrap()) - top(&own)).abs() < 1e-9);
}
