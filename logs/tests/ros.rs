//! ROS messages in bags and MCAP: units, signs, clocks, and what is damaged or missing.

#[path = "common/recording.rs"]
mod recording;
#[path = "common/ros.rs"]
mod ros;

use crazyflie_logs::{FlightLog, LogError, Mapping, Note, Provenance, ReadOptions};
use proptest::prelude::*;
use recording::check;
use ros::{RIG, Rig, StoredMessage, bag, height_m, mcap, messages, pitch_rad, x_m};

fn read(bytes: &[u8]) -> Result<FlightLog, LogError> {
    FlightLog::from_bytes("flight.bag", bytes)
}

fn flown(rig: Rig) -> FlightLog {
    let log = read(&bag(&messages(rig), "none")).unwrap();
    check(&log);
    log
}

/// Between two angles or positions over the flight, at their own times.
fn furthest(t_s: &[f64], values: &[f64], truth: impl Fn(f64) -> f64) -> f64 {
    t_s.iter().zip(values).map(|(t, value)| (value - truth(*t)).abs()).fold(0.0, f64::max)
}

#[test]
fn units_signs_and_times_are_those_of_the_rig() {
    let log = flown(RIG);
    assert_eq!((log.provenance.format, log.len()), ("ros_bag", 4000));
    // The bag starts with the first command at 0; the IMU is stamped when it measures, 3 ms before it is
    // recorded.
    assert!(furthest(&log.t_s, &log.t_s, |t| (t * 100.0).round() / 100.0) < 1e-6);
    let row = log.t_s.partition_point(|t| *t < 10.005);
    let t_s = log.t_s[row];
    let held = |t: f64| (t * 50.0 + 1e-6).floor() / 50.0;
    assert!((log.cmd_pitch_rad.as_ref().unwrap()[row] - pitch_rad(held(t_s))).abs() < 1e-9);
    assert!((log.cmd_roll_rad.as_ref().unwrap()[row] + 1.5_f64.to_radians()).abs() < 1e-12);
    assert!((log.cmd_yaw_rate_radps.as_ref().unwrap()[row] - 12_f64.to_radians()).abs() < 1e-12);
    assert_eq!(log.cmd_thrust_pwm.as_ref().unwrap()[row], 38_000.0);
    // The gyro's bias was measured on the ground and taken out.
    assert!(
        log.notes.iter().any(|note| matches!(note, Note::AttitudeIntegrated { at_rest: true, .. })),
        "{:?}",
        log.notes
    );
    assert!(furthest(&log.t_s, &log.pitch_rad, pitch_rad) < 1e-3);
    assert!(furthest(&log.fixes.capture_t_s, &log.fixes.pos_m[0], x_m) < 1e-5);
    let age = log.t_s[log.fixes.row[500]] - log.fixes.capture_t_s[500];
    assert!((0.049..0.061).contains(&age), "{age}");
    assert!(log.t_s[log.airborne.start] > 2.0 && log.airborne.end == log.len());
}

#[test]
fn camera_and_imu_agree_where_their_stamps_do() {
    let log = flown(RIG);
    let lag = log.notes.iter().find_map(|note| match note {
        Note::CameraLag { lag_s, sigma_s, shifted, .. } => Some((*lag_s, *sigma_s, *shifted)),
        _ => None,
    });
    let (lag_s, sigma_s, shifted) = lag.unwrap_or_else(|| panic!("{:?}", log.notes));
    assert!(lag_s.abs() < 0.005 && sigma_s < 0.01 && !shifted, "{lag_s} +- {sigma_s}");
}

#[test]
fn an_imu_stamped_since_boot_is_brought_to_the_recorders_clock() {
    let log = flown(Rig { imu_since_boot: true, ..RIG });
    let clock = log.notes.iter().find_map(|note| match note {
        Note::TopicClock { topic, same, offset_s, .. } if topic.ends_with("imu") => Some((*same, *offset_s)),
        _ => None,
    });
    let (same, offset_s) = clock.unwrap();
    // The recorder's time at the vehicle's boot, and 3 ms of transport that nothing can tell from the clock.
    assert!(!same && (offset_s - (1.5e9 - 7.0 + 0.003)).abs() < 1e-5, "{offset_s}");
    assert!((log.t_s[0] - 0.003).abs() < 1e-5);
}

