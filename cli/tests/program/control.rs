//! Controllers, their tuner and their stability, from the command line.

use crate::common::{assert_fails, folder, json, stdout_of, text};
use serde_json::Value;

#[test]
fn the_list_says_what_fly_and_submit_know() {
    let all = json(&["controllers", "--json"]);
    let names: Vec<&str> = all.as_array().unwrap().iter().map(|c| c["name"].as_str().unwrap()).collect();
    let listed = stdout_of(&["controllers"]);
    for name in &names {
        assert!(listed.contains(name), "{name}");
    }
    for name in names
        .iter()
        .filter(|name| all.as_array().unwrap().iter().any(|c| c["name"] == **name && c["file"].is_null()))
    {
        let flown = json(&["fly", "--controller", name, "--seconds", "1", "--json"]);
        assert_eq!(flown["setup"]["controller"], **name);
    }
    assert_fails(2, &["fly", "--controller", "lqx"], &["did you mean \"lqr\""]);
    assert_fails(
        2,
        &["fly", "--controller", "lqr", "--controller-options", "{\"position\": 1}"],
        &["controller lqr", "position"],
    );
    assert_fails(
        2,
        &["fly", "--controller", "lqr", "--controller-options", "{"],
        &["--controller-options is not JSON"],
    );
}

#[test]
fn the_tuner_explains_table_7_1_and_finds_better_gains_that_fly() {
    let folder = folder("tuned");
    let (gains, picture) = (folder.join("gains.json"), folder.join("steps.svg"));
    let report = json(&["tune", "--out", text(&gains), "--picture", text(&picture), "--json"]);
    let loops = report["loops"].as_array().unwrap();
    assert_eq!(loops.len(), 4);
    for l in loops {
        let number = |of: &str, part: &str, name: &str| l[of][part][name].as_f64();
        let [old, new, found] = ["crazyflie_ros", "table_7_1", "tuned"];
        let error = |of: &str| number(of, "response", "error_s").unwrap();
        println!(
            "{}: error {:.2}, {:.2}, {:.2} s; phase margin {:?}, {:?}, {:?} deg",
            l["loop"],
            error(old),
            error(new),
            error(found),
            number(old, "margins", "phase_deg"),
            number(new, "margins", "phase_deg"),
            number(found, "margins", "phase_deg")
        );
        // the height is judged on every form, which the next test flies
        assert!(l["loop"] == "z" || error(found) <= error(new), "{l}");
        if l["loop"] == "x" || l["loop"] == "y" {
            assert!(
                number(old, "margins", "phase_deg").unwrap() < 0.0
                    && number(new, "margins", "phase_deg").unwrap() > 0.0,
                "{l}"
            );
            assert!(
                number(found, "margins", "phase_deg").unwrap() > 25.0
                    && number(found, "response", "overshoot").unwrap() < 0.1,
                "{l}"
            );
        }
    }
    assert!(std::fs::read_to_string(&picture).unwrap().contains("table 7.1"));
    let flights = |controller: &str| {
        json(&[
            "fly",
            "--task",
            "fly-80cm",
            "--sensors",
            "lab",
            "--runs",
            "20",
            "--json",
            "--controller",
            controller,
        ])
    };
    let rmse = |flown: &Value| {
        let runs = flown["runs"].as_array().unwrap();
        let mut all: Vec<f64> =
            runs.iter().map(|r| r["phases"][0]["axes"]["x"]["rmse"].as_f64().unwrap()).collect();
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    };
    let (thesis, tuned) = (rmse(&flights("thesis-pid")), rmse(&flights(&format!("pid:{}", text(&gains)))));
    println!("80 cm: RMS error in x {thesis:.1} cm with table 7.1, {tuned:.1} cm tuned");
    assert!(tuned < thesis);
}

