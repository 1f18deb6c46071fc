//! Explanations from the command line: flights of our own simulator, the files that are written, and refusals.

use std::path::{Path, PathBuf};

use crate::common::{assert_fails, folder, json, recordings, stdout_of, text};
use serde_json::Value;

/// Effects of imperfect sensors, which make a simulated flight like a measured one.
const SENSORS: [&str; 3] =
    ["camera_noise.xy_m=0.004", "camera_noise.z_m=0.006", "gyro_bias.angle_noise_deg=0.2"];

/// Two flights of a vehicle that the thesis's model declares but for some effects.
fn fly(folder: &Path, effects: &[&str]) -> [PathBuf; 2] {
    fly_by(folder, "thrust", 6, effects)
}

fn fly_by(folder: &Path, vertical: &str, period_s: u32, effects: &[&str]) -> [PathBuf; 2] {
    fly_for("16", folder, vertical, period_s, effects)
}

fn fly_for(seconds: &str, folder: &Path, vertical: &str, period_s: u32, effects: &[&str]) -> [PathBuf; 2] {
    [("a", "1"), ("b", "2")].map(|(name, seed)| {
        let log = folder.join(format!("{name}.csv"));
        let options = format!("{{\"shape\": \"figure_eight\", \"period_s\": {period_s}}}");
        let mut args = vec![
            "fly",
            "--task",
            "track",
            "--task-options",
            &options,
            "--vertical",
            vertical,
            "--seconds",
            seconds,
        ];
        args.extend(["--seed", seed, "--csv", text(&log)]);
        args.extend(SENSORS.iter().chain(effects).flat_map(|e| ["--effects", e]));
        stdout_of(&args);
        log
    })
}

fn thesis(folder: &Path) -> PathBuf {
    let model = folder.join("thesis.toml");
    std::fs::write(&model, stdout_of(&["model", "--show"])).unwrap();
    model
}

fn explain(folder: &Path, [fit, test]: &[PathBuf; 2]) -> Value {
    let (model, out) = (thesis(folder), folder.join("out"));
    json(&["explain", text(&model), "--fit", text(fit), "--test", text(test), "--out", text(&out), "--json"])
}

#[test]
fn a_hidden_drag_is_found_and_written_down() {
    let folder = folder("explain_drag");
    let explanation = explain(&folder, &fly(&folder, &["drag_linear=0.4"]));
    assert_eq!(explanation["verdict"], "explained", "{explanation}");
    let drag =
        explanation["effects"].as_array().unwrap().iter().find(|e| e["name"] == "drag_linear").unwrap();
    let rate = drag["params"]["rate_ps"]["value"].as_f64().unwrap();
    assert!((rate - 0.4).abs() < 0.15 * 0.4 && drag["params"]["rate_ps"]["unit"] == "1/s", "{drag}");
    let error = |when: &str| explanation["error"][when]["velocity_mps"]["2_s"].as_f64().unwrap();
    assert!(error("after") < 0.7 * error("before"), "{}", explanation["error"]);
    // one test flight has one free run: nothing to test
    assert!(explanation["error"]["p_value"]["position_m"]["free_run"].is_null());
    assert_eq!(explanation["error"]["stretches"]["position_m"]["free_run"], 1);
    let out = folder.join("out");
    let written: Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("report.json")).unwrap()).unwrap();
    assert_eq!(written, explanation);
    let model = std::fs::read_to_string(out.join("model.toml")).unwrap();
    assert!(model.contains("[effects.drag_linear") && model.contains("estimated on a.csv"), "{model}");
    stdout_of(&["fly", "--model", text(&out.join("model.toml")), "--vertical", "thrust", "--seconds", "3"]);
    page(&std::fs::read_to_string(out.join("report.html")).unwrap());
}

