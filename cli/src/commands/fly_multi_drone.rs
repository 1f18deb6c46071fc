//! Output of `crazyflie fly` for several drones.

use crazyflie_statistics::rms;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::io::Write;
use std::path::{Path, PathBuf};

use crazyflie_env::vector::METRICS;
use serde_json::{Value, json};

use super::fly_table::spread;
use super::{Outcome, Table, files, number, or_dash};
use crazyflie_server::flight::{self, MultiDroneTrace};

/// One flight, or median and quartiles over the runs.
pub(super) fn table(flights: &[MultiDroneTrace], avoids: bool, out: &mut dyn Write) -> Outcome {
    if flights.len() > 1 {
        writeln!(out, "{} flights: median (first to third quartile)", flights.len())?;
    }
    let metrics = |i: usize| flights.iter().map(|flight| flight.metrics[i].into()).collect();
    let table = Table::from_rows(METRICS.iter().enumerate())
        .words("measure", |(_, (name, ..))| name)
        .values("value", |(i, _)| spread(metrics(i), 3, ""))
        .words("unit", |(_, (_, unit, _))| unit)
        .words("meaning", |(_, (.., about))| about);
    writeln!(out, "{table}")?;
    if let [flight] = flights {
        writeln!(out, "{}", drones(flight))?;
    }
    let collided: f32 = flights.iter().map(|flight| flight.metric("collisions")).sum();
    if collided > 0.0 && !avoids {
        let layer = "puts a layer before the controllers that keeps them apart";
        writeln!(out, "{collided} drones collided: --collision-avoidance {layer}")?;
    }
    Ok(())
}

fn drones(flight: &MultiDroneTrace) -> impl Display {
    Table::from_rows(flight.drones.iter().enumerate())
        .words("drone", |(drone, _)| drone)
        .values("flew (s)", |(_, trace)| number(flew_s(trace), 2))
        .values("RMS error (m)", |(drone, _)| number(rms(&flight.errors_m(drone)).unwrap_or(0.0), 3))
        .values("error at the end (m)", |(drone, _)| {
            or_dash(flight.errors_m(drone).last().map(|e| number(*e, 3)))
        })
}

fn flew_s(trace: &flight::Trace) -> f64 {
    trace.t_s(trace.rows.len().saturating_sub(1))
}

pub(super) fn as_json(flight: &MultiDroneTrace) -> Value {
    let names = METRICS.iter().map(|(name, ..)| name);
    let metrics: BTreeMap<_, _> = names.zip(flight.metrics).collect();
    let drone = |(drone, trace): (usize, &flight::Trace)| {
        let errors = flight.errors_m(drone);
        json!({"flew_s": flew_s(trace), "rms_error_m": rms(&errors), "final_error_m": errors.last()})
    };
    json!({"metrics": metrics, "drones": flight.drones.iter().enumerate().map(drone).collect::<Value>()})
}

/// Writes the logs, one file for each drone.
pub(super) fn write_logs(file: &Path, flight: &MultiDroneTrace) -> Outcome {
    for (drone, trace) in flight.drones.iter().enumerate() {
        files::write_log(&drone_file(file, drone), &flight::log(trace))?;
    }
    Ok(())
}

/// `flight.csv` of drone 2 is `flight-2.csv`.
fn drone_file(file: &Path, drone: usize) -> PathBuf {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let ending = file.extension().map_or(String::new(), |ending| format!(".{}", ending.to_string_lossy()));
    file.with_file_name(format!("{stem}-{drone}{ending}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_drone_has_a_file_of_its_own() {
        assert_eq!(drone_file(Path::new("out/flight.csv"), 2), Path::new("out/flight-2.csv"));
        assert_eq!(drone_file(Path::new("flight"), 0), Path::new("flight-0"));
    }
}
