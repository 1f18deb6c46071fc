//! Planted defects of recorded flights.

mod common;

use std::path::PathBuf;

use common::data;
use crazyflie_env::model::Model;
use crazyflie_identify::FlightLog;
use crazyflie_identify::hover::{Normal, asked};

const CONDITIONS: [&str; 4] = ["normal_flight", "add_weight_W1_near_M3_M4", "cut_propeller_M3_2mm", "weight_on_string_W2_near_M3"];
/// The one flight that turned over at take-off.
const CRASHED: &str = "controller_data/weight_on_string_W2_near_M3/E8_log02";

/// Every recorded file, with its name from the kind of data on.
fn recorded(test: &str) -> Vec<(String, FlightLog)> {
    let Some(folder) = data(test, "crazypad") else { return Vec::new() };
    let mut all = Vec::new();
    for kind in ["controller_data", "motor_data"] {
        for condition in CONDITIONS {
            let mut files: Vec<PathBuf> =
                std::fs::read_dir(folder.join(kind).join(condition)).unwrap().map(|e| e.unwrap().path()).collect();
            files.sort();
            for path in files {
                let name = path.strip_prefix(&folder).unwrap().display().to_string();
                all.push((name, FlightLog::read(&path).unwrap()));
            }
        }
    }
    assert_eq!(all.len(), 30);
    all
}

/// Which effect accounts for what a planted defect asks of the motors.
#[test]
fn planted_defects_get_their_names() {
    let all = recorded("planted_defects_get_their_names");
    if all.is_empty() {
        return;
    }
    let of = |condition: &str| -> Vec<_> {
        let mine = |name: &str| name.contains(condition) && name.contains("/E8_") && name != CRASHED;
        all.iter().filter(|(name, _)| mine(name)).filter_map(|(_, log)| asked(log)).collect()
    };
    let [normal, weight, cut, string] = CONDITIONS.map(of);
    let normal = Normal::of(&Model::thesis(), &normal, &[&weight, &cut, &string]).unwrap();
    let named = |flights| normal.explain(flights).unwrap().found;
    let weight = named(&weight);
    let mass = weight.iter().find(|f| f.name == "mass_change").unwrap();
    assert!(mass.params[0].value > 3.0 * mass.params[0].stderr && mass.confusable_with == ["thrust_scale"], "{mass:?}");
    // motors 3 and 4 are the left ones
    let balance = weight.iter().find(|f| f.name == "com_offset").unwrap();
    assert!(weight.len() == 2 && balance.asks[1] > 2000.0 && balance.asks[2].abs() < 500.0, "{balance:?}");
    let cut = named(&cut);
    assert!(cut.len() == 1 && cut[0].name == "weak_motor", "{cut:?}");
    assert!(cut[0].choice[0].value == 1.0 && cut[0].confusable_with == ["weak_motor motor 3"], "{cut:?}");
    assert_eq!(named(&string), []);
}
