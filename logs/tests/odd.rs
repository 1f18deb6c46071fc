//! Logs as people store them: whatever surrounds or interrupts a table, the result is the same flight, or an error
//! that names the cause.

use std::io::Write as _;
use std::path::PathBuf;

use crazyflie_logs::inspect::{Finding, Grade, Inspection};
use crazyflie_logs::{FlightLog, LogError, Mapping, Note, PositionSource, ReadOptions};
use flate2::{Compression, write::GzEncoder};

const HEADER: &str = "Timestamp,stateEstimate.x,stateEstimate.y,stateEstimate.z,stateEstimate.roll,stateEstimate.pitch,\
                      stateEstimate.yaw,controller.roll,controller.pitch,controller.cmd_thrust,pm.vbat";
const COLUMNS: usize = 11;
const ROWS: usize = 600;
const G_MPS2: f64 = 9.80665;

/// Returns twelve seconds at 50 Hz: at rest, rising to 0.8 m and swaying. Milliseconds, degrees, pitch inverted.
fn rows(start_ms: f64) -> Vec<Vec<String>> {
    let row = |i: usize| {
        let t = i as f64 * 0.02;
        let flies = if t > 2.0 { 1.0 } else { 0.0 };
        let w = 2.4;
        let (sin, cos) = (w * (t - 2.0)).sin_cos();
        let (x, y) = (0.3 * flies * (1.0 - cos), 0.2 * flies * sin);
        let z = 0.8 * ((t - 1.0) / 1.0).clamp(0.0, 1.0);
        let pitch = -(0.3 * flies * w * w * cos / G_MPS2).to_degrees();
        let roll = (0.2 * flies * w * w * sin / G_MPS2).to_degrees();
        let thrust = if t < 0.8 { 0.0 } else { 40_000.0 };
        let cells = [start_ms + (t * 1000.0).round(), x, y, z, roll, pitch, 0.0, roll, pitch, thrust, 3.9];
        cells.map(|cell| cell.to_string()).to_vec()
    };
    (0..ROWS).map(row).collect()
}

fn text(rows: &[Vec<String>], separator: &str) -> String {
    let lines = rows.iter().map(|row| row.join(separator) + "\n");
    std::iter::once(HEADER.replace(',', separator) + "\n").chain(lines).collect()
}

fn plain() -> String {
    text(&rows(119_637.0), ",")
}

fn read(bytes: &[u8]) -> Result<FlightLog, LogError> {
    FlightLog::from_bytes("odd.csv", bytes)
}

/// Returns whether it is the same flight, whatever the notes.
fn is_same(a: &FlightLog, b: &FlightLog) -> bool {
    let near =
        |a: &[f64], b: &[f64]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
    near(&a.t_s, &b.t_s)
        && near(&a.pitch_rad, &b.pitch_rad)
        && near(&a.fixes.pos_m[2], &b.fixes.pos_m[2])
        && near(a.cmd_thrust_pwm.as_ref().unwrap(), b.cmd_thrust_pwm.as_ref().unwrap())
        && near(a.vbat_v.as_ref().unwrap(), b.vbat_v.as_ref().unwrap())
        && a.airborne == b.airborne
}

fn utf16(text: &str, big_endian: bool, marked: bool) -> Vec<u8> {
    let mark = marked.then_some(0xfeff_u16);
    let units = mark.into_iter().chain(text.encode_utf16());
    units.flat_map(|unit| if big_endian { unit.to_be_bytes() } else { unit.to_le_bytes() }).collect()
}