/// Margins and step figures of every loop, as text, as JSON and as a picture of each format.
#[test]
fn loops_are_plotted_with_their_margins_and_figures() {
    let folder = folder("plots");
    let reports = json(&["plot", "--vertical", "thrust", "--json"]);
    let names: Vec<&str> = reports.as_array().unwrap().iter().map(|r| r["loop"].as_str().unwrap()).collect();
    assert_eq!(names, ["yaw", "z", "x", "y"]);
    for report in reports.as_array().unwrap() {
        assert!(report["margins"]["phase_deg"].as_f64().unwrap() > 0.0, "{}", report["margins"]);
        assert!(report["step"]["figures"]["overshoot"].as_f64().unwrap() >= 0.0);
    }
    for ending in ["svg", "png", "pdf"] {
        let file = folder.join(format!("loops.{ending}"));
        let listed = stdout_of(&["plot", "--picture", text(&file)]);
        assert!(
            names.iter().all(|name| listed.contains(name)) && listed.contains("phase margin"),
            "{listed}"
        );
        assert!(std::fs::metadata(&file).unwrap().len() > 10_000, "{ending}");
    }
    let svg = folder.join("z.svg");
    stdout_of(&["plot", "--loop", "z", "--vertical", "thrust", "--picture", text(&svg)]);
    let drawn = std::fs::read_to_string(&svg).unwrap();
    for words in ["loop gain (dB)", "Nyquist", "root locus", "overshoot"] {
        assert!(drawn.contains(words), "{words}");
    }
    assert_fails(2, &["plot", "--loop", "zz"], &["unknown loop", "did you mean"]);
    assert_fails(2, &["plot", "--loop", "z", "--vertical", "height"], &["pwm or thrust"]);
    assert_fails(2, &["plot", "--sensors", "labs"], &["\"lab\""]);
    assert_fails(1, &["plot", "--gains", "nowhere.json"], &["nowhere.json"]);
}

/// 5.4 has no inertia, so gains that only it judged crashed on the thrust form.
#[test]
fn what_the_tuner_writes_takes_off_on_every_vertical_form() {
    let folder = folder("tuned-forms");
    for tuned_on in ["height", "thrust"] {
        let gains = folder.join(format!("{tuned_on}.json"));
        let report = json(&["tune", "--vertical", tuned_on, "--out", text(&gains), "--json"]);
        assert_eq!(report["forms"].as_array().unwrap().len(), 3, "{}", report["forms"]);
        // the height loop once had 2.3 dB, and travelled nine times its range in a second
        for margins in
            report["forms"].as_array().unwrap().iter().flat_map(|form| form["margins"].as_object().unwrap())
        {
            let margin = |name: &str| margins.1[name].as_f64().unwrap_or(f64::INFINITY);
            assert!(margin("phase_deg") >= 30.0 && margin("gain_db") >= 6.0, "{tuned_on}: {margins:?}");
        }
        let z = report["loops"].as_array().unwrap().iter().find(|l| l["loop"] == "z").unwrap();
        assert!(z["tuned"]["response"]["travel_per_s"].as_f64().unwrap() < 6.0, "{z}");
        let controller = format!("pid:{}", text(&gains));
        for flown_on in ["height", "pwm", "thrust"] {
            let words = ["fly", "--task", "takeoff-70cm", "--sensors", "lab", "--runs", "16", "--json"];
            let own = ["--controller", &controller, "--vertical", flown_on];
            let flown = json(&[&words[..], &own].concat());
            for run in flown["runs"].as_array().unwrap() {
                let z = &run["phases"][0]["axes"]["z"];
                assert!(run["crash"].is_null(), "tuned on {tuned_on}, flown on {flown_on}: {run}");
                assert!(z["final_error"].as_f64().unwrap() < 5.0, "tuned on {tuned_on}, on {flown_on}: {z}");
            }
        }
    }
}

#[test]
fn the_tuner_writes_nothing_that_a_form_does_not_stand_and_says_what_no_form_shows() {
    let folder = folder("tuned-refused");
    let model = stdout_of(&["model", "--show"]);
    let written = |name: &str, text: &str| {
        let path = folder.join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    // this vehicle hovers at nearly its full thrust
    let (before, thrust) = model.split_once("[vertical.thrust").unwrap();
    let heavy = format!("{before}[vertical.thrust{}", thrust.replacen("39342.5", "59900.0", 1));
    assert_ne!(heavy, model);
    let (heavy, gains) = (written("heavy.toml", &heavy), folder.join("gains.json"));
    assert_fails(
        1,
        &["tune", "--model", text(&heavy), "--out", text(&gains)],
        &["no gains are written", "on the form thrust", "take-off"],
    );
    assert!(!gains.exists());
    let rest = thrust.find("[command").unwrap();
    let first_order = written("first_order.toml", &format!("{before}{}", &thrust[rest..]));
    assert_fails(
        1,
        &["tune", "--model", text(&first_order), "--gain-margin", "80", "--out", text(&gains)],
        &["no gains are written", "dB of gain margin, expected 30 and 80 at least"],
    );
    assert!(!gains.exists());
    let report = json(&["tune", "--model", text(&first_order), "--out", text(&gains), "--json"]);
    assert!(report["warnings"][0].as_str().unwrap().contains("vertical.pwm is of first order"), "{report}");
    assert!(gains.exists());
}
