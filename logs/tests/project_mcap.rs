//! The project's own MCAP: it reads back as the CSV does, to the bit.

#[path = "common/flight.rs"]
mod flight;
#[path = "common/recording.rs"]
mod recording;

use std::io::{Cursor, Seek, SeekFrom, Write};

use crazyflie_logs::{FlightLog, LogError, Note};
use flight::{Shape, flight, shape, text};
use proptest::prelude::*;
use recording::check;

fn mcap_of(log: &FlightLog) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    log.write_mcap(&mut bytes).unwrap();
    bytes.into_inner()
}

fn read(bytes: &[u8]) -> Result<FlightLog, LogError> {
    FlightLog::from_bytes("flight.mcap", bytes)
}

fn sample() -> FlightLog {
    FlightLog::from_bytes("sample", text(true).as_bytes()).unwrap()
}

/// A file with one channel of JSON rows, written as another program would.
fn foreign(rows: &[&str]) -> Vec<u8> {
    let mut writer = mcap::Writer::new(Cursor::new(Vec::new())).unwrap();
    let schema = writer.add_schema("crazyflie.FlightRow", "jsonschema", b"{}").unwrap();
    let channel_id = writer.add_channel(schema, "/anything", "json", &Default::default()).unwrap();
    for (at, row) in rows.iter().enumerate() {
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence: at as u32,
            log_time: at as u64,
            publish_time: at as u64,
        };
        writer.write_to_known_channel(&header, row.as_bytes()).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// A sink that fails.
struct Full;

impl Write for Full {
    fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
        Err(std::io::Error::other("disk full"))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Seek for Full {
    fn seek(&mut self, _: SeekFrom) -> std::io::Result<u64> {
        Ok(0)
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn mcap_and_csv_read_back_to_the_same_bits(shape in shape()) {
        let log = flight(&shape);
        let mut csv = Vec::new();
        log.write_csv(&mut csv).unwrap();
        let from_csv = FlightLog::from_bytes("flight.csv", &csv).unwrap();
        let from_mcap = read(&mcap_of(&log)).unwrap();
        prop_assert_eq!(from_mcap, from_csv);
    }

    #[test]
    fn damaged_files_give_an_answer(damages in prop::collection::vec(recording::damage(), 1..5)) {
        let mut bytes = mcap_of(&sample());
        for damage in &damages {
            damage.apply(&mut bytes);
        }
        match read(&bytes) {
            Ok(log) => check(&log),
            Err(error) => prop_assert!(error.to_string().contains("flight.mcap"), "{}", error),
        }
    }

    #[test]
    fn any_rows_give_an_answer(row in "[-{}\\[\\]\",:0-9.ea-z_]{0,60}") {
        if let Ok(log) = read(&foreign(&[&row])) {
            check(&log);
        }
    }
}

#[test]
fn a_truncated_file_gives_its_whole_messages_and_says_so() {
    let shape = Shape {
        rows: 3000,
        values: (0..640).map(|i| (f64::from(i) * 0.7).sin()).collect(),
        fix_every: 3,
        by_height: false,
        with_truth: true,
    };
    let log = flight(&shape);
    let whole = mcap_of(&log);
    let half = read(&whole[..whole.len() / 2]).unwrap();
    check(&half);
    assert!(half.len() > 500 && half.len() < 2500, "{}", half.len());
    assert_eq!(half.t_s, log.t_s[..half.len()]);
    assert!(
        half.notes.iter().any(|note| matches!(note, Note::CutShort { kept, .. } if *kept == half.len())),
        "{:?}",
        half.notes
    );
    // Only the index at the end is lost: all that was measured is there.
    assert_eq!(read(&whole[..whole.len() - 40]).unwrap(), read(&whole).unwrap());
}

#[test]
fn what_is_wrong_with_a_row_is_named() {
    let good = r#"{"t_s":0}"#;
    let error = read(&foreign(&[good, "[1]"])).unwrap_err();
    assert!(
        matches!(&error, LogError::BadMessage { index: 1, topic, .. } if topic == "/anything"),
        "{error}"
    );
    let message = read(&foreign(&[
        r#"{"t_s":0,"imu_rol_deg":1,"imu_pitch_deg":1,"imu_yaw_deg":1,"vbat_v":3,"cmd_roll_deg":1,
        "cmd_pitch_deg":0,"cmd_yaw_rate_degps":0,"cmd_thrust_pwm":1}"#,
    ]));
    let message = message.unwrap_err().to_string();
    assert!(message.contains("imu_rol_deg") && message.contains("topic /anything"), "{message}");
    let row = |value: &str| {
        let names = text(false)
            .lines()
            .next()
            .unwrap()
            .split(',')
            .map(|name| format!("\"{name}\":0"))
            .collect::<Vec<_>>()
            .join(",");
        format!("{{{}}}", names.replace("\"vbat_v\":0", &format!("\"vbat_v\":{value}")))
    };
    let message = read(&foreign(&[&row("\"full\"")])).unwrap_err().to_string();
    assert!(
        message.contains("line 1") && message.contains("vbat_v") && message.contains("full"),
        "{message}"
    );
    assert_eq!(read(&foreign(&[&row("3.9")])).unwrap().vbat_v, Some(vec![3.9]));
}

#[test]
fn a_full_disk_and_a_missing_channel_are_typed_errors() {
    assert!(matches!(sample().write_mcap(Full), Err(LogError::WriteMcap(_))));
    let mut log = sample();
    log.vbat_v = None;
    assert!(matches!(log.write_mcap(Cursor::new(Vec::new())), Err(LogError::CannotWrite { .. })));
}