fn zip_of(files: &[(&str, &str)]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, text) in files {
        archive.start_file(*name, zip::write::SimpleFileOptions::default()).unwrap();
        archive.write_all(text.as_bytes()).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

#[test]
fn whatever_stands_around_a_table_is_read_as_the_same_flight() {
    let text = plain();
    let expected = read(text.as_bytes()).unwrap();
    let lines = || text.lines();
    let (header, body) = text.split_once('\n').unwrap();
    let with_line = |at: usize, line: &str| -> String {
        lines()
            .enumerate()
            .flat_map(|(i, l)| if i == at { vec![line, l] } else { vec![l] })
            .map(|l| format!("{l}\n"))
            .collect()
    };
    let map =
        |change: &dyn Fn(&str) -> String| -> String { lines().map(|line| change(line) + "\n").collect() };
    let units = "ms,m,m,m,deg,deg,deg,deg,deg,1,V";
    let blanks = rows(119_637.0);
    let date = |i: usize| {
        format!(
            "2024-03-05 14:{:02}:{:06.3}",
            22 + (56_000 + 20 * i) / 60_000,
            f64::from(((56_000 + 20 * i) % 60_000) as u32) / 1e3
        )
    };
    let dated: String = lines()
        .enumerate()
        .map(|(i, l)| {
            if i == 0 {
                format!("{l}\n")
            } else {
                format!("{},{}\n", date(i - 1), l.split_once(',').unwrap().1)
            }
        })
        .collect();
    let mut gz = GzEncoder::new(Vec::new(), Compression::fast());
    gz.write_all(text.as_bytes()).unwrap();
    let cases: Vec<(&str, Vec<u8>)> = vec![
        ("comments", format!("# vehicle 3\n// fresh battery\n% room 12\n{text}").into_bytes()),
        ("a comment between rows", with_line(100, "# the wind rose, at 3,5").into_bytes()),
        ("the header as a comment", format!("# {text}").into_bytes()),
        ("the header as a comment below another", format!("# room 12, blue\n#{text}").into_bytes()),
        ("a preamble", format!("Flight of Monday\nDate,2024-03-05\nPilot,Ada\n\n{text}").into_bytes()),
        ("a row of units", format!("{header}\n{units}\n{body}").into_bytes()),
        (
            "units in brackets",
            format!(
                "{header}\n{}\n{body}",
                units.split(',').map(|u| format!("[{u}]")).collect::<Vec<_>>().join(",")
            )
            .into_bytes(),
        ),
        ("two header lines", format!("{}\n{text}", "cf1,".repeat(COLUMNS - 1) + "cf1").into_bytes()),
        ("the header again", with_line(300, header).into_bytes()),
        ("a trailing comma", map(&|line| format!("{line},")).into_bytes()),
        (
            "a trailing comma in the rows alone",
            format!("{header}\n{}", body.replace('\n', ",\n")).into_bytes(),
        ),
        ("empty rows at the end", format!("{text}{}\n", ",".repeat(COLUMNS - 1)).into_bytes()),
        ("a separator in a line of its own", format!("sep=;\n{}", text.replace(',', ";")).into_bytes()),
        ("bars", text.replace(',', "|").into_bytes()),
        ("tabs", text.replace(',', "\t").into_bytes()),
        ("columns of blanks", text.replace(',', "   ").into_bytes()),
        (
            "semicolons and decimal commas",
            text.replace(',', ";")
                .replace(".0", ",0")
                .replace("0.", "0,")
                .replace("stateEstimate,", "stateEstimate.")
                .into_bytes(),
        ),
        (
            "quoted cells",
            map(&|line| line.split(',').map(|cell| format!("\"{cell}\"")).collect::<Vec<_>>().join(","))
                .into_bytes(),
        ),
        ("blanks after commas", text.replace(',', ", ").into_bytes()),
        ("Windows' line ends", text.replace('\n', "\r\n").into_bytes()),
        ("UTF-8 with a mark", format!("\u{feff}{text}").into_bytes()),
        ("UTF-16, little endian", utf16(&text, false, true)),
        ("UTF-16, big endian", utf16(&text, true, true)),
        ("UTF-16 without a mark", utf16(&text, false, false)),
        ("gzip", gz.finish().unwrap()),
        ("zip", zip_of(&[("flight.csv", &text), (".hidden", "1")])),
        ("dates", dated.clone().into_bytes()),
        ("dates as ISO 8601", dated.replace("2024-03-05 ", "2024-03-05T").into_bytes()),
        ("times of the day", dated.replace("2024-03-05 ", "").into_bytes()),
        (
            "words for missing values",
            with_line(
                601,
                &blanks[599]
                    .iter()
                    .enumerate()
                    .map(|(i, c)| if i == 0 { c.clone() } else { "nan".into() })
                    .collect::<Vec<_>>()
                    .join(","),
            )
            .lines()
            .enumerate()
            .filter(|(i, _)| *i != 602)
            .map(|(_, l)| format!("{l}\n"))
            .collect::<String>()
            .into_bytes(),
        ),
        (
            "a column of words",
            map(&|line| format!("{line},{}", if line == header { "mode" } else { "HOVER" })).into_bytes(),
        ),
        (
            "an index without a name",
            lines()
                .enumerate()
                .map(|(i, l)| if i == 0 { format!(",{l}\n") } else { format!("{i},{l}\n") })
                .collect::<String>()
                .into_bytes(),
        ),
        (
            "names with underscores and units",
            format!("{}\n{body}", header.replace('.', "_").replace("_roll", "_roll [deg]")).into_bytes(),
        ),
        ("a stamp that wraps at 24 bits", text_wrapped(16_777_216.0).into_bytes()),
        ("a stamp that wraps at 16 bits", text_wrapped(65_536.0).into_bytes()),
    ];
    for (what, bytes) in cases {
        let log = read(&bytes).unwrap_or_else(|error| panic!("{what}: {error}"));
        let is_cut = what == "words for missing values";
        assert!(is_cut || is_same(&log, &expected), "{what}: {} rows, {:?}", log.len(), log.notes);
        assert!(!Inspection::from_log(&log).grave().any(|_| true), "{what}");
    }
}

fn text_wrapped(wrap: f64) -> String {
    let mut all = rows(0.0);
    for row in &mut all {
        let stamp: f64 = row[0].parse().unwrap();
        row[0] = ((wrap - 5000.0 + stamp) % wrap).to_string();
    }
    text(&all, ",")
}

#[test]
fn names_and_values_in_rows_and_lines_become_columns() {
    let expected = read(plain().as_bytes()).unwrap();
    let names: Vec<&str> = HEADER.split(',').collect();
    let all = rows(119_637.0);
    let pairs = |row: &Vec<String>, line: &dyn Fn(&str, &str) -> String| {
        names.iter().zip(row).skip(1).map(|(name, value)| line(name, value)).collect::<Vec<_>>()
    };
    let long = |head: &str, before: &str| -> String {
        let lines = all
            .iter()
            .flat_map(|row| pairs(row, &|name, value| format!("{before}{},{name},{value}\n", row[0])));
        std::iter::once(head.to_owned()).chain(lines).collect()
    };
    let printed = |line: &dyn Fn(&[String], &str) -> String| -> String {
        all.iter()
            .map(|row| line(row, &pairs(row, &|name, value| format!("'{name}': {value}")).join(", ")))
            .collect()
    };
    let json: String = all
        .iter()
        .map(|row| {
            format!("{{\"time\": {}, {}}}\n", row[0], pairs(row, &|n, v| format!("\"{n}\": {v}")).join(", "))
        })
        .collect();
    for (what, text) in [
        ("long form", long("time,variable,value\n", "")),
        ("long form of two clocks", long("host_s,vehicle_ms,variable,value\n", "7.5,")),
        ("long form without a header", long("", "")),
        ("printed dictionaries", printed(&|row, pairs| format!("[{}][block]: {{{pairs}}}\n", row[0]))),
        (
            "printed dictionaries below words",
            format!("connected\n{}", printed(&|row, pairs| format!("{} {{{pairs}}}\n", row[0]))),
        ),
        ("JSON lines", json),
    ] {
        let log = read(text.as_bytes()).unwrap_or_else(|error| panic!("{what}: {error}"));
        assert!(is_same(&log, &expected), "{what}: {} rows, {:?}", log.len(), log.notes);
        assert!(log.notes.iter().any(|note| matches!(note, Note::Pivoted { .. })), "{what}");
    }
}

/// A `.npy` file of doubles or, if they fit, of 32-bit numbers.
fn npy(values: &[f64], width: usize, single: bool) -> Vec<u8> {
    let (kind, rows) = (if single { "<f4" } else { "<f8" }, values.len() / width);
    let shape = if width == 1 { format!("({rows},)") } else { format!("({rows}, {width})") };
    let header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut bytes = [b"\x93NUMPY\x01\x00".to_vec(), (header.len() as u16).to_le_bytes().to_vec()].concat();
    bytes.extend(header.as_bytes());
    let number = |v: &f64| if single { (*v as f32).to_le_bytes().to_vec() } else { v.to_le_bytes().to_vec() };
    bytes.extend(values.iter().flat_map(number));
    bytes
}

#[test]
fn arrays_of_numpy_are_columns() {
    let all = rows(119_637.0);
    let column = |at: usize| all.iter().map(|row| row[at].parse().unwrap()).collect::<Vec<f64>>();
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (at, name) in HEADER.split(',').enumerate() {
        archive.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
        archive.write_all(&npy(&column(at), 1, name == "pm.vbat")).unwrap();
    }
    archive.start_file("gains.npy", zip::write::SimpleFileOptions::default()).unwrap();
    archive.write_all(&npy(&[1.0, 2.0, 3.0, 4.0], 2, false)).unwrap();
    let bytes = archive.finish().unwrap().into_inner();
    let log = read(&bytes).unwrap();
    assert!(is_same(&log, &read(plain().as_bytes()).unwrap()), "{:?}", log.notes);
    assert!(
        log.notes.contains(&Note::IgnoredColumns { columns: vec!["gains[0]".into(), "gains[1]".into()] })
    );
    // by a mapping, and damaged
    let mapping = "[time]\ncolumn = \"Timestamp\"\n[channels]\nx = { column = \"stateEstimate.x\" }\n\
                   y = { column = \"stateEstimate.y\" }\nz = { column = \"stateEstimate.z\" }\n";
    let mapped =
        FlightLog::from_mapped_bytes("odd.npz", &bytes, Mapping::parse("m", mapping).unwrap()).unwrap();
    assert_eq!(mapped.fixes.pos_m, log.fixes.pos_m);
    assert!(read(&bytes[..bytes.len() / 2]).is_err());
}

/// A folder that is gone afterwards.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("crazyflie-odd-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.join(name);
        std::fs::write(&path, text).unwrap();
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn a_clock_that_begins_anew_is_another_flight() {
    let (first, second) = (rows(119_637.0), rows(4000.0)[..400].to_vec());
    let folder = Folder::new("two");
    for header_again in [false, true] {
        let more = text(&second, ",");
        let more = if header_again { more } else { more.split_once('\n').unwrap().1.to_owned() };
        let path = folder.write("two.csv", &(text(&first, ",") + &more));
        let part = |part| FlightLog::read_with(&path, &ReadOptions { part, ..ReadOptions::default() });
        let log = part(None).unwrap();
        assert_eq!((log.len(), part(Some(2)).unwrap().len()), (600, 400));
        assert!(log.notes.contains(&Note::Flights { count: 2, read: 1 }), "{:?}", log.notes);
        let error = part(Some(3)).unwrap_err().to_string();
        assert!(error.contains("--part from 1 to 2"), "{error}");
    }
}

#[test]
fn files_of_one_flight_are_joined_on_their_clock() {
    let expected = read(plain().as_bytes()).unwrap();
    let columns = |at: &[usize], shift_ms: f64| -> String {
        let pick = |row: &[String]| at.iter().map(|at| row[*at].clone()).collect::<Vec<_>>().join(",") + "\n";
        let header: Vec<String> = HEADER.split(',').map(str::to_owned).collect();
        let shifted = |mut row: Vec<String>| {
            row[0] = (row[0].parse::<f64>().unwrap() + shift_ms).to_string();
            row
        };
        std::iter::once(pick(&header))
            .chain(rows(119_637.0).into_iter().map(|row| pick(&shifted(row))))
            .collect()
    };
    let (pose, command) = (columns(&[0, 1, 2, 3, 4, 5, 6], 0.0), columns(&[0, 7, 8, 9, 10], 0.0));
    let folder = Folder::new("join");
    let (a, b) = (folder.write("a.csv", &pose), folder.write("b.csv", &command));
    let named = PathBuf::from(format!("{}+{}", a.display(), b.display()));
    for path in [named, folder.0.clone()] {
        let log = FlightLog::read(&path).unwrap();
        assert!(is_same(&log, &expected), "{}: {:?}", path.display(), log.notes);
    }
    let log = read(&zip_of(&[("pose.csv", &pose), ("command.csv", &command)])).unwrap();
    assert!(is_same(&log, &expected) && log.notes.iter().any(|note| matches!(note, Note::Joined { .. })));
    // half of a flight says so
    let error = read(command.as_bytes()).unwrap_err().to_string();
    assert!(error.contains("a.csv+b.csv"), "{error}");
    // another flight's commands are no part of this one
    let other = folder.write("b.csv", &columns(&[0, 7, 8, 9, 10], 1e6));
    let error = FlightLog::read(&folder.0).unwrap_err().to_string();
    assert!(error.contains("not one flight") && other.exists(), "{error}");
}

#[test]
fn errors_name_the_cause() {
    let text = plain();
    let (header, body) = text.split_once('\n').unwrap();
    let no_time: String =
        text.lines().map(|line| line.split_once(',').unwrap().1.to_owned() + "\n").collect();
    let ragged: String = text
        .lines()
        .enumerate()
        .map(|(i, l)| if i % 20 == 3 { "1,2\n".into() } else { format!("{l}\n") })
        .collect();
    let rounded: String = text
        .lines()
        .enumerate()
        .map(|(i, l)| {
            if i == 0 { format!("{l}\n") } else { format!("1700000128.0,{}\n", l.split_once(',').unwrap().1) }
        })
        .collect();
    let commas: String = format!("{header}\n{}", body.replace('.', ","));
    for (what, text, words) in [
        ("no time", no_time.clone(), "rate_hz"),
        ("no header", body.to_owned(), "no header line"),
        ("ragged rows", ragged, "rows are damaged: the first is line 4 with 2 cells"),
        ("float32", rounded, "599 of 600 stamps"),
        ("decimal commas", commas, "cells"),
    ] {
        let error = read(text.as_bytes()).map(|log| log.notes).unwrap_err().to_string();
        assert!(error.contains("odd.csv") && error.contains(words), "{what}: {error}");
    }
    // and the cures work
    let mapped = |text: &str, mapping: &str| {
        FlightLog::from_mapped_bytes("odd.csv", text.as_bytes(), Mapping::parse("m.toml", mapping).unwrap())
    };
    let expected = read(text.as_bytes()).unwrap();
    let cured = mapped(&no_time, "[time]\nrate_hz = 50\n").unwrap();
    assert!(is_same(&cured, &expected), "{:?}", cured.notes);
    let names = HEADER.split(',').map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ");
    let cured = mapped(body, &format!("[table]\ncolumns = [{names}]\n")).unwrap();
    assert!(is_same(&cured, &expected), "{:?}", cured.notes);
}

#[test]
fn a_turned_sign_or_a_wrong_unit_is_grave_and_the_cure_that_it_names_works() {
    let factor = |column: usize, factor: f64| {
        let mut all = rows(119_637.0);
        all.iter_mut()
            .for_each(|row| row[column] = (row[column].parse::<f64>().unwrap() * factor).to_string());
        text(&all, ",")
    };
    let rad = std::f64::consts::PI / 180.0;
    let both = |text: String, column: usize| {
        let lines = text.lines().enumerate().map(|(i, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if i > 0 {
                cells[column] = (cells[column].parse::<f64>().unwrap() * rad).to_string();
            }
            cells.join(",") + "\n"
        });
        lines.collect::<String>()
    };
    for (text, channel, word) in [
        (factor(5, -1.0), "pitch", "sign is turned"),
        (factor(7, -1.0), "cmd_roll", "sign is turned"),
        (both(factor(4, rad), 5), "pitch", "radians read as degrees"),
        (both(factor(7, rad), 8), "cmd_pitch", "radians read as degrees"),
    ] {
        let log = read(text.as_bytes()).unwrap();
        let grave: Vec<_> = log.findings().into_iter().filter(|f| f.grade == Grade::Grave).collect();
        let cures = |f: &&Finding| f.cure.as_ref().is_some_and(|cure| cure.contains(&format!("{channel} =")));
        let finding = grave.iter().find(|f| cures(f) && f.text.contains(word));
        let finding = finding.unwrap_or_else(|| panic!("{channel}: {grave:?}"));
        let inspection = Inspection::from_log(&log);
        assert!(inspection.needs.iter().filter(|n| n.command != "diagnose").all(|n| !n.missing.is_empty()));
        let (_, cure) = finding.cure.as_ref().unwrap().split_once("[scale] ").unwrap();
        let mapping = format!("[scale]\n{}\n", cure.replace(", ", "\n"));
        let mapping = Mapping::parse("m.toml", &mapping).unwrap();
        let cured = FlightLog::from_mapped_bytes("odd.csv", text.as_bytes(), mapping).unwrap();
        let left: Vec<_> = cured.findings().into_iter().filter(|f| f.grade == Grade::Grave).collect();
        assert!(left.is_empty(), "{channel}: {left:?}");
    }
}

#[test]
fn a_hover_close_to_the_floor_is_a_flight_and_a_gap_parts_one() {
    let with = |change: &dyn Fn(f64, &mut Vec<String>)| {
        let mut all = rows(0.0);
        all.iter_mut().for_each(|row| change(row[0].parse::<f64>().unwrap() / 1e3, row));
        all
    };
    // from 2 s to 11 s between 0.4 and 12 cm over a floor that the vehicle sees at 3 cm
    let low = with(&|t, row| {
        let h = if (2.0..11.0).contains(&t) { 0.062 + 0.058 * (2.0 * t).sin() } else { 0.0 };
        row[3] = (0.03 + h).to_string();
        row[9] = if (1.8..11.0).contains(&t) { "40000".into() } else { "0".into() };
    });
    let log = read(text(&low, ",").as_bytes()).unwrap();
    assert!((log.resting_height_m().unwrap() - 0.03).abs() < 1e-3);
    let [from_s, to_s] = [log.airborne.start, log.airborne.end - 1].map(|row| log.t_s[row]);
    assert!((1.9..2.6).contains(&from_s) && (10.2..11.1).contains(&to_s), "{from_s} to {to_s}");
    // 2 s without a row from 4 s on: the longer part is the flight
    let mut gap = rows(0.0);
    gap.retain(|row| !(4000.0..6000.0).contains(&row[0].parse::<f64>().unwrap()));
    let log = read(text(&gap, ",").as_bytes()).unwrap();
    assert!((log.t_s[log.airborne.start] - 6.0).abs() < 0.03, "{:?}", log.airborne);
    let findings = log.findings();
    let split = findings.iter().find(|finding| finding.text.contains("the flight is split there"));
    assert!(split.is_some_and(|f| f.grade == Grade::Warning && f.text.contains("3.98")), "{findings:?}");
}

#[test]
fn of_two_positions_the_one_from_outside_is_taken() {
    let all = rows(0.0);
    let with = |names: [&str; 3]| {
        let lines = all.iter().map(|row| {
            let seen = [1, 2, 3].map(|at| (row[at].parse::<f64>().unwrap() + 0.5).to_string());
            format!("{},{}\n", row.join(","), seen.join(","))
        });
        std::iter::once(format!("{HEADER},{}\n", names.join(","))).chain(lines).collect::<String>()
    };
    let log = read(with(["mocap_x", "mocap_y", "mocap_z"]).as_bytes()).unwrap();
    assert_eq!(log.provenance.position, PositionSource::MotionCapture);
    assert!((log.fixes.pos_m[0][0] - 0.5).abs() < 1e-9, "{:?}", log.notes);
    // an estimate of another name is none
    let log = read(with(["ekf_x", "ekf_y", "ekf_z"]).as_bytes()).unwrap();
    assert!(log.provenance.position == PositionSource::Estimate && log.fixes.pos_m[0][0].abs() < 1e-9);
}

#[test]
fn scale_offset_forces_and_field_turns_have_their_units() {
    let text = "t,x,y,z,u,f,a,w1,w2,w3,w4\n".to_owned()
        + &(0..60)
            .map(|i| format!("{},0,0,1,0.25,0.3,9,7000,7000,7000,7000\n", f64::from(i) * 0.02))
            .collect::<String>();
    let mapped = |more: &str| {
        let position = ["x", "y", "z"].map(|axis| format!("{axis} = {{ column = \"{axis}\" }}\n")).concat();
        let (top, channels) = more.split_once('|').unwrap();
        let mapping = Mapping::parse("m.toml", &format!("{top}\n[channels]\n{position}{channels}\n"))?;
        FlightLog::from_mapped_bytes("u.csv", text.as_bytes(), mapping)
    };
    let thrust = |more: &str| mapped(more).unwrap().cmd_thrust_pwm.unwrap()[0];
    let share = thrust("|cmd_thrust = { column = \"u\", unit = \"throttle\", scale = 2, offset = 0.05 }");
    assert!((share - 2.0 * 0.3 * 65_535.0).abs() < 1e-6, "{share}");
    // the firmware's own curve at half of the PWM of four motors: 4 (0.0915 / 4 + 0.0677 / 2) N
    let half_n = 4.0 * (0.091_492_681 * 0.25 + 0.067_673_604 * 0.5);
    let force =
        thrust(&format!("|cmd_thrust = {{ column = \"f\", unit = \"N\", scale = {} }}", half_n / 0.3));
    assert!((force - 32_767.5).abs() < 1e-6, "{force}");
    let accelerated =
        thrust(&format!("mass_kg = {}|cmd_thrust = {{ column = \"a\", unit = \"m/s2\" }}", half_n / 9.0));
    assert!((accelerated - 32_767.5).abs() < 1e-6, "{accelerated}");
    let rotors = (1..=4)
        .map(|n| format!("rotor_{n} = {{ column = \"w{n}\", unit = \"erpm\" }}\n"))
        .collect::<String>();
    let rotors = |top: &str| mapped(&format!("{top}|{rotors}"));
    let speed = rotors("pole_pairs = 7").unwrap().onboard.unwrap().rotor_radps.unwrap()[0][0];
    assert!((speed - 1000.0 * std::f64::consts::TAU / 60.0).abs() < 1e-9, "{speed}");
    for (more, words) in [
        (rotors(""), "needs pole_pairs"),
        (mapped("|cmd_thrust = { column = \"a\", unit = \"m/s2\" }"), "needs mass_kg"),
        (mapped("|cmd_thrust = { column = \"a\", unit = \"N\", scale = nan }"), "finite number"),
        (mapped("[scale]\npich = -1|"), "did you mean \"pitch\""),
        (mapped("[table]\nheader_line = 99|"), "no line 99"),
        (mapped("[time]\nrate_hz = 0|"), "rate_hz"),
    ] {
        let error = more.unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn a_unit_in_a_name_is_obeyed_and_two_outliers_are_no_crash() {
    let rad = std::f64::consts::PI / 180.0;
    let mut all = rows(0.0);
    for row in &mut all {
        for column in [4, 5, 6] {
            row[column] = (row[column].parse::<f64>().unwrap() * rad).to_string();
        }
    }
    let named = ["roll", "pitch", "yaw"].iter().fold(text(&all, ","), |text, name| {
        text.replacen(&format!("stateEstimate.{name}"), &format!("stateEstimate.{name} [rad]"), 1)
    });
    let (log, expected) = (read(named.as_bytes()).unwrap(), read(text(&rows(0.0), ",").as_bytes()).unwrap());
    assert!(is_same(&log, &expected) && !Inspection::from_log(&log).grave().any(|_| true), "{:?}", log.notes);
    let is_over = |at: &[usize]| {
        let grave = grave_texts(turned(at, 1.0));
        grave.iter().any(|text| text.contains("turns over"))
    };
    assert!(!is_over(&[200, 500]) && is_over(&(300..320).collect::<Vec<_>>()));
}

/// Rows with some of them turned to the right by 170 degrees, and places scaled.
fn turned(at: &[usize], scale: f64) -> Vec<Vec<String>> {
    let mut all = rows(0.0);
    at.iter().for_each(|row| all[*row][4] = "170".to_owned());
    for row in &mut all {
        for column in [1, 2] {
            row[column] = (scale * row[column].parse::<f64>().unwrap()).to_string();
        }
    }
    all
}

fn grave_texts(rows: Vec<Vec<String>>) -> Vec<String> {
    let findings = read(text(&rows, ",").as_bytes()).unwrap().findings();
    let grave = findings.into_iter().filter(|finding| finding.grade == Grade::Grave);
    grave.map(|finding| finding.text).collect()
}

#[test]
fn a_crash_is_not_taken_for_a_wrong_unit() {
    let flown = grave_texts(turned(&[], 57.0));
    assert!(flown.iter().any(|text| text.contains("57 times too small")), "{flown:?}");
    // a tumbling vehicle turns more than its logged angles
    let crashed = grave_texts(turned(&(500..520).collect::<Vec<_>>(), 57.0));
    assert!(crashed.iter().all(|text| text.contains("turns over")) && !crashed.is_empty(), "{crashed:?}");
}