/// Checks that the page has its parts in the order of their questions, and loads nothing from elsewhere.
fn page(html: &str) {
    let parts = [
        "What is missing",
        "sideways (x, y)",
        "vertical (z)",
        "How sure",
        "drag_linear",
        "How much better",
        "id=\"flights\"",
        "b.csv",
    ];
    let later = ["id=\"freerun\"", "id=\"white\"", "What these flights could not show", "id=\"next\""];
    let mut from = 0;
    for part in parts.into_iter().chain(later) {
        from += html[from..].find(part).unwrap_or_else(|| panic!("{part} is missing after {from}"));
    }
    assert!(!html[from..].contains("<h2"), "the page ends with what to do next");
    for outside in ["http:", "https:", "src=", "<script", "@import", "url("] {
        assert!(!html.contains(outside), "the page refers to {outside}");
    }
    assert!(!html.contains("NaN") && !html.contains("inf "), "numbers that are none");
}

/// A page with its characters as a browser reads them, and the object for machines beside it.
fn written(out: &Path) -> (String, Value) {
    let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    let plain = read("report.html")
        .replace("&#x2f;", "/")
        .replace("&#x27;", "'")
        .replace("&lt;", "<")
        .replace("&gt;", ">");
    (plain, serde_json::from_str(&read("report.json")).unwrap())
}

/// Numbers of a page with their places in the object for machines.
fn numbers(html: &str) -> Vec<(&str, Option<f64>, &str)> {
    let mut all = Vec::new();
    for piece in html.split("<data ").skip(1) {
        let (at, end) = (piece.find("data-json=\"").unwrap(), piece.find("</data>").unwrap());
        let value = piece[..at]
            .split_once("value=\"")
            .map(|(_, rest)| rest.split_once('"').unwrap().0.parse().unwrap());
        let (pointer, rest) = piece[at + 11..end].split_once('"').unwrap();
        all.push((pointer, value, rest.split_once('>').unwrap().1));
    }
    all
}

/// Every number that the page, the object and the model file share is the same in all.
fn same_values(out: &Path) {
    let (html, object) = written(out);
    let shown = numbers(&html);
    assert!(shown.len() > 100, "{}", shown.len());
    for (pointer, value, text) in shown {
        let written = object.pointer(pointer).unwrap_or_else(|| panic!("no {pointer} in report.json"));
        assert_eq!(written.as_f64(), value, "{pointer}, shown as {text}");
        assert_eq!(value.is_none(), text == "-" || text == "too few", "{pointer}: {text}");
    }
    let model = json(&["model", text(&out.join("model.toml")), "--json"]);
    let lists = ["effects", "partial", "corrections"].map(|list| object[list].as_array().unwrap());
    for effect in
        lists.into_iter().flatten().flat_map(|e| [e].into_iter().chain(e["with"].as_array().unwrap()))
    {
        for (param, estimate) in effect["params"].as_object().unwrap() {
            let (name, value) = (effect["name"].as_str().unwrap(), &estimate["value"]);
            assert_eq!(&model["effects"][name][param]["value"], value, "{name}.{param}");
            let as_text = value.as_f64().unwrap().to_string();
            assert!(
                html.contains(&format!("<data value=\"{as_text}\"")),
                "{name}.{param} {as_text} is not on the page"
            );
        }
    }
}

#[test]
fn page_object_and_model_hold_the_same_values_and_every_flight_is_named() {
    let folder = folder("explain_same");
    let [fit, test] = fly(&folder, &["drag_linear=0.4"]);
    let other = folder.join("elsewhere").join("b.csv");
    std::fs::create_dir(folder.join("elsewhere")).unwrap();
    let options = "{\"shape\": \"figure_eight\", \"period_s\": 5}";
    let again = [
        "fly",
        "--task",
        "track",
        "--task-options",
        options,
        "--vertical",
        "thrust",
        "--seconds",
        "22",
        "--seed",
        "9",
    ];
    stdout_of(
        &[
            &again[..],
            &["--csv", text(&other), "--effects", "drag_linear=0.4"],
            &SENSORS.map(|s| ["--effects", s]).concat(),
        ]
        .concat(),
    );
    let (model, out) = (thesis(&folder), folder.join("out"));
    let printed = stdout_of(&[
        "explain",
        text(&model),
        "--fit",
        text(&fit),
        "--test",
        text(&test),
        text(&other),
        "--out",
        text(&out),
    ]);
    same_values(&out);
    let (html, object) = written(&out);
    // two files of one name are told apart by their paths
    for (i, flight) in [&test, &other].into_iter().enumerate() {
        assert!(
            html.contains(&format!("<h3>{}</h3>", flight.display())) && printed.contains(text(flight)),
            "{}",
            flight.display()
        );
        assert_eq!(object["error"]["flights"][i]["name"], text(flight));
    }
    assert_eq!(html.matches("aria-label=\"residual of ").count(), 2 * 6);
    // two free runs are no sample, whatever else is
    assert!(html.contains("too few") && printed.contains("too few"), "{printed}");
    assert_eq!(object["error"]["axes"]["stretches"]["yaw_rad"]["free_run"], 2);
    assert!(object["error"]["axes"]["p_value"]["yaw_rad"]["free_run"].is_null());
    for signal in [
        "sideways (x, y): explained, by drag_linear",
        "vertical (z): nothing missing",
        "tilt (roll, pitch): ",
        "yaw: ",
    ] {
        assert!(printed.contains(signal), "{printed}");
    }
    assert!(printed.contains("what to do next\n1. ") && object["foreign_model"].is_null(), "{printed}");
}

