//! Help, exit codes and bad input.

use std::io::Read;
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use crate::common::{BINARY, assert_fails, folder, json, run, stdout_of, text};

/// The commands that a help lists: two spaces, the name, what it does; or two spaces, a group, and its names with commas.
fn listed_commands(help: &str) -> Vec<String> {
    let Some((_, listed)) = help.split_once("Commands:") else { return Vec::new() };
    let lines = listed.trim_start_matches('\n').split("\n\n").next().unwrap().lines();
    let commands = lines.filter_map(|line| line.strip_prefix("  ")).filter(|line| !line.starts_with(' '));
    let names = commands.flat_map(|line| match line.rsplit_once("  ") {
        Some((_, names)) if names.split(", ").all(|name| !name.contains(' ')) => names.split(", ").collect(),
        _ => line.split_whitespace().take(1).collect::<Vec<_>>(),
    });
    names.filter(|name| *name != "help").map(str::to_owned).collect()
}

/// Goes down to the commands that do something; `token` shows its examples once for its three.
fn assert_helpful(words: &[&str]) -> usize {
    let name = words.join(" ");
    let help = stdout_of(&[words, &["--help"]].concat());
    let wide = help.lines().find(|line| line.chars().count() > 100);
    assert!(wide.is_none(), "{name}: {wide:?}");
    let below = listed_commands(&help);
    if !below.is_empty() && !help.contains("Examples:") {
        return below.iter().map(|command| assert_helpful(&[words, &[command]].concat())).sum();
    }
    assert!(help.contains("Examples:") && help.contains(&format!("crazyflie {name}")), "{name}: {help}");
    assert!(help.contains("--json") || name == "serve", "{help}");
    1
}

#[test]
fn every_command_has_help_with_examples() {
    let commands = listed_commands(&stdout_of(&["--help"]));
    let has = |name: &str| commands.iter().any(|known| known == name);
    assert!(has("fly") && has("bench") == cfg!(feature = "bench"), "{commands:?}");
    let helpful: usize = commands.iter().map(|command| assert_helpful(&[command])).sum();
    assert!(helpful >= 19, "{helpful}");
    assert!(stdout_of(&["--version"]).starts_with("crazyflie "));
}