#[test]
fn a_camera_without_stamps_is_corrected_by_what_both_saw() {
    let log = flown(Rig { camera_stamps: false, camera_delay_s: 0.09, ..RIG });
    assert!(log.notes.iter().any(|note| matches!(note, Note::NoStamps { topic } if topic.contains("pose"))));
    let corrected = log.notes.iter().any(|note| matches!(note, Note::CameraLag { shifted: true, .. }));
    assert!(corrected, "{:?}", log.notes);
    let fixes = &log.fixes;
    let ages: Vec<f64> =
        fixes.row.iter().zip(&fixes.capture_t_s).map(|(row, captured)| log.t_s[*row] - captured).collect();
    let mean = ages.iter().sum::<f64>() / ages.len() as f64;
    assert!((mean - 0.095).abs() < 0.006, "{mean}");
}

#[test]
fn a_marker_seen_by_the_camera_gives_the_vehicles_position() {
    let log = flown(Rig { from_camera: true, ..RIG });
    assert!(log.notes.contains(&Note::SeenFromCamera));
    assert!(furthest(&log.fixes.capture_t_s, &log.fixes.pos_m[0], x_m) < 1e-5);
    assert!(furthest(&log.fixes.capture_t_s, &log.fixes.pos_m[2], height_m) < 1e-5);
}

#[test]
fn every_compression_and_mcap_read_alike() {
    let messages = messages(Rig { seconds: 5.0, ..RIG });
    let plain = read(&bag(&messages, "none")).unwrap();
    for packed in [bag(&messages, "lz4"), bag(&messages, "bz2"), ros::mcap(&messages, "ros1")] {
        let log = read(&packed).unwrap();
        let provenance = Provenance { format: plain.provenance.format, ..log.provenance };
        assert!(FlightLog { provenance, ..log } == plain);
    }
}

/// Sorted by time, the messages of two flights once took turns.
#[test]
fn a_clock_that_begins_anew_is_a_second_flight_in_every_recording() {
    let one = messages(RIG);
    let two: Vec<StoredMessage> = one.iter().chain(one[..one.len() / 2].iter()).cloned().collect();
    for bytes in [bag(&two, "none"), mcap(&two, "ros1")] {
        let part =
            |part| FlightLog::open_bytes("two.bag", &bytes, &ReadOptions { part, ..Default::default() });
        let (first, second) = (part(None).unwrap(), part(Some(2)).unwrap());
        assert_eq!(first.t_s, flown(RIG).t_s);
        assert_eq!(second.t_s[..], first.t_s[..second.len()]);
        assert!((second.len() as f64 / first.len() as f64 - 0.5).abs() < 0.02, "{} rows", second.len());
        assert!(second.notes.contains(&Note::Flights { count: 2, read: 2 }), "{:?}", second.notes);
        assert!(matches!(part(Some(3)), Err(LogError::NoSuchFlight { wanted: 3, count: 2, .. })));
    }
}

#[test]
fn a_part_of_a_file_with_one_flight_is_refused_in_every_format() {
    let options = ReadOptions { part: Some(2), ..Default::default() };
    for bytes in [bag(&messages(RIG), "none"), recording::hop()] {
        let refused = FlightLog::open_bytes("one", &bytes, &options);
        assert!(matches!(refused, Err(LogError::NoSuchFlight { wanted: 2, count: 1, .. })), "{refused:?}");
    }
}

#[test]
fn lost_late_and_repeated_messages_are_noted() {
    let mut messages = messages(Rig { seconds: 10.0, ..RIG });
    let imu: Vec<usize> = (0..messages.len()).filter(|at| messages[*at].topic.ends_with("imu")).collect();
    messages[imu[500]].data = messages[imu[499]].data.clone();
    let gone: Vec<u64> = imu[600..620].iter().map(|at| messages[*at].recorded_ns).collect();
    messages.retain(|message| !(message.topic.ends_with("imu") && gone.contains(&message.recorded_ns)));
    let log = read(&bag(&messages, "none")).unwrap();
    check(&log);
    let repeated =
        |note: &Note| matches!(note, Note::StampsOutOfOrder { name, count: 1 } if name.ends_with("imu"));
    let lost =
        |note: &Note| matches!(note, Note::LostMessages { topic, count: 21, .. } if topic.ends_with("imu"));
    assert!(log.notes.iter().any(repeated) && log.notes.iter().any(lost), "{:?}", log.notes);
    assert!(
        log.notes
            .contains(&Note::IgnoredTopics { topics: vec!["/camera/image (sensor_msgs/Image)".to_owned()] })
    );
}

