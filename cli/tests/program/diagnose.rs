//! `crazyflie diagnose` and `crazyflie horizons` on cuts of recorded flights.

use std::path::Path;

use crate::common::json;
use serde_json::Value;

fn data(path: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data").join(path);
    assert!(folder.exists(), "{} is part of the repository", folder.display());
    folder.display().to_string()
}

fn diagnosis(normal: &[&str], suspect: &[&str]) -> Value {
    diagnosis_of(&[], normal, suspect)
}

fn diagnosis_of(vehicle: &[&str], normal: &[&str], suspect: &[&str]) -> Value {
    let paths = |of: &[&str]| of.iter().map(|p| data(&format!("crazypad/{p}"))).collect::<Vec<_>>();
    let (normal, suspect) = (paths(normal), paths(suspect));
    let mut args = [&["diagnose", "--json"], vehicle, &["--normal"]].concat();
    args.extend(normal.iter().map(String::as_str));
    args.push("--suspect");
    args.extend(suspect.iter().map(String::as_str));
    json(&args)
}

const NORMAL: [&str; 2] = ["controller_data/normal_flight", "motor_data/normal_flight"];

/// The weight is between motors 3 and 4, on the left; the data set does not give its mass.
#[test]
fn an_added_weight_leans_to_where_it_sits() {
    let answer = diagnosis(&NORMAL, &["motor_data/add_weight_W1_near_M3_M4"]);
    let change = |i: usize| answer["change"][i].as_f64().unwrap();
    // more thrust, to the left, and no more yaw than set-ups differ by
    assert!(change(0) > 0.03 && change(1) > 0.04 && change(2).abs() < 0.02, "{answer}");
    assert!(answer["z"][3].as_f64().unwrap().abs() < 1.0, "{answer}");
    assert_eq!(answer["verdict"], "added_weight", "{answer}");
}

/// A cut propeller 3 needs yaw, the way of motors 1 and 3.
#[test]
fn a_cut_propeller_asks_for_yaw() {
    let answer = diagnosis(&NORMAL, &["motor_data/cut_propeller_M3_2mm"]);
    assert!(answer["change"][3].as_f64().unwrap() > 0.02, "{answer}");
    assert_eq!(
        (&answer["verdict"], &answer["fault"]["motor"]),
        (&"weak_motor".into(), &3.into()),
        "{answer}"
    );
    // roll and pitch of a small cut hardly tell motor 3 from motor 1, which turns the same way
    assert!(answer["alternatives"].as_array().unwrap().iter().any(|a| a["motor"] == 1), "{answer}");
}

#[test]
fn normal_flights_are_normal() {
    let answer = diagnosis(&NORMAL[..1], &NORMAL[1..]);
    assert_eq!(answer["verdict"], "nothing", "{answer}");
    assert!(answer["text"].as_str().unwrap().contains("smallest that would be found"), "{answer}");
    let answer = diagnosis(&NORMAL[1..], &NORMAL[..1]);
    assert_eq!(answer["verdict"], "nothing", "{answer}");
}

/// Without a measured height, the voltages of the motors show the hover.
#[test]
fn motors_of_another_vehicle_are_told_to_machines() {
    for (mass_g, is_said) in [("30", false), ("60", true)] {
        let answer = diagnosis_of(&["--vehicle", "cf21", "--mass-g", mass_g], &NORMAL[1..], &NORMAL[..1]);
        let warnings = answer["warnings"].as_array().unwrap();
        let told = warnings.iter().any(|warning| warning.as_str().unwrap().contains("other motors"));
        assert!(warnings.len() >= 8 && told == is_said, "{warnings:?}");
    }
}

#[test]
fn what_cannot_be_compared_is_said() {
    let two = ["motor_data/normal_flight/E8_log00", "motor_data/normal_flight/E8_log01"];
    let answer = diagnosis(&two, &["motor_data/cut_propeller_M3_2mm"]);
    assert_eq!(answer["verdict"], "too_few", "{answer}");
    let file = data("crazypad/motor_data/normal_flight/E8_log00");
    crate::common::assert_fails(1, &["diagnose", "--normal", &file, "--suspect", &file], &["same flight"]);
}

/// From the motors alone, half a second ahead: better than going on as before, on a flight that the fit has
/// not seen.
#[cfg(feature = "labs")]
#[test]
fn motors_predict_what_comes() {
    let [fit, test]: [std::path::PathBuf; 2] =
        ["B8_star_fast_rep1", "B8_star_medium_rep1"].map(|n| data(&format!("nanobench/{n}.csv.gz")).into());
    let table = json(&[
        "horizons",
        "--fit",
        &fit.display().to_string(),
        "--test",
        &test.display().to_string(),
        "--json",
    ]);
    let error = |of: &str, quantity: usize| table["errors"][of][quantity][2].as_f64().unwrap();
    for quantity in 0..3 {
        let (model, unchanged) = (error("model", quantity), error("unchanged", quantity));
        assert!(model < 0.8 * unchanged, "{quantity}: {model} {unchanged}: {table}");
        let (sum, best) =
            (&table["errors"]["sums"][quantity], &table["published_sums_of_50_steps"][quantity]);
        assert!(sum.as_f64().unwrap() > 10.0 * model && best.as_f64().unwrap() > 1.0, "{table}");
    }
}
