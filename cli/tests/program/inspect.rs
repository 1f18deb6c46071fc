//! `inspect` from the command line: a flight of the simulator, and the same flight under names that nobody
//! knows.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use crate::common::{assert_fails, folder, json, stdout_of, text};

fn flight(folder: &Path) -> PathBuf {
    let file = folder.join("flight.csv");
    stdout_of(&[
        "fly",
        "--task",
        "track",
        "--controller",
        "lqr",
        "--seconds",
        "12",
        "--sensors",
        "lab",
        "--vertical",
        "thrust",
        "--csv",
        text(&file),
    ]);
    file
}

#[test]
fn a_simulated_flight_suffices_and_its_signs_agree() {
    let folder = folder("inspect");
    let (file, svg) = (flight(&folder), folder.join("look.svg"));
    let output = json(&["inspect", text(&file), "--picture", text(&svg), "--json"]);
    let log = &output["logs"][0]["inspection"];
    assert_eq!(
        (&log["provenance"]["format"], &log["provenance"]["position"]),
        (&"project_csv".into(), &"camera".into())
    );
    let signs = log["signs"].as_array().unwrap();
    for channel in ["pitch", "roll", "cmd_pitch", "cmd_roll", "acc_z"] {
        let check = signs.iter().find(|check| check["channel"] == channel).unwrap();
        assert_eq!(check["verdict"], "agrees", "{check}");
    }
    let needs = log["needs"].as_array().unwrap();
    assert!(
        needs
            .iter()
            .filter(|need| need["command"] != "diagnose")
            .all(|need| need["missing"].as_array().unwrap().is_empty()),
        "{needs:?}"
    );
    assert!(std::fs::read_to_string(&svg).unwrap().contains("pitch (deg)"));
    let words = stdout_of(&["inspect", text(&file)]);
    for part in [
        "a project CSV",
        "position: camera",
        "cmd_thrust",
        "bandwidth",
        "agrees",
        "explain   suffices",
        "diagnose  lacks",
    ] {
        assert!(words.contains(part), "{part}: {words}");
    }
}

#[test]
fn an_unknown_csv_is_drafted_and_then_read_by_every_command() {
    let folder = folder("inspect-unknown");
    let known = std::fs::read_to_string(flight(&folder)).unwrap();
    let mut lines = known.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = lines.next().unwrap();
    let taken = [
        ("t_s", "t"),
        ("true_x_m", "x"),
        ("true_y_m", "y"),
        ("true_z_m", "z"),
        ("imu_roll_deg", "roll"),
        ("imu_pitch_deg", "pitch"),
        ("cmd_roll_deg", "roll_ref"),
        ("cmd_pitch_deg", "pitch_ref"),
        ("cmd_thrust_pwm", "throttle"),
    ];
    let at = taken.map(|(name, _)| header.iter().position(|column| *column == name).unwrap());
    let mut csv = taken.map(|(_, name)| name).join(";") + "\n";
    for cells in lines {
        let _ = writeln!(csv, "{}", at.map(|at| cells[at].replace('.', ",")).join(";"));
    }
    let (file, mapping) = (folder.join("lab.csv"), folder.join("lab.mapping.toml"));
    std::fs::write(&file, csv).unwrap();
    assert_fails(1, &["replay", text(&file)], &["lab.csv", "a mapping file can tell", "crazyflie inspect"]);
    let drafted = stdout_of(&["inspect", text(&file)]);
    assert!(drafted.contains("by a draft of a mapping"), "{drafted}");
    stdout_of(&["inspect", text(&file), "--mapping-out", text(&mapping)]);
    let draft = std::fs::read_to_string(&mapping).unwrap();
    assert!(draft.contains("cmd_pitch = { column = \"pitch_ref\", unit = \"deg\" }"), "{draft}");
    let read = stdout_of(&["inspect", text(&file)]);
    assert!(read.contains("a CSV read by a mapping file") && !read.contains("by a draft"), "{read}");
    assert!(stdout_of(&["replay", text(&file), "--horizon", "2", "--vertical", "thrust"]).contains("pitch"));
    std::fs::write(&mapping, draft.replace("\"deg\"", "\"degg\"")).unwrap();
    assert_fails(1, &["replay", text(&file)], &["lab.mapping.toml, line", "degg", "did you mean \"deg\""]);
}

#[test]
fn what_cannot_be_inspected_is_said() {
    let folder = folder("inspect-bad");
    let file = folder.join("notes.csv");
    std::fs::write(&file, "name,price\napple,3\n").unwrap();
    assert_fails(1, &["inspect", text(&file)], &["notes.csv", "no known log format", "--mapping-out"]);
    assert_fails(1, &["inspect", "no/such.csv"], &["no/such.csv"]);
    assert_fails(2, &["inspect", "a.csv", "b.csv", "--mapping-out", "x.toml"], &["one file"]);
    assert_fails(2, &["inspect", "a.csv", "b.csv", "--picture", "x.svg"], &["name a folder"]);
}
