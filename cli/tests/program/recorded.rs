//! Explanations of flights that a real Crazyflie flew.

use std::path::{Path, PathBuf};

use crate::common::{folder, json, stdout_of, text};
use serde_json::Value;

/// Axes that nothing may make worse. The hover of each flight is known before, so that effects which push sideways
/// gain nothing in the vertical.
const AXES: [&str; 3] = ["vertical_velocity_mps", "sideways_velocity_mps", "roll_and_pitch_rad"];

fn cuts(names: &[&str]) -> Vec<PathBuf> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/nanobench");
    names.iter().map(|name| data.join(format!("{name}.csv.gz"))).collect()
}

fn args<'a>(model: &'a str, fit: &'a [PathBuf], test: &'a [PathBuf], out: &'a str) -> Vec<&'a str> {
    let mut all = vec!["explain", model, "--fit"];
    all.extend(fit.iter().map(|path| text(path)));
    all.push("--test");
    all.extend(test.iter().map(|path| text(path)));
    all.extend(["--out", out]);
    all
}

fn explain(model: &str, fit: &[PathBuf], test: &[PathBuf], out: &Path) -> Value {
    json(&[args(model, fit, test, text(out)), vec!["--json"]].concat())
}

fn names(found: &Value, list: &str) -> Vec<String> {
    found[list].as_array().unwrap().iter().map(|e| e["name"].as_str().unwrap().to_owned()).collect()
}

fn estimate(found: &Value, effect: &str, param: &str) -> f64 {
    let lists = ["effects", "confirmed"].map(|list| found[list].as_array().unwrap().clone()).concat();
    let known =
        lists.iter().find(|e| e["name"] == effect).unwrap_or_else(|| panic!("no {effect} in {found}"));
    known["params"][param]["value"].as_f64().unwrap()
}

/// The largest ratio of the errors after and before, over axes, 0.5 and 2 s ahead.
fn worst_ratio(found: &Value, axes: &[&str]) -> f64 {
    let cell =
        |when: &str, axis: &str, ahead: &str| found["error"]["axes"][when][axis][ahead].as_f64().unwrap();
    let ratios = axes.iter().flat_map(|axis| {
        ["0.5_s", "2_s"].map(|ahead| cell("after", axis, ahead) / cell("before", axis, ahead))
    });
    ratios.fold(0.0, f64::max)
}

#[test]
fn of_a_foreign_model_it_is_said_at_once_that_its_numbers_are_not_this_vehicles() {
    let folder = folder("explain_foreign");
    let (fit, test) = (
        cuts(&["B3_figure8_fast_rep1", "B8_star_fast_rep1", "B8_star_medium_rep1"]),
        cuts(&["B3_figure8_slow_rep1"]),
    );
    let output = stdout_of(&args("thesis", &fit, &test, text(&folder.join("out"))));
    assert!(
        output
            .lines()
            .nth(1)
            .unwrap()
            .starts_with("The numbers of the model cf2-thesis are not this vehicle's")
            && output.contains("crazyflie identify thesis --fit"),
        "{output}"
    );
    let explanation = explain("thesis", &fit, &test, &folder.join("json"));
    assert!(explanation["foreign_model"].is_object());
    // some seconds of flight are too few for the drag's value, but not for its existence, and it is not
    // quadratic
    assert_eq!(names(&explanation, "effects"), ["drag_linear"], "{explanation}");
    assert!(worst_ratio(&explanation, &AXES[1..]) < 0.8, "{}", explanation["error"]);
    assert!(worst_ratio(&explanation, &AXES) < 1.01, "{}", explanation["error"]);
    // the firmware's cascade flew, and is recognised
    assert_eq!(explanation["closed_loop"]["controller"], "firmware's cascade");
    let model = std::fs::read_to_string(folder.join("json/model.toml")).unwrap();
    let drag = estimate(&explanation, "drag_linear", "rate_ps");
    assert!(model.contains(&drag.to_string()), "the model file does not hold {drag}:\n{model}");
    // the numbers that were fitted say so
    assert!(model.contains("estimated beside the effects on B3_figure8_fast_rep1.csv.gz"), "{model}");
}

#[test]
fn what_an_identified_model_holds_is_confirmed_and_not_found_again() {
    let folder = folder("explain_identified");
    let (fit, test) = (
        cuts(&["B3_figure8_fast_rep1", "B8_star_fast_rep1", "B8_star_medium_rep1"]),
        cuts(&["B3_figure8_slow_rep1"]),
    );
    let model = folder.join("mine.toml");
    let mut identify = vec!["identify", "--mass", "0.034", "--out", text(&model), "--fit"];
    identify.extend(fit.iter().map(|path| text(path)));
    stdout_of(&identify);
    let explanation = explain(text(&model), &fit, &test, &folder.join("out"));
    // some seconds test nothing, and where they err by more than no model, that is said
    let verdict = explanation["verdict"].as_str().unwrap();
    assert!(["not_decidable", "unexplained"].contains(&verdict), "{explanation}");
    assert_eq!(names(&explanation, "effects"), [""; 0], "{explanation}");
    assert!(
        names(&explanation, "confirmed").contains(&"drag_linear".to_owned())
            && explanation["foreign_model"].is_null(),
        "{explanation}"
    );
    assert_eq!(worst_ratio(&explanation, &AXES), 1.0);
}

#[test]
fn every_vehicle_by_name_explains_a_recorded_flight() {
    let folder = folder("explain_by_name");
    let (fit, test) = (cuts(&["B8_star_fast_rep1"]), cuts(&["B8_star_medium_rep1"]));
    let vehicles = json(&["vehicles", "--json"]);
    for vehicle in vehicles.as_array().unwrap() {
        let name = vehicle["name"].as_str().unwrap();
        let explanation = explain(name, &fit, &test, &folder.join(name));
        // a log of one command for all motors does not drive the motor-level form, though it may be the default
        assert!(
            ["pwm", "thrust"].map(Value::from).contains(&explanation["vertical"]),
            "{name}: {explanation}"
        );
    }
}
