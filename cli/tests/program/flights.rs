//! Flights: figures, determinism, and the way through a log and back.

use crate::common::{assert_fails, folder, json, recordings, stdout_of, text};
use serde_json::Value;

/// Fits in percent of the first run of a replay, by signal.
fn fit(replay: &Value, signal: &str) -> f64 {
    replay["logs"][0]["runs"][0]["signals"][signal]["fit_percent"].as_f64().unwrap()
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let folder = folder("deterministic");
    let args = [
        "fly",
        "--task",
        "hover",
        "--sensors",
        "lab",
        "--effects",
        "gust.sigma_mps2=0.3",
        "--seconds",
        "3",
        "--seed",
    ];
    let fly = |seed: &str, name: &str| {
        let files = [".csv", ".svg", ".3d.svg"].map(|ending| folder.join(format!("{name}{ending}")));
        let [csv, svg, path] = &files;
        let more = [seed, "--csv", text(csv), "--picture", text(svg), "--picture3d", text(path)];
        let out = stdout_of(&[&args[..], &more].concat());
        (out, files.map(|file| std::fs::read(file).unwrap()))
    };
    let (first, second, other) = (fly("7", "a"), fly("7", "b"), fly("8", "c"));
    assert_eq!(first, second);
    assert_ne!(first.1[0], other.1[0]);
}

#[test]
fn a_run_of_a_batch_is_the_run_alone() {
    let of = |seed: &str, runs: &str| {
        json(&["fly", "--sensors", "lab", "--seconds", "3", "--json", "--seed", seed, "--runs", runs])
    };
    let batch = of("3", "70");
    assert_eq!(batch["runs"].as_array().unwrap().len(), 70);
    for (i, seed) in [(0, "3"), (17, "20"), (69, "72")] {
        assert_eq!(batch["runs"][i], of(seed, "1")["runs"][0], "seed {seed}");
    }
    let table = stdout_of(&["fly", "--runs", "5", "--seconds", "3"]);
    assert!(
        table.contains("5 flights: median (first to third quartile)") && table.contains("crashed: 0 of 5"),
        "{table}"
    );
}

#[test]
fn a_flight_replayed_on_its_own_model_fits() {
    let folder = folder("round_trip");
    let log = folder.join("flight.csv");
    let forms = [
        ("pwm", "fly-80cm"),
        ("thrust", "fly-80cm"),
        ("height", "fly-80cm"),
        ("pwm", "takeoff-70cm"),
        ("thrust", "track"),
    ];
    for (form, task) in forms {
        // turned a little, so that every axis has something to do
        let options = if task == "fly-80cm" {
            "{\"start_m\": [0.8, -0.3, 0.6], \"setpoint_yaw_deg\": 30, \"start_yaw_deg\": 20}"
        } else {
            "null"
        };
        stdout_of(&[
            "fly",
            "--task",
            task,
            "--task-options",
            options,
            "--vertical",
            form,
            "--csv",
            text(&log),
        ]);
        let back = json(&["replay", text(&log), "--vertical", form, "--json"]);
        for signal in ["roll", "pitch", "z", "vx", "vy", "x", "y"] {
            let signals = &back["logs"][0]["runs"][0]["signals"][signal];
            match signals["fit_percent"].as_f64() {
                Some(fit) => assert!(fit > 99.0, "{form} {task} {signal}: {fit} %"),
                None => assert!(signals["rmse"].as_f64().unwrap() < 1e-9, "{form} {task} {signal}"),
            }
        }
    }
}

#[test]
fn a_flight_written_as_mcap_replays_as_its_csv() {
    let folder = folder("mcap");
    let logs = ["flight.csv", "flight.mcap"].map(|name| folder.join(name));
    let [csv, mcap] = logs.each_ref().map(|log| {
        stdout_of(&["fly", "--task", "fly-80cm", "--seconds", "5", "--sensors", "lab", "--csv", text(log)]);
        stdout_of(&["replay", text(log)])
    });
    assert!(std::fs::read(&logs[1]).unwrap().starts_with(b"\x89MCAP0"));
    assert_eq!(mcap.replace("flight.mcap", "flight.csv"), csv);
}