#[test]
fn a_flight_without_commands_or_without_imu_is_read() {
    let without = |part: &str| {
        let kept: Vec<StoredMessage> =
            messages(Rig { seconds: 5.0, ..RIG }).into_iter().filter(|m| !m.topic.ends_with(part)).collect();
        read(&bag(&kept, "none"))
    };
    let log = without("cmd_vel").unwrap();
    check(&log);
    assert!(
        log.cmd_roll_rad.is_none() && log.notes.contains(&Note::TopicMissing { topic: "crazyflie/cmd_vel" })
    );
    let log = without("imu").unwrap();
    check(&log);
    assert!(log.notes.contains(&Note::AttitudeFromMarker) && log.gyro_radps.is_none());
    let none = read(&bag(&messages(RIG)[100..101], "none")).unwrap_err();
    assert!(
        matches!(&none, LogError::MissingSignals { found, .. } if found.contains("/camera/image")),
        "{none}"
    );
}

#[test]
fn a_truncated_bag_gives_what_is_whole_and_says_so() {
    let all = messages(Rig { seconds: 10.0, ..RIG });
    for (compression, least) in [("none", all.len() - 4), ("lz4", 1500), ("bz2", 1500)] {
        let bytes = bag(&all, compression);
        let log = read(&bytes[..bytes.len() - 400]).unwrap();
        check(&log);
        let cut =
            |note: &Note| matches!(note, Note::CutShort { kept, .. } if *kept >= least && *kept < all.len());
        assert!(log.notes.iter().any(cut), "{compression}: {:?}", log.notes);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn damaged_recordings_give_an_answer(damages in prop::collection::vec(recording::damage(), 1..5), form in 0..4_usize) {
        let messages = messages(Rig { seconds: 2.5, ..RIG });
        let mut bytes = match form {
            3 => ros::mcap(&messages, "ros1"),
            _ => bag(&messages, ["none", "lz4", "bz2"][form]),
        };
        for damage in &damages {
            damage.apply(&mut bytes);
        }
        match read(&bytes) {
            Ok(log) => check(&log),
            Err(error) => prop_assert!(error.to_string().contains("flight.bag"), "{}", error),
        }
    }

    #[test]
    fn any_ros2_messages_give_an_answer(bodies in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..400), 1..8), order in 0..8_u8) {
        let stored = |(at, mut data): (usize, Vec<u8>)| {
            data.splice(0..0, [0, order, 0, 0]);
            let (topic, kind) = [("cf/imu", "sensor_msgs/msg/Imu"), ("pose", "geometry_msgs/msg/PoseStamped")][at % 2];
            StoredMessage { topic, kind, recorded_ns: at as u64, data }
        };
        let messages: Vec<StoredMessage> = bodies.into_iter().enumerate().map(stored).collect();
        if let Ok(log) = read(&ros::mcap(&messages, "cdr")) {
            check(&log);
        }
    }

    #[test]
    fn any_bytes_after_a_magic_give_an_answer(tail in prop::collection::vec(any::<u8>(), 0..1000), is_bag in any::<bool>()) {
        let magic: &[u8] = if is_bag { b"#ROSBAG V2.0\n" } else { mcap::MAGIC };
        if let Ok(log) = read(&[magic, &tail].concat()) {
            check(&log);
        }
    }
}

fn by_mapping(bytes: &[u8], mapping: &str) -> Result<FlightLog, LogError> {
    FlightLog::from_mapped_bytes("flight.bag", bytes, Mapping::parse("m.toml", mapping).unwrap())
}

fn text(words: &str) -> Vec<u8> {
    [&(words.len() as u32).to_le_bytes()[..], words.as_bytes()].concat()
}

