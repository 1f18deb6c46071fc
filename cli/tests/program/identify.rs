//! Identification from the command line, on flights that the simulator records.

use crate::common::{assert_fails, folder, json, recordings, run, stdout_of, text};

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

/// A real vehicle: no truth, but a fit that is also valid on a flight of another day.
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
    let roll = &json(&args)["transfer_functions"][0];
    let fit_of = |part: &str| roll[part]["logs"][0]["whole"]["fit_percent"].as_f64().unwrap();
    assert!(fit_of("fit") > 80.0 && fit_of("test") > 65.0, "{roll}");
    assert_fails(
        1,
        &["identify", "--transfer", "yaw", "--fit", text(&fit)],
        &["B3_figure8_medium_rep2", "no yaw-rate command"],
    );
}

const MAPPING: &str = r#"frame = "z-up"
position = "motion_capture"
attitude = "motion_capture"
time = { column = "t", unit = "s" }
[channels]
x = { column = "x", unit = "m" }
y = { column = "y", unit = "m" }
z = { column = "z", unit = "m" }
roll = { column = "roll", unit = "rad" }
pitch = { column = "pitch", unit = "rad" }
yaw = { column = "yaw", unit = "rad" }
cmd_roll = { column = "roll_cmd", unit = "rad" }
cmd_pitch = { column = "pitch_cmd", unit = "rad" }
cmd_thrust = { column = "share", unit = "fraction" }
"#;

/// A flight of 12 s by an integration of its own: a stiff attitude loop, 2500 / (s^2 + 70 s + 2700), drag 0.4 1/s,
/// no damping of climb. `shake_rad` is an angle that gusts add at each of three frequencies.
fn stiff_flight(folder: &std::path::Path, seed: u32, rate_hz: f64, shake_rad: f64) -> String {
    let (steps, w) = (5, 1.3 + 0.17 * f64::from(seed));
    let dt_s = 1.0 / rate_hz / f64::from(steps);
    let mut rows = "t,x,y,z,roll,pitch,yaw,roll_cmd,pitch_cmd,share\n".to_owned();
    let (mut p, mut v, mut angle, mut rate) = ([0.0, 0.0, 1.0], [0.0; 3], [0.0_f64; 2], [0.0; 2]);
    let (mut command, mut thrust, mut state) = ([0.0; 2], 1.0, u64::from(seed));
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    for i in 0..(12.0 * rate_hz) as i32 * steps {
        let t = f64::from(i) * dt_s;
        let target = [0.7 * (w * t).sin(), 0.5 * (2.0 * w * t).sin(), 1.0 + 0.15 * (0.8 * w * t).sin()];
        let speed = [0.7 * w * (w * t).cos(), w * (2.0 * w * t).cos(), 0.12 * w * (0.8 * w * t).cos()];
        if i % steps == 0 {
            let a: [f64; 3] = std::array::from_fn(|k| 4.0 * (target[k] - p[k]) + 3.0 * (speed[k] - v[k]));
            command = [-a[1] / 9.81, a[0] / 9.81].map(|u: f64| u.clamp(-0.35, 0.35));
            thrust = 1.0 + a[2] / 9.81;
            let place = p.map(|x| x + 0.001 * noise());
            let tilt = angle.map(|x| x + 0.003 * noise());
            let numbers = [&[t], &place[..], &tilt[..], &[0.0], &command[..], &[0.5 * thrust]].concat();
            let row: Vec<String> = numbers.iter().map(|x| format!("{x:.7}")).collect();
            rows += &(row.join(",") + "\n");
        }
        // three frequencies, so that no loop resonates with all
        let gust = [(8.8, 1.0), (5.3, 2.0), (13.7, 3.0)].map(|(w, phase): (f64, f64)| (w * t + phase).sin());
        let gust = 2700.0 * shake_rad * gust.iter().sum::<f64>();
        for k in 0..2 {
            rate[k] += dt_s * (2500.0 * command[k] - 70.0 * rate[k] - 2700.0 * angle[k] + gust);
            angle[k] += dt_s * rate[k];
        }
        let (lift, [roll, pitch]) = (9.81 * thrust, angle);
        let acc = [
            lift * roll.cos() * pitch.sin() - 0.4 * v[0],
            -lift * roll.sin() - 0.4 * v[1],
            lift * roll.cos() * pitch.cos() - 9.81,
        ];
        for k in 0..3 {
            v[k] += dt_s * acc[k];
            p[k] += dt_s * v[k];
        }
    }
    let file = folder.join(format!("stiff{seed}.csv"));
    std::fs::write(&file, rows).unwrap();
    std::fs::write(folder.join("mapping.toml"), MAPPING).unwrap();
    text(&file).to_owned()
}