#[cfg(feature = "bench")]
#[test]
fn old_names_of_commands_work_and_name_the_new_one() {
    let ran = run(&["scenarios", "--json"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(ran.err.contains("`scenarios` is now called `bench scenarios`"), "{}", ran.err);
    assert_eq!(ran.out, stdout_of(&["bench", "scenarios", "--json"]));
    let ran = run(&["fly", "--seconds", "1", "--rig=lab"]);
    assert!(ran.code == 0 && ran.err.contains("`--rig` is now called `--sensors`"), "{}", ran.err);
    assert!(run(&["pilot", "--help"]).out.contains("crazyflie world join"));
}

#[test]
fn what_became_a_script_names_it() {
    for (words, script) in [
        (&["reproduce", "thesis", "--markdown"][..], "scorecard.py"),
        (&["scorecard"], "scorecard.py"),
        (&["identify", "my.toml", "--thesis"], "identify.py"),
        (&["report", "recorded", "../shared/data"], "recorded.py"),
        (&["measured"], "recorded.py"),
    ] {
        let ran = run(words);
        assert_eq!((ran.code, ran.err.lines().count()), (2, 1), "{words:?}: {}", ran.err);
        let path = ran.err.trim().rsplit(' ').next().unwrap();
        assert!(path.ends_with(script), "{words:?}: {}", ran.err);
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        assert!(root.join(path).exists(), "{path}");
    }
}

#[test]
fn usage_errors_exit_with_2() {
    let model = folder("usage").join("model.toml");
    std::fs::write(&model, stdout_of(&["model", "--show"])).unwrap();
    assert_fails(2, &[], &["Usage"]);
    assert_fails(2, &["flie"], &["unrecognized subcommand", "fly"]);
    assert_fails(2, &["replay"], &["required"]);
    assert_fails(
        2,
        &["fly", "--task", "hovver"],
        &["unknown task or flight \"hovver\"", "did you mean \"hover\""],
    );
    assert_fails(2, &["fly", "--controller", "theses"], &["did you mean \"thesis\""]);
    assert_fails(2, &["fly", "--sensors", "labb"], &["did you mean \"lab\""]);
    assert_fails(2, &["fly", "--vertical", "pmw"], &["did you mean \"pwm\""]);
    assert_fails(2, &["fly", "--seconds", "NaN"], &["0.1 to 3600"]);
    assert_fails(2, &["fly", "--seconds", "-3"], &[]);
    assert_fails(2, &["fly", "--runs", "0"], &["1..=100000"]);
    assert_fails(2, &["fly", "--task-options", "{"], &["--task-options is not JSON"]);
    let unknown = ["unknown option of this task", "did you mean \"hover.start_m\""];
    assert_fails(2, &["fly", "--task-options", "{\"start\": 1}"], &unknown);
    assert_fails(2, &["effects", "drag_lineer"], &["did you mean \"drag_linear\""]);
    assert_fails(2, &["replay", text(&model)], &["name at least one log"]);
    assert_fails(2, &["replay", "x.csv", "--hover-pwm", "NaN"], &["expected auto or a PWM"]);
    assert_fails(2, &["replay", "x.csv", "--horizon", "0"], &["0.01"]);
}

#[test]
fn effects_are_checked_by_name_range_and_kind() {
    assert_fails(
        2,
        &["fly", "--effects", "drag_lineer=0.3"],
        &["unknown effect \"drag_lineer\"", "did you mean \"drag_linear\""],
    );
    assert_fails(2, &["fly", "--effects", "wind.x_mps=1"], &["wind.x_mps", "did you mean \"wind.x_mps2\""]);
    assert_fails(2, &["fly", "--effects", "wind=50"], &["wind.x_mps2 is 50", "-5 to 5 m/s^2"]);
    assert_fails(2, &["fly", "--effects", "wind=NaN"], &["wind.x_mps2 is NaN"]);
    assert_fails(2, &["fly", "--effects", "wind"], &["needs a value", "x_mps2"]);
    assert_fails(2, &["fly", "--effects", "wind=strong"], &["neither a number nor a distribution"]);
    assert_fails(2, &["fly", "--effects", "{\"wind\": }"], &["not a JSON object of effects"]);
    stdout_of(&[
        "fly",
        "--seconds",
        "1",
        "--effects",
        "wind.x_mps2={\"uniform\": [-1, 1]}",
        "--effects",
        "wind.y_mps2=0.2",
    ]);
}

#[test]
fn missing_and_broken_files_exit_with_1() {
    let folder = folder("broken");
    assert_fails(1, &["replay", "no/such/flight.csv"], &["no/such/flight.csv", "No such file"]);
    assert_fails(1, &["fly", "--model", "no/such/model.toml"], &["no/such/model.toml", "No such file"]);
    let model = folder.join("model.toml");
    let thesis = stdout_of(&["model", "--show"]);
    std::fs::write(
        &model,
        thesis.replace("value = 123.2, unit = \"1/s^2\"", "value = 123.2, unit = \"1/s\""),
    )
    .unwrap();
    assert_fails(
        1,
        &["model", text(&model)],
        &[text(&model), "roll.gain has the unit \"1/s\", expected \"1/s^2\""],
    );
    std::fs::write(&model, "schema = ").unwrap();
    assert_fails(1, &["fly", "--model", text(&model)], &[text(&model), "line 1"]);
    let log = folder.join("flight.csv");
    stdout_of(&["fly", "--seconds", "1", "--csv", text(&log)]);
    let whole = std::fs::read_to_string(&log).unwrap();
    std::fs::write(&log, whole.replace("imu_roll_deg", "imu_rol_deg")).unwrap();
    assert_fails(
        1,
        &["replay", text(&log)],
        &[text(&log), "\"imu_roll_deg\" (did you mean that by \"imu_rol_deg\"?)"],
    );
    let mut lines: Vec<String> = whole.lines().map(str::to_owned).collect();
    lines[6] = lines[6].replacen(',', ",NaN", 1);
    std::fs::write(&log, lines.join("\n") + "\n").unwrap();
    assert_fails(
        1,
        &["replay", text(&log)],
        &[text(&log), "line 7", "column \"setpoint_x_m\"", "NaN", "expected a finite number"],
    );
    std::fs::write(&log, "").unwrap();
    assert_fails(1, &["replay", text(&log)], &[text(&log), "is empty"]);
    assert_fails(1, &["fly", "--seconds", "1", "--csv", text(&folder)], &[text(&folder)]);
}

#[test]
fn a_truncated_gzip_is_read_as_far_as_it_goes_and_says_so() {
    let folder = folder("gzip");
    let log = folder.join("flight.csv");
    stdout_of(&["fly", "--task", "fly-80cm", "--seconds", "5", "--csv", text(&log)]);
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    std::io::Write::write_all(&mut packed, &std::fs::read(&log).unwrap()).unwrap();
    let bytes = packed.finish().unwrap();
    let cut = folder.join("flight.csv.gz");
    std::fs::write(&cut, &bytes[..bytes.len() * 9 / 10]).unwrap();
    assert!(stdout_of(&["replay", text(&cut)]).contains("the gzip data is truncated"));
    std::fs::write(&cut, &bytes[..30]).unwrap();
    assert_fails(1, &["replay", text(&cut)], &[text(&cut)]);
}

#[test]
fn a_closed_pipe_is_no_error() {
    for args in [&["effects", "--json"][..], &["fly", "--runs", "3", "--json"], &["--help"]] {
        let mut child =
            Command::new(BINARY).args(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let mut err = String::new();
        child.stderr.take().unwrap().read_to_string(&mut err).unwrap();
        assert!(child.wait().unwrap().success() && err.is_empty(), "{args:?}: {err}");
    }
}

#[test]
fn registries_are_listed_for_people_machines_and_docs() {
    let effects = json(&["effects", "--json"]);
    let effects = effects.as_array().unwrap();
    assert!(effects.len() > 30);
    for effect in effects {
        assert!(
            !effect["source"].as_str().unwrap().is_empty()
                && !effect["params"].as_array().unwrap().is_empty(),
            "{effect}"
        );
    }
    assert!(
        stdout_of(&["effects"]).contains("source: ")
            && stdout_of(&["effects", "--markdown"]).starts_with("| effect |")
    );
    let tasks = json(&["tasks", "--json"]);
    let listed = tasks["tasks"].as_array().unwrap().iter().map(|task| (&task["id"], &task["drones"]));
    let registered: Vec<Value> =
        crazyflie_env::task::registry().iter().map(|task| json!([task.id, task.drones])).collect();
    assert_eq!(listed.map(|(id, drones)| json!([id, drones])).collect::<Vec<_>>(), registered);
    assert!(
        stdout_of(&["tasks"]).contains("fly-80cm")
            && stdout_of(&["tasks", "--markdown"]).contains("`Crazyflie-v0`")
    );
    assert_eq!(json(&["model", "--json"])["name"], "cf2-thesis");
    assert_eq!(json(&["model", "--schema"])["properties"]["schema"]["const"], 1);
    assert!(stdout_of(&["model"]).contains("123.2 / (s^2 + 31.86 s + 81.85)"));
}

#[test]
fn a_model_survives_being_shown_and_read() {
    let folder = folder("model");
    let file = folder.join("model.toml");
    std::fs::write(&file, stdout_of(&["model", "--show"])).unwrap();
    let again = stdout_of(&["model", text(&file), "--show"]);
    std::fs::write(&file, &again).unwrap();
    assert_eq!(json(&["model", text(&file), "--json"]), json(&["model", "--json"]));
    let ran = run(&["fly", "--seconds", "1", "--model", text(&file)]);
    assert!(ran.code == 0 && ran.out.contains("model cf2-thesis"), "{}", ran.err);
}

#[test]
fn a_data_sheet_becomes_a_model_that_flies() {
    let folder = folder("datasheet");
    let (sheet, model) = (folder.join("sheet.toml"), folder.join("my.toml"));
    let example = include_str!("../../../examples/crazyflie_datasheet.toml");
    std::fs::write(&sheet, example).unwrap();
    stdout_of(&["model", "--datasheet", text(&sheet), "--out", text(&model)]);
    assert_eq!(json(&["model", text(&model), "--json"])["vertical"]["default"], "motors");
    let ran = run(&["fly", "--seconds", "2", "--model", text(&model)]);
    assert!(ran.code == 0 && ran.out.contains("model my-crazyflie"), "{}{}", ran.out, ran.err);
    std::fs::write(&sheet, example.replace("lag_s", "# lag_s")).unwrap();
    let args = ["model", "--datasheet", text(&sheet)];
    assert_fails(1, &args, &[text(&sheet), "there is no motor.lag_s (time constant of a motor)"]);
}

#[cfg(unix)]
#[test]
fn the_demonstration_has_a_page_and_next_steps() {
    use std::io::BufRead;
    let mut child = std::process::Command::new(crate::common::BINARY)
        .args(["demo", "--no-browser", "--json"])
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    std::io::BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let told: serde_json::Value = serde_json::from_str(&line).unwrap();
    let steps = 2 + usize::from(cfg!(feature = "bench"));
    assert_eq!(told["next_steps"].as_array().unwrap().len(), steps, "{told}");
    let address = told["url"].as_str().unwrap().strip_prefix("http://").unwrap().parse().unwrap();
    let (head, body) = crate::net::get(address, "/");
    assert!(head.starts_with("HTTP/1.1 200") && String::from_utf8_lossy(&body).contains("<script"), "{head}");
    let (head, _) = crate::net::get(address, "/api/v1/scenarios");
    assert_eq!(head.starts_with("HTTP/1.1 200"), cfg!(feature = "bench"), "{head}");
    let pid = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    assert!(child.wait().unwrap().success());
}

#[test]
fn vehicles_are_taken_by_name() {
    let listed = json(&["vehicles", "--json"]);
    let names: Vec<&str> =
        listed.as_array().unwrap().iter().map(|each| each["name"].as_str().unwrap()).collect();
    assert_eq!(names[0], "cf2-thesis");
    for name in names {
        let flown = json(&["fly", "hover", "--vehicle", name, "--seconds", "1", "--json"]);
        assert_eq!(flown["setup"]["model"], name);
        assert_eq!(json(&["model", name, "--json"])["name"], name);
    }
    let text = stdout_of(&["vehicles"]);
    assert!(text.contains("cf21-brushless\n") && text.contains("43.4 g, 50 mm to a motor"), "{text}");
    assert_fails(
        1,
        &["fly", "--model", "cf21-brushles"],
        &["no such file", "did you mean \"cf21-brushless\""],
    );
}

#[test]
fn a_task_has_one_name_and_its_id() {
    let setup =
        |args: &[&str]| json(&[args, &["--seconds", "1", "--json"]].concat())["setup"]["flight"].clone();
    assert_eq!(setup(&["fly", "--task", "CrazyflieTrack-v0"]), "track");
    assert_eq!(setup(&["fly", "track"]), "track");
    let words = ["did you mean \"drag_linear\" or \"drag_quadratic\""];
    assert_fails(2, &["fly", "--effects", "drag=0.3"], &words);
}

#[test]
fn a_flight_is_filmed() {
    let folder = folder("film");
    let file = folder.join("hover.gif");
    stdout_of(&["fly", "--seconds", "0.5", "--film", text(&file)]);
    let bytes = std::fs::read(&file).unwrap();
    assert!(bytes.starts_with(b"GIF89a"));
    // a graphic control block before each of ten frames and that of the start
    let frames = bytes
        .windows(4)
        .filter(|block| *block == [0x21, 0xf9, 4, 0x04] || *block == [0x21, 0xf9, 4, 0x00])
        .count();
    assert!((10..=12).contains(&frames), "{frames}");
    assert_fails(2, &["fly", "--film", "hover.avi"], &[".gif, .webp, .mp4"]);
}