/// Without noise of the IMU a simulator's yaw is predicted to a millionth of a degree, and a share of that has no
/// meaning.
#[test]
fn of_no_error_no_share_is_told() {
    let folder = folder("explain_tiny");
    let [fit, test] = [("a.csv", "1"), ("b.csv", "2")].map(|(name, seed)| {
        let log = folder.join(name);
        let noise = "camera_noise.xy_m=0.003";
        let flight = ["fly", "--task", "track", "--effects", noise, "--seed", seed, "--seconds", "32"];
        stdout_of(&[&flight[..], &["--csv", text(&log)]].concat());
        log
    });
    let out = folder.join("out");
    let printed =
        stdout_of(&["explain", "thesis", "--fit", text(&fit), "--test", text(&test), "--out", text(&out)]);
    let (tiny, (html, _)) = ("no error to speak of, before or after", written(&out));
    assert!(printed.contains(&format!("yaw: nothing missing\n  explained: {tiny}\n")), "{printed}");
    assert!(html.contains(tiny));
    assert!(printed.contains("sideways (x, y): nothing missing\n  explained: 0 % of the error"), "{printed}");
}

/// The thesis's numbers are not those of a recorded vehicle: that is reported before anything else, with the commands
/// to run.
#[test]
fn a_recorded_flight_of_another_vehicle_is_told_at_once() {
    let name = "a_recorded_flight_of_another_vehicle_is_told_at_once";
    let Some(flights) = recordings(name, "nanobench") else { return };
    let [fit, test] =
        ["B8_star_slow_rep1.csv.gz", "B2_circle_slow_rep2.csv.gz"].map(|file| flights.join(file));
    let folder = folder("explain_foreign");
    for vertical in ["thrust", "pwm"] {
        let out = folder.join(vertical);
        let printed = stdout_of(&[
            "explain",
            "thesis",
            "--vertical",
            vertical,
            "--fit",
            text(&fit),
            "--test",
            text(&test),
            "--out",
            text(&out),
        ]);
        let first = printed.lines().take(3).collect::<Vec<_>>();
        let command = format!("crazyflie identify thesis --fit {} --out mine.toml", fit.display());
        // the answer, the doubt about it, and no command before the table
        assert!(first[1].contains("The numbers of the model cf2-thesis are not this vehicle's"), "{printed}");
        assert!(first.iter().all(|line| !line.contains("crazyflie ")), "{printed}");
        let (_, next) = printed.split_once("what to do next").unwrap();
        assert!(next.contains(&command) && next.contains("crazyflie explain mine.toml --fit "), "{printed}");
        let (html, object) = written(&out);
        let (warned, verdict) = (html.find("id=\"foreign\"").unwrap(), html.find("class=\"verdict").unwrap());
        assert!(warned < verdict && html[warned..verdict].contains(&command), "{vertical}");
        assert_eq!(object["foreign_model"]["commands"][0], command.as_str());
        assert_eq!(object["next"][0]["commands"][0], command.as_str());
        same_values(&out);
    }
}

