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
    assert_fails(1, &["replay", text(&file)], &["lab.csv", "write a mapping file", "crazyflie inspect"]);
    let drafted = stdout_of(&["inspect", text(&file)]);
    assert!(drafted.contains("by a draft of a mapping"), "{drafted}");
    // the motion confirms the angles, nothing confirms the rest
    assert!(
        drafted.contains("guesses that nothing checks: x (m), y (m), z (m), cmd_thrust (pwm)"),
        "{drafted}"
    );
    stdout_of(&["inspect", text(&file), "--mapping-out", text(&mapping)]);
    let draft = std::fs::read_to_string(&mapping).unwrap();
    assert!(draft.contains("cmd_pitch = { column = \"pitch_ref\", unit = \"deg\" }"), "{draft}");
    let read = stdout_of(&["inspect", text(&file)]);
    assert!(read.contains("a log read by a mapping file") && !read.contains("by a draft"), "{read}");
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

/// The flight with a column changed.
fn with_column(file: &Path, column: &str, change: impl Fn(f64) -> f64) -> PathBuf {
    let content = std::fs::read_to_string(file).unwrap();
    let index = content.lines().next().unwrap().split(',').position(|name| name == column).unwrap();
    let changed = content.lines().enumerate().map(|(row, line)| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if row > 0 {
            cells[index] = change(cells[index].parse().unwrap()).to_string();
        }
        cells.join(",") + "\n"
    });
    let target = file.with_file_name(format!("turned_{column}.csv"));
    std::fs::write(&target, changed.collect::<String>()).unwrap();
    target
}

#[test]
fn no_flight_of_ours_contradicts_itself() {
    let folder = folder("own-signs");
    for vertical in ["height", "pwm", "thrust"] {
        for task in ["fly-80cm", "hover-70cm", "height-step"] {
            let file = folder.join(format!("{task}-{vertical}.csv"));
            let own = ["--task", task, "--sensors", "lab", "--vertical", vertical, "--csv", text(&file)];
            stdout_of(&[&["fly"][..], &own].concat());
            let shown = stdout_of(&["inspect", text(&file)]);
            assert!(!shown.contains("contradicts"), "{task} {vertical}: {shown}");
        }
    }
}

#[test]
fn a_grave_finding_stops_every_command_that_computes_with_the_log() {
    let folder = folder("grave");
    let file = flight(&folder);
    let turned = with_column(&file, "imu_pitch_deg", |pitch| -pitch);
    let (good, bad, out) = (text(&file), text(&turned), folder.join("out"));
    let words = ["pitch contradicts the motion", "[scale] pitch = -1"];
    for command in [
        &["replay", bad][..],
        &["identify", "--fit", bad, "--out", text(&out)],
        &["identify", "--fit", good, "--test", bad],
        &["explain", "thesis", "--fit", good, "--test", bad, "--out", text(&out)],
        &["horizons", "--fit", bad, "--test", good],
        &["diagnose", "--normal", bad, "--suspect", good],
    ] {
        assert_fails(1, command, &words);
        assert!(!out.exists(), "{command:?} wrote a file");
    }
    let shown = stdout_of(&["inspect", bad]);
    assert!(shown.lines().nth(2).unwrap().starts_with("GRAVE") && shown.contains(words[0]), "{shown}");
    let anyway = crate::common::run(&["replay", bad, "--anyway"]);
    assert!(anyway.code == 0 && anyway.err.contains("grave: pitch contradicts"), "{}", anyway.err);
    // the cure that it names
    std::fs::write(folder.join("turned_imu_pitch_deg.mapping.toml"), "[scale]\npitch = -1\n").unwrap();
    assert!(!stdout_of(&["inspect", bad]).contains("GRAVE"));
    stdout_of(&["replay", bad]);
}

/// The verdict of `inspect` on a log agrees with the command itself: for every file of the corpus, and a flight that
/// suffices.
#[test]
fn a_log_suffices_only_where_the_command_accepts_it() {
    let folder = folder("suffices");
    let mut files = vec![flight(&folder)];
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus/flight_log");
    for format in std::fs::read_dir(corpus).unwrap() {
        files.extend(std::fs::read_dir(format.unwrap().path()).unwrap().map(|file| file.unwrap().path()));
    }
    let (mut said, mut read) = (0, 0);
    for file in &files {
        let inspected = crate::common::run(&["inspect", text(file), "--json"]);
        let Ok(object) = serde_json::from_str::<serde_json::Value>(&inspected.out) else {
            assert!(inspected.code == 1 && inspected.err.contains(text(file)), "{}", inspected.err);
            continue;
        };
        read += 1;
        let out = folder.join("out");
        for need in object["logs"][0]["inspection"]["needs"].as_array().unwrap() {
            if !need["missing"].as_array().unwrap().is_empty() {
                continue;
            }
            let command: Vec<&str> = match need["command"].as_str().unwrap() {
                "replay" => vec!["replay", text(file)],
                "identify" => vec!["identify", "--fit", text(file)],
                "diagnose" => vec!["diagnose", "--normal", text(file), "--suspect", text(file)],
                // two names of one flight are refused, which says that the log itself is accepted
                _ => {
                    vec!["explain", "thesis", "--fit", text(file), "--test", text(file), "--out", text(&out)]
                }
            };
            let done = crate::common::run(&command);
            let accepted = done.code == 0 || done.err.contains("hold the same flight");
            assert!(accepted, "{command:?}: {}", done.err);
            said += 1;
        }
    }
    assert!(read > 20 && said >= 3, "{read} files were read, {said} commands suffice");
}