#[test]
fn the_csv_has_a_fix_only_where_a_frame_arrived() {
    let folder = folder("fixes");
    let log = folder.join("flight.csv");
    stdout_of(&["fly", "--task", "hover-70cm", "--seconds", "10", "--sensors", "lab", "--csv", text(&log)]);
    let content = std::fs::read_to_string(&log).unwrap();
    let mut lines = content.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let column = |name: &str| header.iter().position(|h| *h == name).unwrap();
    let (t, captured) = (column("t_s"), column("marker_t_s"));
    let rows: Vec<Vec<&str>> = lines.map(|l| l.split(',').collect()).collect();
    assert_eq!(rows.len(), 501);
    let ages: Vec<f64> = rows
        .iter()
        .filter(|r| !r[captured].is_empty())
        .map(|r| r[t].parse::<f64>().unwrap() - r[captured].parse::<f64>().unwrap())
        .collect();
    assert!((298..=301).contains(&ages.len()), "{} fixes in 10 s", ages.len());
    assert!(ages[1..].iter().all(|age| (0.0499..0.0701).contains(age)), "{ages:?}");
}

#[test]
fn the_whole_flight_of_the_thesis_is_flown() {
    let flight = json(&["fly", "--task", "whole-flight", "--json"]);
    let run = &flight["runs"][0];
    assert!(run["crash"].is_null(), "{run}");
    let names: Vec<&str> =
        run["phases"].as_array().unwrap().iter().map(|p| p["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["take off", "fly 80 cm", "land"]);
    let over = |phase: usize, axis: &str| run["phases"][phase]["axes"][axis]["final_error"].as_f64().unwrap();
    assert!(over(0, "z") < 2.0 && over(1, "x") < 2.0 && over(1, "z") < 2.0, "{run}");
}

#[test]
fn a_derived_velocity_and_a_model_of_ones_own() {
    let Some(folder) = recordings("a_derived_velocity_and_a_model_of_ones_own", "hidden_effects") else {
        return;
    };
    let log = folder.join("d00_a.csv.gz");
    let back = json(&["replay", text(&log), "--hover-pwm", "auto", "--horizon", "2", "--json"]);
    let remarks = back["logs"][0]["runs"][0]["remarks"].to_string();
    assert!(
        remarks.contains("derived from the position") && remarks.contains("hover PWM taken as"),
        "{remarks}"
    );
    assert!(fit(&back, "roll") > 85.0 && fit(&back, "pitch") > 85.0 && fit(&back, "x") > 80.0, "{back}");
}

#[test]
fn every_nanobench_flight_is_replayed_as_published() {
    let Some(folder) = recordings("every_nanobench_flight_is_replayed_as_published", "nanobench") else {
        return;
    };
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|f| f.unwrap().path())
        .filter(|f| f.extension().is_some_and(|e| e == "gz"))
        .collect();
    files.sort();
    assert_eq!(files.len(), 18);
    let without_commands = ["B9_trefoil_medium_rep10", "B9_trefoil_slow_rep12"];
    for file in &files {
        if without_commands.iter().any(|name| text(file).contains(name)) {
            assert_fails(1, &["replay", text(file)], &[text(file), "the log holds no commands"]);
            continue;
        }
        for more in [&[][..], &["--hover-pwm", "auto"], &["--measured-yaw-rate"]] {
            let back = json(&[&["replay", text(file), "--json"], more].concat());
            let half_second = &back["logs"][0]["runs"][2]["signals"];
            assert!(
                half_second["x"]["fit_percent"].as_f64().unwrap() > 60.0,
                "{}: {half_second}",
                text(file)
            );
        }
    }
    // all at once: the good ones are reported, the exit code tells of the two others
    let all: Vec<&str> = ["replay"].into_iter().chain(files.iter().map(|f| text(f))).collect();
    let program = crate::common::run(&all);
    assert!(
        program.code == 1
            && program.out.contains("median of 16 flights")
            && program.err.contains("2 of 18 logs"),
        "{}",
        program.err
    );
}

#[test]
fn every_task_flies_by_its_name() {
    let tasks = json(&["tasks", "--json"]);
    for task in tasks["tasks"].as_array().unwrap() {
        let name = task["name"].as_str().unwrap();
        let flown = json(&["fly", "--task", name, "--seconds", "0.5", "--json"]);
        let drones = flown["runs"][0]["drones"].as_array().map_or(1, Vec::len);
        assert_eq!(task["drones"], drones, "{name}");
    }
}

#[test]
fn several_drones_swap_places_unless_nothing_keeps_them_apart() {
    let folder = folder("together");
    let (csv, svg, path) = (folder.join("swap.csv"), folder.join("swap.svg"), folder.join("path.svg"));
    let files = ["--csv", text(&csv), "--picture", text(&svg), "--picture3d", text(&path)];
    let flight = ["fly", "--task", "swap", "--drones", "5", "--json"];
    let apart = json(&[&flight[..], &["--collision-avoidance"], &files].concat());
    let metrics = &apart["runs"][0]["metrics"];
    assert!(metrics["collisions"] == 0.0 && metrics["done"] == 5.0, "{metrics}");
    assert!(apart["setup"]["effects"]["downwash"].is_number(), "{}", apart["setup"]);
    for drone in 0..5 {
        let log = folder.join(format!("swap-{drone}.csv"));
        stdout_of(&["replay", text(&log)]);
    }
    assert!([svg, path].iter().all(|file| std::fs::read_to_string(file).unwrap().contains("drone 4")));
    assert!(json(&flight)["runs"][0]["metrics"]["collisions"].as_f64().unwrap() > 0.0);
    let advice = stdout_of(&["fly", "--task", "swap", "--runs", "3"]);
    assert!(
        advice.contains("3 flights: median") && advice.contains("--collision-avoidance puts a layer"),
        "{advice}"
    );
    assert_fails(2, &["fly", "--collision-avoidance"], &["for tasks of several drones"]);
    assert_fails(2, &["fly", "--task", "swap", "--drones", "65"], &["drones is 65"]);
}

#[test]
fn a_picture_is_what_its_ending_says() {
    let folder = folder("endings");
    for (ending, begins) in [("svg", &b"<svg"[..]), ("png", b"\x89PNG"), ("PDF", b"%PDF")] {
        for option in ["--picture", "--picture3d"] {
            let file = folder.join(format!("{}.{ending}", &option[2..]));
            stdout_of(&["fly", "--seconds", "1", option, text(&file)]);
            assert!(std::fs::read(&file).unwrap().starts_with(begins), "{option} {ending}");
        }
    }
    for file in ["x.jpg", "x"] {
        assert_fails(2, &["fly", "--picture", file], &[".svg, .png, .pdf"]);
    }
}

#[test]
fn a_task_file_flies() {
    let folder = folder("own_task");
    let file = folder.join("climb.toml");
    let content = r#"
name = "climb"
about = "Up from the floor"
reward = "1"
termination = "pos_m[2] > 1.2"
max_episode_steps = 300
vertical = "thrust"
[task_options]
start_m = [0, 0, 0]
setpoint_m = [0, 0, 1.5]
[effects]
gust = { sigma_mps2 = 0.1 }
"#;
    std::fs::write(&file, content).unwrap();
    let fly = |more: &[&str]| json(&[&["fly", "--task", text(&file), "--json"], more].concat());
    let flown = fly(&[]);
    let (setup, run) = (&flown["setup"], &flown["runs"][0]);
    assert!(
        setup["flight"] == "climb" && setup["vertical"] == "thrust" && setup["seconds"] == 6.0,
        "{setup}"
    );
    assert!(setup["effects"]["gust"]["sigma_mps2"] == 0.1, "{setup}");
    // a reward of 1 each of the 50 steps of a second, until it is through 1.2 m
    let end_s = run["end_s"].as_f64().unwrap();
    assert!(end_s < 5.0 && run["crash"].is_null(), "{run}");
    assert!((run["reward"].as_f64().unwrap() - 50.0 * end_s).abs() < 1e-6, "{run}");
    // options of the command line override those of the file
    let low =
        fly(&["--task-options", "{\"setpoint_m\": [0, 0, 0.5]}", "--seconds", "2", "--vertical", "pwm"]);
    assert!(low["setup"]["vertical"] == "pwm" && low["runs"][0]["end_s"] == 2.0, "{low}");
    let said = stdout_of(&["fly", "--task", text(&file)]);
    assert!(said.contains("climb: Up from the floor") && said.contains("ended by the task"), "{said}");
    std::fs::write(&file, "name = \"x\"\nrewrd = \"1\"").unwrap();
    assert_fails(1, &["fly", "--task", text(&file)], &["climb.toml", "rewrd", "did you mean \"reward\""]);
    assert_fails(1, &["fly", "--task", "nowhere.toml"], &["nowhere.toml"]);
}

#[test]
fn actions_may_be_set_points() {
    let folder = folder("action_levels");
    let svg = folder.join("flight.svg");
    for (level, word) in [("velocity", "x_mps"), ("position", "x_m")] {
        let flown = ["fly", "--action", level, "--controller", "random", "--seconds", "2"];
        let drawn = json(&[&flown[..], &["--picture", text(&svg), "--json"]].concat());
        assert_eq!(drawn["setup"]["action"], level);
        let picture = std::fs::read_to_string(&svg).unwrap();
        assert!(picture.contains(word) && picture.contains("set-points of actions"), "{level}");
        // commands of the cascade are not known outside
        assert_fails(2, &[&flown[..], &["--csv", "x.csv"]].concat(), &["--csv", level, "cascade"]);
        assert!(stdout_of(&flown).contains(&format!("set-point of {level}")));
        let refused = ["fly", "--action", level];
        assert_fails(2, &refused, &["thesis-pid commands attitudes", level, "--action attitude"]);
    }
    assert_fails(2, &["fly", "--action", "velocty"], &["did you mean \"velocity\""]);
    let levels = json(&["actions", "--json"]);
    let names: Vec<_> =
        levels.as_array().unwrap().iter().map(|level| level["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["attitude", "velocity", "position", "body_rates", "motors"]);
    assert!(stdout_of(&["actions"]).contains(".x_mps [m/s], -1 to 1"));
    assert_fails(1, &["actions", "--model", "nowhere.toml"], &["nowhere.toml"]);
}

#[test]
fn a_track_of_ones_own_flies() {
    let folder = folder("own_track");
    let file = folder.join("way.csv");
    std::fs::write(&file, "t_s,x_m,y_m,z_m\n0,0,0,0.7\n4,0.5,0,0.7\n8,0.5,0.5,1\n").unwrap();
    let flown = json(&["fly", "--task", "track", "--track", text(&file), "--seconds", "15", "--json"]);
    let axes = &flown["runs"][0]["phases"][0]["axes"];
    for axis in ["x", "y", "z"] {
        assert!(axes[axis]["final_error"].as_f64().unwrap() < 6.0, "{axes}");
    }
    assert_fails(2, &["fly", "--track", text(&file)], &["--track is for the task track"]);
    std::fs::write(&file, "t_s,x_m,y_m,z_m\n0,0,0,far\n").unwrap();
    let bad = ["fly", "--task", "track", "--track", text(&file)];
    assert_fails(2, &bad, &["way.csv, line 2", "column z_m is \"far\""]);
}

#[test]
fn a_goal_is_drawn_for_every_run() {
    let goal = |seed: &str| {
        let options = "{\"setpoint_m\": {\"uniform\": [[-1, -1, 0.5], [1, 1, 1.5]]}}";
        let folder = folder(&format!("drawn_goal_{seed}"));
        let csv = folder.join("flight.csv");
        stdout_of(&[
            "fly",
            "--task-options",
            options,
            "--seed",
            seed,
            "--seconds",
            "0.1",
            "--csv",
            text(&csv),
        ]);
        let log = std::fs::read_to_string(&csv).unwrap();
        let mut lines = log.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
        let (header, row) = (lines.next().unwrap(), lines.next().unwrap());
        let value = |name: &str| row[header.iter().position(|h| h == name).unwrap()].parse::<f64>().unwrap();
        ["setpoint_x_m", "setpoint_y_m", "setpoint_z_m"].map(value)
    };
    assert_eq!(goal("4"), goal("4"));
    assert!(goal("4").iter().zip(goal("5")).all(|(a, b)| *a != b));
}

/// Chapter 5's flights have names: the attitude follows 5.1 without any controller, the height 5.3.
#[test]
fn steps_of_chapter_5_fly_by_their_names() {
    let folder = folder("flights-steps");
    for (name, column, at_s, expected, tolerance) in [
        // 5.1 for 7.5 degrees, 1.9 and 1.1 s after the step: 11.289 (1 - 1.1076 exp(-2.821 t))
        ("pitch-step", "true_pitch_deg", 11.9, 11.230, 0.01),
        ("roll-step", "true_roll_deg", 11.1, 10.727, 0.01),
        // the thesis's Crazyflie turns the other way
        ("yaw-turn", "true_yaw_deg", 12.5, -90.0, 1.0),
        ("height-command", "true_z_m", 14.9, 0.8 * 1.615 / 1.592, 0.005),
    ] {
        let file = folder.join(format!("{name}.csv"));
        let out = stdout_of(&["fly", name, "--csv", text(&file)]);
        assert!(out.contains("controller hover"), "{out}");
        let rows = std::fs::read_to_string(&file).unwrap();
        let mut lines = rows.lines();
        let header: Vec<&str> = lines.next().unwrap().split(',').collect();
        let place = |name: &str| header.iter().position(|cell| *cell == name).unwrap();
        let number =
            |line: &str, name: &str| line.split(',').nth(place(name)).unwrap().parse::<f64>().unwrap();
        let line = lines.find(|line| number(line, "t_s") >= at_s).unwrap();
        let value = number(line, column);
        assert!((value - expected).abs() < tolerance, "{name}: {value} for {expected}");
    }
}
