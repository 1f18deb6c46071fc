//! Files that are damaged, cut short, or no logs at all: a typed error or a log, never a panic.

#[path = "common/flight.rs"]
mod flight;

use std::io::Write;

use crazyflie_logs::{FlightLog, LogError, Note};
use flate2::{Compression, write::GzEncoder};
use flight::text;
use proptest::prelude::*;

fn read(bytes: &[u8]) -> Result<FlightLog, LogError> {
    FlightLog::from_bytes("log.csv", bytes)
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// Checks conditions of every log, however odd its file was.
fn check(log: &FlightLog) {
    let rows = log.len();
    assert!(rows > 0 && log.airborne.end <= rows);
    assert!(log.t_s.windows(2).all(|w| w[0] < w[1]));
    for channel in [&log.t_s, &log.roll_rad, &log.pitch_rad, &log.yaw_rad] {
        assert!(channel.len() == rows && channel.iter().all(|v| v.is_finite()));
    }
    let fixes = &log.fixes;
    assert!(fixes.row.iter().all(|row| *row < rows) && fixes.row.len() == fixes.capture_t_s.len());
    assert!(fixes.pos_m.iter().flatten().all(|v| v.is_finite()));
    for note in &log.notes {
        assert!(!note.to_string().is_empty());
    }
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

#[test]
fn a_full_disk_is_a_typed_error() {
    let log = read(text(true).as_bytes()).unwrap();
    assert!(matches!(log.write_csv(Full), Err(LogError::Write(_))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn any_bytes_give_an_answer(bytes in prop::collection::vec(any::<u8>(), 0..2000), packed in any::<bool>()) {
        let bytes = if packed { gzip(&bytes) } else { bytes };
        if let Ok(log) = read(&bytes) {
            check(&log);
        }
    }

    #[test]
    fn any_text_under_a_real_header_gives_an_answer(rows in "[-0-9.,e\n\"]{0,400}") {
        let header = text(true).lines().next().unwrap().to_owned();
        if let Ok(log) = read(format!("{header}\n{rows}").as_bytes()) {
            check(&log);
        }
    }
}

#[test]
fn a_truncated_gzip_gives_its_whole_lines() {
    let text = text(true);
    let packed = gzip(text.as_bytes());
    let log = read(&packed[..packed.len() - 60]).unwrap();
    assert!(log.notes.contains(&Note::TruncatedGzip));
    assert!(log.notes.iter().any(|n| matches!(n, Note::PartialLastLine { .. })));
    let whole = read(text.as_bytes()).unwrap();
    assert!(log.len() < whole.len());
    assert_eq!(log.t_s, whole.t_s[..log.len()]);
}

#[test]
fn a_last_line_without_an_end_is_left_out() {
    let text = text(false);
    let log = read(text.trim_end().as_bytes()).unwrap();
    assert_eq!(log.len(), 11);
    assert!(log.notes.contains(&Note::PartialLastLine { line: 13 }));
}

#[test]
fn what_is_no_log_is_named() {
    let text = text(false);
    let header = text.lines().next().unwrap();
    type Case = (Vec<u8>, fn(&LogError) -> bool);
    let cases: Vec<Case> = vec![
        (Vec::new(), |e| matches!(e, LogError::Empty { .. })),
        (b" \n\n".to_vec(), |e| matches!(e, LogError::Empty { .. })),
        (gzip(b""), |e| matches!(e, LogError::Empty { .. })),
        (vec![0x1f, 0x8b], |e| matches!(e, LogError::Empty { .. })),
        (header.as_bytes().to_vec(), |e| matches!(e, LogError::NoRows { .. })),
        (format!("{header}\n").into_bytes(), |e| matches!(e, LogError::NoRows { .. })),
        (vec![0xfc, 0, 1, 2, 255, 10, 3, 10], |e| matches!(e, LogError::NotText { .. })),
        (vec![0xbc, 0, 1, 2, 255, 10, 3, 10], |e| matches!(e, LogError::BadBinary { byte: 3, .. })),
        (b"name,price\napple,3\n".to_vec(), |e| matches!(e, LogError::UnknownFormat { .. })),
        (format!("{header},t_s\n").into_bytes(), |e| matches!(e, LogError::DuplicateColumn { .. })),
        (format!("{text}1,2\n3,4\n").into_bytes(), |e| {
            matches!(e, LogError::RaggedRows { count: 2, line: 14, found: 2, .. })
        }),
        (format!("{text}{}\n", "9".repeat(100_000)).into_bytes(), |e| {
            matches!(e, LogError::LineTooLong { line: 14, .. })
        }),
        (text.replace("0.02,", "0.02\u{fffd},").into_bytes(), |e| matches!(e, LogError::BadValue { .. })),
    ];
    for (bytes, expected) in cases {
        let error = read(&bytes).unwrap_err();
        assert!(expected(&error), "{error:?}");
        assert!(error.to_string().contains("log.csv"));
    }
}

#[test]
fn damaged_gzip_and_absent_files_are_named() {
    let mut packed = gzip(text(true).as_bytes());
    let middle = packed.len() / 2;
    packed[middle..middle + 20].fill(0xff);
    let error = read(&packed).unwrap_err();
    // Damage in the stream shows at once or in the check sum at the end.
    assert!(matches!(error, LogError::BadGzip { .. }), "{error:?}");
    let error = FlightLog::read(std::path::Path::new("no/such/file.csv")).unwrap_err();
    assert!(matches!(&error, LogError::Io { file, .. } if file.contains("no/such/file.csv")));
}