#[test]
fn where_nothing_is_hidden_nothing_is_found() {
    let folder = folder("explain_null");
    let explanation = explain(&folder, &fly_for("32", &folder, "thrust", 6, &[]));
    assert_eq!(explanation["verdict"], "nothing_missing", "{explanation}");
    assert_eq!(explanation["effects"], serde_json::json!([]));
    // half of it is too short for a test: nothing is found either, and that says nothing
    let explanation = explain(&folder, &fly(&folder, &[]));
    assert_eq!(explanation["verdict"], "not_decidable", "{explanation}");
    assert_eq!(explanation["effects"], serde_json::json!([]));
    let signal = &explanation["signals"][0];
    assert_eq!((&signal["state"], &signal["stretches"]), (&"not_tested".into(), &3.into()), "{signal}");
}

/// A declared gain is known to some per cent: what makes up for less has a value, and is no cause.
#[test]
fn two_per_cent_of_gain_are_a_correction_and_no_cause() {
    let folder = folder("explain_small");
    let flights = fly_for("32", &folder, "thrust", 6, &["attitude_gain=0.98"]);
    let explanation = explain(&folder, &flights);
    assert_eq!(explanation["verdict"], "nothing_missing", "{explanation}");
    let correction = &explanation["corrections"][0];
    assert_eq!(correction["name"], "attitude_gain", "{correction}");
    let gain = correction["params"]["gain"]["value"].as_f64().unwrap();
    assert!((gain - 0.98).abs() < 0.005, "{correction}");
    same_values(&folder.join("out"));
}

/// Without the gain, a filter passes through an inertia below zero: that must not lose the name.
#[test]
fn a_weak_gain_on_a_large_inertia_keeps_its_name() {
    let folder = folder("explain_gain_and_inertia");
    let flights = fly(&folder, &["attitude_gain=0.82", "inertia_scale=1.5"]);
    let explanation = explain(&folder, &flights);
    let names: Vec<&str> =
        explanation["effects"].as_array().unwrap().iter().map(|e| e["name"].as_str().unwrap()).collect();
    assert!(names.contains(&"attitude_gain"), "{explanation}");
}