/// From the thesis's numbers the drag was 2.7 1/s with exit status 0. Logs of 250 and 252 Hz were refused together.
/// The damping of climb stayed at the thesis's 1.2 1/s.
#[test]
fn a_stiff_loop_is_found_from_the_thesis_at_two_rates() {
    let folder = folder("identify-stiff");
    let logs = [250.0, 252.0, 250.0, 252.0];
    let logs: Vec<String> =
        (1..).zip(logs).map(|(seed, rate_hz)| stiff_flight(&folder, seed, rate_hz, 0.0)).collect();
    let answer = json(
        &[&["identify", "--json", "--fit"][..], &logs.iter().map(String::as_str).collect::<Vec<_>>()]
            .concat(),
    );
    let value = |name: &str| {
        let all = answer["parameters"].as_array().unwrap();
        all.iter().find(|p| p["name"] == name).and_then(|p| p["value"].as_f64()).expect(name)
    };
    assert!((value("lateral.drag") - 0.4).abs() < 0.03, "{answer}");
    assert!((value("roll.gain") / value("roll.stiffness") - 2500.0 / 2700.0).abs() < 0.01, "{answer}");
    assert!(value("roll.stiffness") > 1500.0 && value("vertical.thrust.heave") < 0.1, "{answer}");
    assert_eq!(answer["unexplained"], serde_json::json!([]));
}

/// A model that leaves most of the attitude was written, with exit status 0.
#[test]
fn a_model_that_leaves_the_attitude_is_not_written() {
    let folder = folder("identify-unexplained");
    let (log, model) = (stiff_flight(&folder, 1, 100.0, 0.3), folder.join("found.toml"));
    let program = run(&["identify", "--fit", &log, "--out", text(&model)]);
    assert_eq!(program.code, 1, "{}", program.out);
    let first = program.out.lines().next().unwrap();
    assert!(first.contains("attitude stays unexplained") && first.contains("the fit of"), "{first}");
    assert!(program.err.contains("--free") && !model.exists(), "{}", program.err);
    // numbers that have nothing to do with it are found all the same
    stdout_of(&["identify", "--fit", &log, "--free", "lateral.drag", "--out", text(&model)]);
    assert!(model.exists());
}

/// The model's mass stayed in silence.
#[test]
fn what_no_fit_finds_is_said() {
    let folder = folder("identify-mass");
    let log = stiff_flight(&folder, 2, 100.0, 0.0);
    let out = stdout_of(&["identify", "--fit", &log]);
    assert!(out.contains("not fitted: motor lag") && out.contains("not fitted: mass, 0.0368 kg"), "{out}");
    let out = stdout_of(&["identify", "--fit", &log, "--mass", "0.027"]);
    assert!(out.contains("vertical.thrust.heave") && !out.contains("not fitted: mass"), "{out}");
}

/// Motors, gyro and accelerometer are needed, and a vehicle that has a motor-level form.
#[test]
fn motor_form_names_the_channel_that_a_log_lacks() {
    let folder = folder("identify-motors");
    let log = stiff_flight(&folder, 3, 100.0, 0.0);
    let program = run(&["identify", "cf21", "--form", "motors", "--fit", &log]);
    assert_eq!(program.code, 1, "{}", program.out);
    assert!(program.err.contains("lacks the PWM of the four motors"), "{}", program.err);
    assert_fails(2, &["identify", "cf21", "--form", "motors", "--trim", "true", "--fit", &log], &["--trim"]);
    // half of full PWM carries 31 g by the thesis's thrust form
    for (mass, is_said) in [("0.0368", false), ("0.06", true)] {
        let program = run(&["identify", "cf2-thesis", "--form", "motors", "--mass", mass, "--fit", &log]);
        assert_eq!(program.err.contains("other motors"), is_said, "{}", program.err);
    }
}

/// The motors drive `cf21`. In a simulated log they get what is commanded; a real one needs them, or a fit by the command.
#[test]
fn a_model_that_motors_drive_names_the_remedy_where_they_are_not_logged() {
    let folder = folder("identify-motorless");
    let (simulated, out) = (folder.join("simulated.csv"), folder.join("out.toml"));
    stdout_of(&["fly", "--vehicle", "cf21", "--seconds", "3", "--csv", text(&simulated)]);
    assert!(stdout_of(&["replay", "cf21", text(&simulated)]).contains("the model hovers at"));
    let log = stiff_flight(&folder, 3, 100.0, 0.0);
    assert_fails(1, &["replay", "cf21", &log], &["no motor PWM", "identify cf21 --pwm-source command"]);
    let args = ["identify", "cf21", "--pwm-source", "command", "--free", "roll.gain", "--fit", &log];
    let answer = json(&[&args[..], &["--json", "--out", text(&out)]].concat());
    assert_eq!(answer["vertical"], "thrust", "{answer}");
}
