//! Flights with a planted defect: what hovering asks of the motors with it and without, and which effect accounts for the difference.

use std::path::{Path, PathBuf};

use crazyflie_env::model::Model;
use crazyflie_identify::FlightLog;
use crazyflie_identify::hover::{Change, Found, Normal, asked};
use nalgebra::Vector4;

/// Folders of the conditions; the first is the vehicle as it should be.
const CONDITIONS: [&str; 4] = ["normal_flight", "add_weight_W1_near_M3_M4", "cut_propeller_M3_2mm", "weight_on_string_W2_near_M3"];
/// One vehicle flew all conditions; files of the other are left out.
const VEHICLE: &str = "E8_";

pub(super) struct Condition {
    pub(super) name: &'static str,
    pub(super) flights: Vec<Vector4<f64>>,
    pub(super) left_out: Vec<String>,
    /// What is wrong with the vehicle; of the normal condition, nothing is asked.
    pub(super) change: Option<Change>,
}

pub(super) struct Pad {
    pub(super) normal: Normal,
    pub(super) conditions: Vec<Condition>,
    /// Normal flights that get a name when they are taken as a condition, against the others.
    pub(super) false_alarms: Vec<Found>,
}

/// `None` where the recordings are absent, or the model cannot hover by a thrust command.
pub(super) fn pad(model: &Model, folder: &Path) -> Option<Pad> {
    let mut conditions: Vec<Condition> = CONDITIONS.iter().map(|name| condition(folder, name)).collect();
    let (first, altered) = conditions.split_first_mut()?;
    let others: Vec<&[Vector4<f64>]> = altered.iter().map(|c| &c.flights[..]).collect();
    if first.flights.len() < 3 || others.iter().any(|flights| flights.len() < 2) {
        return None;
    }
    let normal = Normal::of(model, &first.flights, &others).ok()?;
    let alarm = |i: usize| {
        let rest: Vec<Vector4<f64>> = first.flights.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, f)| *f).collect();
        let change = Normal::of(model, &rest, &others).ok()?.explain(&first.flights[i..=i])?;
        change.found.into_iter().next()
    };
    let false_alarms = (0..first.flights.len()).filter_map(alarm).collect();
    altered.iter_mut().for_each(|c| c.change = normal.explain(&c.flights));
    Some(Pad { normal, conditions, false_alarms })
}

fn condition(folder: &Path, name: &'static str) -> Condition {
    let mut out = Condition { name, flights: Vec::new(), left_out: Vec::new(), change: None };
    for kind in ["controller_data", "motor_data"] {
        let mut files: Vec<PathBuf> =
            std::fs::read_dir(folder.join(kind).join(name)).into_iter().flatten().filter_map(|e| Some(e.ok()?.path())).collect();
        files.sort();
        for path in files {
            let file = path.file_name().map_or(String::new(), |n| n.to_string_lossy().into_owned());
            let of_vehicle = file.starts_with(VEHICLE);
            match FlightLog::read(&path).ok().filter(|_| of_vehicle).and_then(|log| asked(&log)) {
                Some(asked) => out.flights.push(asked),
                None => out.left_out.push(format!("{kind}/{name}/{file}")),
            }
        }
    }
    out
}