#[test]
fn lost_packets_are_told_from_a_delay_and_counted() {
    let folder = folder("explain_loss");
    let explanation = explain(&folder, &fly(&folder, &["packet_loss=0.3"]));
    assert_eq!(explanation["verdict"], "explained", "{explanation}");
    let names: Vec<&str> =
        explanation["effects"].as_array().unwrap().iter().map(|e| e["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["packet_loss"], "{}", explanation["effects"]);
    let share = &explanation["effects"][0]["params"]["probability"];
    let (value, stderr) = (share["value"].as_f64().unwrap(), share["stderr"].as_f64().unwrap());
    assert!((value - 0.3).abs() < 3.0 * stderr && stderr < 0.06, "{share}");
}

#[test]
fn what_is_missing_in_two_ways_is_found_without_a_detour() {
    let folder = folder("explain_two");
    let explanation = explain(&folder, &fly(&folder, &["drag_linear=0.5", "cmd_delay=0.05"]));
    assert_eq!(explanation["verdict"], "explained", "{explanation}");
    for (name, parameter, truth) in [("drag_linear", "rate_ps", 0.5), ("cmd_delay", "delay_s", 0.05)] {
        let effect = explanation["effects"].as_array().unwrap().iter().find(|e| e["name"] == name).unwrap();
        let value = effect["params"][parameter]["value"].as_f64().unwrap();
        assert!((value / truth - 1.0).abs() < 0.1, "{effect}");
    }
    // a round for each at most, and one that finds nothing more
    let path = explanation["path"].as_array().unwrap();
    assert!(path.len() <= 3 && path.last().unwrap()["effects"].as_array().unwrap().len() == 2, "{path:?}");
}

#[test]
fn an_inertia_comes_back_as_it_was_flown() {
    let folder = folder("explain_inertia");
    let explanation = explain(&folder, &fly(&folder, &["inertia_scale=1.4"]));
    assert_eq!(explanation["effects"].as_array().map(Vec::len), Some(1), "{}", explanation["effects"]);
    let scale = &explanation["effects"][0]["params"]["scale"];
    let (value, stderr) = (scale["value"].as_f64().unwrap(), scale["stderr"].as_f64().unwrap());
    assert!((value - 1.4).abs() < 3.0 * stderr && stderr < 0.03, "{scale}");
}

#[test]
fn a_thrust_that_is_always_less_does_not_pass_for_a_draught() {
    let folder = folder("explain_thrust");
    // at one height, and for 16 s, nothing but its being there from the start tells it from air that sinks
    let explanation = explain(&folder, &fly(&folder, &["thrust_scale=0.95", "gust.sigma_mps2=0.03"]));
    let effects = explanation["effects"].as_array().unwrap();
    let group =
        |e: &Value| [&[e["name"].clone()], e["confusable_with"].as_array().unwrap().as_slice()].concat();
    let named: Vec<Value> = effects.iter().flat_map(group).collect();
    assert!(effects.len() == 1 && named.contains(&"thrust_scale".into()) && named.len() <= 3, "{effects:?}");
}

#[test]
fn a_load_is_found_although_the_air_could_sink_as_much() {
    let folder = folder("explain_load");
    let explanation = explain(&folder, &fly_by(&folder, "thrust", 4, &["mass_change=0.002"]));
    let added = &explanation["effects"][0]["params"]["added_kg"]["value"];
    assert!(
        explanation["verdict"] == "explained" && (added.as_f64().unwrap() - 0.002).abs() < 1e-4,
        "{}",
        explanation["effects"]
    );
}

/// Sizes are tuned on stretches, where a size just beyond the limit of what is reported is not worth its penalty.
#[test]
fn a_gust_just_beyond_a_draught_is_named() {
    let folder = folder("explain_light_gust");
    let air = ["gust.sigma_mps2=0.13", "gust.tau_s=0.9"];
    let explanation = explain(&folder, &fly_for("40", &folder, "thrust", 6, &air));
    let [gust] = explanation["effects"].as_array().unwrap().as_slice() else { panic!("{explanation}") };
    let value = |name: &str| gust["params"][name]["value"].as_f64().unwrap();
    assert_eq!(gust["name"], "gust");
    assert!((value("sigma_mps2") - 0.13).abs() < 0.02 && (value("tau_s") - 0.9).abs() < 0.3, "{gust}");
}

/// In air that moves by itself too: a wind that stays was taken for a gust of nine seconds. A vehicle that never
/// turns cannot distinguish it from a tilted IMU.
#[test]
fn a_steady_wind_in_moving_air_is_no_gust() {
    let folder = folder("explain_moving_air");
    let air = ["wind.x_mps2=0.3", "wind.y_mps2=0.1", "gust.sigma_mps2=0.09", "gust.tau_s=0.6"];
    let explanation = explain(&folder, &fly_for("40", &folder, "thrust", 6, &air));
    let [effect] = explanation["effects"].as_array().unwrap().as_slice() else { panic!("{explanation}") };
    let value = |name: &str| effect["params"][name]["value"].as_f64().unwrap();
    let (forward_mps2, other) = match effect["name"].as_str() {
        Some("wind") => (value("x_mps2"), "imu_tilt"),
        Some("imu_tilt") => (-9.81 * value("pitch_deg").to_radians(), "wind"),
        _ => panic!("{effect}"),
    };
    assert!((forward_mps2 - 0.3).abs() < 0.045, "{effect}");
    assert!(effect["confusable_with"].as_array().unwrap().contains(&other.into()), "{effect}");
}

/// The thesis's yaw and PWM forms are of first order: what pushes them is lagged, and the lagged push is not
/// to be forgotten from tick to tick.
#[test]
fn true_kinematics_are_found_on_the_forms_of_the_thesis() {
    for vertical in ["thrust", "pwm"] {
        let folder = folder(&format!("explain_true_{vertical}"));
        let explanation = explain(&folder, &fly_by(&folder, vertical, 4, &["euler_kinematics=1"]));
        assert_eq!(
            (&explanation["verdict"], &explanation["vertical"]),
            (&"explained".into(), &vertical.into()),
            "{explanation}"
        );
        let amount = &explanation["effects"][0]["params"]["amount"]["value"];
        assert!((amount.as_f64().unwrap() - 1.0).abs() < 0.05, "{}", explanation["effects"]);
    }
}

/// The log of a PWM does not show which form flew it.
#[test]
fn of_two_forms_for_the_pwm_the_one_that_flew_is_taken() {
    let folder = folder("explain_form");
    let flights = fly_for("32", &folder, "pwm", 6, &[]);
    let explanation = explain(&folder, &flights);
    assert_eq!(
        (&explanation["verdict"], &explanation["vertical"]),
        (&"nothing_missing".into(), &"pwm".into()),
        "{explanation}"
    );
    let [fit, test] = flights.each_ref().map(|f| text(f));
    let out = folder.join("other");
    let other = json(&[
        "explain",
        "thesis",
        "--vertical",
        "thrust",
        "--fit",
        fit,
        "--test",
        test,
        "--out",
        text(&out),
        "--json",
    ]);
    assert_eq!((&other["verdict"], &other["vertical"]), (&"unexplained".into(), &"thrust".into()), "{other}");
    assert_fails(
        1,
        &["explain", "thesis", "--vertical", "height", "--fit", fit, "--test", test, "--out", text(&out)],
        &["a.csv", "height command"],
    );
}

/// Far from the marker fixes scatter ten times as much as over it: no structure of the vehicle.
#[test]
fn fixes_that_scatter_far_from_the_marker_do_not_hide_a_gust() {
    let folder = folder("explain_far");
    let explanation = explain(&folder, &fly_by(&folder, "thrust", 4, &["gust.sigma_mps2=0.4"]));
    let names: Vec<&Value> = explanation["effects"].as_array().unwrap().iter().map(|e| &e["name"]).collect();
    assert_eq!(
        (explanation["verdict"].as_str(), &names[..]),
        (Some("explained"), &[&"gust".into()][..]),
        "{explanation}"
    );
}

#[test]
fn what_cannot_be_explained_is_refused_with_a_reason() {
    let folder = folder("explain_bad");
    let model = thesis(&folder);
    let log = folder.join("flight.csv");
    stdout_of(&["fly", "--task", "track", "--seconds", "4", "--csv", text(&log)]);
    let copy = folder.join("copy.csv");
    std::fs::copy(&log, &copy).unwrap();
    let junk = folder.join("junk.csv");
    std::fs::write(&junk, "a,b\n1,2\n").unwrap();
    let (m, l, out) = (text(&model), text(&log), folder.join("out"));
    assert_fails(
        2,
        &["explain", m, "--fit", l, "--out", text(&out)],
        &["--test", "errors are only honest on flights the fit never saw"],
    );
    assert_fails(2, &["explain", m, "--test", l, "--out", text(&out)], &["--fit"]);
    assert_fails(2, &["explain", m, "--fit", l, "--test", l], &["--out"]);
    assert_fails(
        1,
        &["explain", m, "--fit", l, "--test", text(&copy), "--out", text(&out)],
        &["flight.csv", "copy.csv", "the same flight"],
    );
    assert_fails(
        1,
        &["explain", m, "--fit", text(&junk), "--test", l, "--out", text(&out)],
        &["junk.csv", "no known log format"],
    );
    assert_fails(
        1,
        &["explain", m, "--fit", "no/such.csv", "--test", l, "--out", text(&out)],
        &["no/such.csv", "No such file"],
    );
    assert_fails(
        1,
        &["explain", l, "--fit", l, "--test", l, "--out", text(&out)],
        &["flight.csv", "neither a model file nor a case file", "line 1"],
    );
    assert_fails(
        1,
        &["explain", "no/model.toml", "--fit", l, "--test", l, "--out", text(&out)],
        &["no/model.toml", "No such file"],
    );
    let case = folder.join("d00.json");
    std::fs::write(&case, "{\"declared_model\": 3}").unwrap();
    assert_fails(1, &["explain", text(&case), "--out", text(&out)], &["d00.json", "not a case file"]);
    assert!(!out.exists(), "nothing is written before it is known");
}
