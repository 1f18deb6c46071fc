//! Flights with a planted defect: what hovering needs with it and without.

use std::path::{Path, PathBuf};

use crazyflie_identify::FlightLog;

/// Folders of the conditions; the first is the vehicle as it should be.
pub(super) const CONDITIONS: [&str; 4] =
    ["normal_flight", "add_weight_W1_near_M3_M4", "cut_propeller_M3_2mm", "weight_on_string_W2_near_M3"];
/// One vehicle flew all conditions; files of the other are left out.
const VEHICLE: &str = "E8_";
/// Take-off and landing are cut away.
const EDGE_S: f64 = 1.5;

/// What hovering asks, the mean over a flight: collective thrust, then each motor's share above the mean, in counts.
pub(super) const ASKED: [&str; 6] = ["thrust", "motor 1", "motor 2", "motor 3", "motor 4", "yaw moment"];
/// The last of them: motors 1 and 3 turn against 2 and 4. A weight turns nothing; a propeller that drags less does.
pub(super) const YAW: usize = 5;

pub(super) struct Condition {
    pub(super) name: &'static str,
    pub(super) flights: Vec<[f64; 6]>,
    pub(super) left_out: Vec<String>,
}

pub(super) struct Pad {
    pub(super) conditions: Vec<Condition>,
}

/// Mean and standard error over flights.
pub(super) fn mean(flights: &[[f64; 6]], of: usize) -> (f64, f64) {
    let n = flights.len() as f64;
    let mean = flights.iter().map(|f| f[of]).sum::<f64>() / n;
    let variance = flights.iter().map(|f| (f[of] - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, (variance / n).sqrt())
}

/// The difference of two means in its own standard errors (Welch).
pub(super) fn welch(a: (f64, f64), b: (f64, f64)) -> f64 {
    (a.0 - b.0) / a.1.hypot(b.1)
}

pub(super) fn pad(folder: &Path) -> Option<Pad> {
    let conditions: Vec<Condition> = CONDITIONS.iter().map(|name| condition(folder, name)).collect();
    conditions.iter().all(|c| c.flights.len() > 1).then_some(Pad { conditions })
}

fn condition(folder: &Path, name: &'static str) -> Condition {
    let mut out = Condition { name, flights: Vec::new(), left_out: Vec::new() };
    for kind in ["controller_data", "motor_data"] {
        let mut files: Vec<PathBuf> =
            std::fs::read_dir(folder.join(kind).join(name)).into_iter().flatten().filter_map(|e| Some(e.ok()?.path())).collect();
        files.sort();
        for path in files {
            let file = path.file_name().map_or(String::new(), |n| n.to_string_lossy().into_owned());
            let of_vehicle = file.starts_with(VEHICLE);
            match FlightLog::read(&path).ok().filter(|_| of_vehicle).and_then(|log| hover(&log)) {
                Some(asked) => out.flights.push(asked),
                None => out.left_out.push(format!("{kind}/{name}/{file}")),
            }
        }
    }
    out
}

/// Means over the airborne seconds without take-off and landing.
fn hover(log: &FlightLog) -> Option<[f64; 6]> {
    let flown = log.airborne.clone();
    let (first, last) = (*log.t_s.get(flown.start)? + EDGE_S, *log.t_s.get(flown.end.checked_sub(1)?)? - EDGE_S);
    let rows: Vec<usize> = flown.filter(|row| (first..last).contains(&log.t_s[*row])).collect();
    if rows.len() < 100 {
        return None;
    }
    let asked = log.onboard.as_ref()?.motor_request_pwm.as_ref()?;
    let of = |v: &[f64]| rows.iter().map(|row| v[*row]).sum::<f64>() / rows.len() as f64;
    let motors: [f64; 4] = std::array::from_fn(|m| of(&asked[m]));
    let thrust = motors.iter().sum::<f64>() / 4.0;
    let yaw = 0.25 * (motors[0] - motors[1] + motors[2] - motors[3]);
    Some([thrust, motors[0] - thrust, motors[1] - thrust, motors[2] - thrust, motors[3] - thrust, yaw])
}