/// The poses of the rig as transforms of these bodies, each 0.1 m above the one before.
fn transforms(bodies: &[&str]) -> Vec<StoredMessage> {
    let poses = messages(RIG).into_iter().filter(|message| message.topic == "ar_single_board/pose");
    let transform = |message: StoredMessage| {
        let (header, numbers) = message.data.split_at(message.data.len() - 56);
        let body = |(at, name): (usize, &&str)| {
            let mut numbers = numbers.to_vec();
            let z = f64::from_le_bytes(numbers[16..24].try_into().unwrap()) + 0.1 * at as f64;
            numbers[16..24].copy_from_slice(&z.to_le_bytes());
            [header.to_vec(), text(name), numbers].concat()
        };
        let all: Vec<u8> = bodies.iter().enumerate().flat_map(body).collect();
        let data = [(bodies.len() as u32).to_le_bytes().to_vec(), all].concat();
        StoredMessage { topic: "/tf", kind: "tf2_msgs/TFMessage", data, ..message }
    };
    poses.map(transform).collect()
}

#[test]
fn of_several_bodies_in_the_transforms_one_is_chosen() {
    let alone = read(&bag(&transforms(&["cf7"]), "none")).unwrap();
    check(&alone);
    assert!(furthest(&alone.fixes.capture_t_s, &alone.fixes.pos_m[2], |t| height_m(t + 0.05)) < 0.03);
    let two = bag(&transforms(&["cf7", "wand"]), "none");
    let error = read(&two).unwrap_err().to_string();
    assert!(["/tf/cf7", "/tf/wand", "body = "].iter().all(|word| error.contains(word)), "{error}");
    let highest = |body: &str| {
        let log = by_mapping(&two, &format!("body = \"{body}\"\n")).unwrap();
        log.fixes.pos_m[2].iter().copied().fold(0.0, f64::max)
    };
    assert!((highest("cf7") - 0.7).abs() < 1e-9 && (highest("wand") - 0.8).abs() < 1e-9);
    assert!(matches!(by_mapping(&two, "body = \"cf8\"\n"), Err(LogError::SeveralBodies { .. })));
}

#[test]
fn a_mapping_reads_the_topics_of_a_recording() {
    let mut all = messages(RIG);
    // a log block of a vehicle: its voltage and its thrust, by the names that the mapping gives them
    let blocks = all.iter().filter(|message| message.topic == "/cf1/crazyflie/cmd_vel").map(|message| {
        let values: Vec<u8> = [3.9_f32, 0.5].iter().flat_map(|v| v.to_le_bytes()).collect();
        let header = [vec![0; 12], text("cf1")].concat();
        let data = [header, vec![9, 0, 0, 0], 2_u32.to_le_bytes().to_vec(), values].concat();
        StoredMessage {
            topic: "/cf1/log1",
            kind: "crazyflie_interfaces/msg/LogDataGeneric",
            data,
            ..message.clone()
        }
    });
    let blocks: Vec<StoredMessage> = blocks.collect();
    all.extend(blocks);
    all.sort_by_key(|message| message.recorded_ns);
    let pose =
        |axis: &str| format!("{axis} = {{ column = \"ar_single_board/pose.pose.position.{axis}\" }}\n");
    let mapping = format!(
        "[channels]\n{}{}{}vbat = {{ column = \"/cf1/log1.values[0]\" }}\n\
         cmd_thrust = {{ column = \"/cf1/log1.values[1]\", unit = \"fraction\" }}\n\
         gyro_x = {{ column = \"/cf1/crazyflie/imu.angular_velocity.x\" }}\n\
         gyro_y = {{ column = \"/cf1/crazyflie/imu.angular_velocity.y\" }}\n\
         gyro_z = {{ column = \"/cf1/crazyflie/imu.angular_velocity.z\" }}\n",
        pose("x"),
        pose("y"),
        pose("z")
    );
    for bytes in [bag(&all, "lz4"), mcap(&all, "ros1")] {
        let log = by_mapping(&bytes, &mapping).unwrap();
        check(&log);
        assert_eq!(log.cmd_thrust_pwm.as_ref().unwrap()[100], 32_767.5);
        assert!((log.vbat_v.as_ref().unwrap()[100] - 3.9).abs() < 1e-6);
        assert!((log.gyro_radps.as_ref().unwrap()[0][100] - 0.01).abs() < 1e-12);
        assert!(furthest(&log.fixes.capture_t_s, &log.fixes.pos_m[2], height_m) < 0.06);
    }
    let error =
        by_mapping(&bag(&all, "none"), &mapping.replace("values[1]", "values[2]")).unwrap_err().to_string();
    assert!(error.contains("did you mean \"/cf1/log1.values"), "{error}");
}
