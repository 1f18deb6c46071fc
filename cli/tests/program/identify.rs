//! Identification from the command line, on flights that the simulator records.

use crate::common::{assert_fails, folder, json, recordings, stdout_of, text};

/// Two recordings of the 80 cm flight, which moves pitch and height but neither roll nor yaw.
fn flights(test: &str) -> (String, String, std::path::PathBuf) {
    let folder = folder(test);
    let fly = |name: &str, task: &str| {
        let file = folder.join(name);
        stdout_of(&["fly", "--task", task, "--seconds", "8", "--csv", text(&file)]);
        text(&file).to_owned()
    };
    (fly("a.csv", "fly-80cm"), fly("b.csv", "height-step"), folder)
}

#[test]
fn a_transfer_function_comes_back() {
    let (a, b, folder) = flights("identify-transfer");
    let (svg, model) = (folder.join("pitch.svg"), folder.join("new.toml"));
    let args =
        ["identify", "--transfer", "pitch", "--fit", &a, "--picture", text(&svg), "--out", text(&model)];
    let out = stdout_of(&args);
    assert!(out.contains("123.2 / (s^2 + 31.86 s + 81.85") && out.contains("standard error"), "{out}");
    assert!(std::fs::read_to_string(&svg).unwrap().contains("autocorrelation"));
    let written = std::fs::read_to_string(&model).unwrap();
    assert!(written.contains("identified from a: standard error"), "{written}");
    stdout_of(&["fly", "--model", text(&model), "--seconds", "1"]);
    // the best order first, and the other log to judge by
    let all = json(&[
        "identify",
        "--transfer",
        "pwm",
        "--order",
        "0,1",
        "--order",
        "0,2",
        "--fit",
        &b,
        "--test",
        &a,
        "--json",
    ]);
    let best = &all["transfer_functions"][0];
    let numbers = best["denominator"].as_array().unwrap();
    assert_eq!(numbers.len(), 2, "{best}");
    // a second order leaves a pole and a zero that cancel
    assert!(all["failed"][0].as_str().unwrap().contains("order 0,2: b0"), "{}", all["failed"]);
    assert!((numbers[1].as_f64().unwrap() - 0.6123).abs() < 0.01, "{best}");
    assert!(best["fit"]["logs"][0]["whole"]["fit_percent"].as_f64().unwrap() > 99.0, "{best}");
    assert_eq!(best["test"]["logs"][0]["log"], "a");
    assert!(best["test"]["residuals"]["z"]["whiteness"]["p_value"].is_number(), "{best}");
}

#[test]
fn numbers_of_a_model_come_back() {
    let (a, b, folder) = flights("identify-model");
    let (start, found) = (folder.join("start.toml"), folder.join("found.toml"));
    let thesis = stdout_of(&["model", "--show"]);
    // the first is roll's, which these flights do not move
    let wrong: Vec<String> = thesis.splitn(3, "value = 31.86").map(str::to_owned).collect();
    std::fs::write(&start, wrong.join("value = 25.0")).unwrap();
    let args =
        ["identify", text(&start), "--vertical", "pwm", "--fit", &a, "--test", &b, "--out", text(&found)];
    let out = stdout_of(&args);
    assert!(out.contains("pitch.damping") && !out.contains("roll.gain"), "{out}");
    let mut args: Vec<&str> = args.to_vec();
    args.push("--json");
    let all = json(&args);
    let damping =
        all["parameters"].as_array().unwrap().iter().find(|p| p["name"] == "pitch.damping").unwrap();
    assert!((damping["value"].as_f64().unwrap() - 31.86).abs() < 0.05, "{damping}");
    assert!(std::fs::read_to_string(&found).unwrap().contains("identified from a: standard error"));
    let again = stdout_of(&["replay", text(&found), &a, "--vertical", "pwm"]);
    assert!(again.contains("pitch"), "{again}");
}

#[test]
fn what_cannot_be_told_is_named() {
    let (a, _, folder) = flights("identify-errors");
    assert_fails(2, &["identify"], &["--fit"]);
    assert_fails(2, &["identify", "--transfer", "rol", "--fit", &a], &["did you mean \"roll\""]);
    assert_fails(
        2,
        &["identify", "--transfer", "pitch", "--order", "3,2", "--fit", &a],
        &["3,2", "less than"],
    );
    assert_fails(2, &["identify", "--transfer", "pitch", "--order", "two", "--fit", &a], &["0,2"]);
    assert_fails(2, &["identify", "--free", "pitch.gian", "--fit", &a], &["did you mean \"pitch.gain\""]);
    assert_fails(2, &["identify", "--window", "0.1", "--fit", &a], &["0.5", "whole"]);
    assert_fails(1, &["identify", "--transfer", "roll", "--fit", &a], &["roll command does not move"]);
    assert_fails(
        1,
        &["identify", "--free", "roll.gain", "--fit", &a],
        &["roll command does not move", "roll.gain"],
    );
    assert_fails(
        1,
        &["identify", "--free", "vehicle.mass", "--fit", &a],
        &["vehicle.mass", "equations of motion"],
    );
    assert_fails(
        1,
        &["identify", "--free", "vertical.height.gain", "--fit", &a],
        &["vertical.height.gain", "thrust"],
    );
    assert_fails(1, &["identify", "--fit", "no/such.csv"], &["no/such.csv"]);
    let short = folder.join("short.csv");
    stdout_of(&["fly", "--seconds", "0.5", "--csv", text(&short)]);
    assert_fails(
        1,
        &["identify", "--transfer", "pitch", "--fit", text(&short)],
        &["short", "expected at least 1.0 s"],
    );
}

/// A real vehicle: no truth, but a fit that also holds on a flight of another day.
#[test]
fn a_real_roll_is_found() {
    let Some(folder) = recordings("a_real_roll_is_found", "nanobench") else { return };
    let [fit, test] =
        ["B3_figure8_medium_rep2.csv.gz", "B3_figure8_slow_rep1.csv.gz"].map(|f| folder.join(f));
    let args = [
        "identify",
        "--transfer",
        "roll",
        "--offset",
        "each",
        "--fit",
        text(&fit),
        "--test",
        text(&test),
        "--json",
    ];
    let found = &json(&args)["transfer_functions"][0];
    let fit_of = |part: &str| found[part]["logs"][0]["whole"]["fit_percent"].as_f64().unwrap();
    assert!(fit_of("fit") > 80.0 && fit_of("test") > 65.0, "{found}");
    assert_fails(
        1,
        &["identify", "--transfer", "yaw", "--fit", text(&fit)],
        &["B3_figure8_medium_rep2", "no yaw-rate command"],
    );
}
