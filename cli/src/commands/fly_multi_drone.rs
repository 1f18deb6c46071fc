//! Output of `crazyflie fly` for several drones.

use crazyflie_statistics::rms;
use std::io::Write;
use std::path::{Path, PathBuf};

use crazyflie_env::vector::METRICS;
use serde_json::{Map, Value, json};

use super::fly_table::quartiles;
use super::{Outcome, Table, files, number};
use crazyflie_server::flight::{self, MultiDroneTrace};

/// One flight, or median and quartiles over the runs.
pub(super) fn table(flights: &[MultiDroneTrace], avoids: bool, out: &mut dyn Write) -> Outcome {
    if flights.len() > 1 {
        writeln!(out, "{} flights: median (first to third quartile)", flights.len())?;
    }
    let mut table = Table::new(&["measure", "value", "unit", "meaning"]).left(&[2, 3]);
    for (i, (name, unit, about)) in METRICS.iter().enumerate() {
        let value = match flights {
            [flight] => number(flight.metrics[i].into(), 3),
            many => {
                let [low, middle, high] =
                    quartiles(many.iter().map(|flight| flight.metrics[i].into()).collect());
                format!("{} ({} to {})", number(middle, 3), number(low, 3), number(high, 3))
            }
        };
        table.row(vec![(*name).into(), value, (*unit).into(), (*about).into()]);
    }
    writeln!(out, "{}", table.plain())?;
    if let [flight] = flights {
        writeln!(out, "{}", drones(flight).plain())?;
    }
    let collided: f32 = flights.iter().map(|flight| flight.metric("collisions")).sum();
    if collided > 0.0 && !avoids {
        writeln!(
            out,
            "{collided} drones collided: --collision-avoidance puts a layer before the controllers that keeps them apart"
        )?;
    }
    Ok(())
}

fn drones(flight: &MultiDroneTrace) -> Table {
    let mut table = Table::new(&["drone", "flew (s)", "RMS error (m)", "error at the end (m)"]);
    for (drone, trace) in flight.drones.iter().enumerate() {
        let errors = flight.errors_m(drone);
        let last = errors.last().copied().unwrap_or(f64::NAN);
        let flew_s = trace.t_s(trace.rows.len().saturating_sub(1));
        table.row(vec![
            drone.to_string(),
            number(flew_s, 2),
            number(rms(&errors).unwrap_or(0.0), 3),
            number(last, 3),
        ]);
    }
    table
}

pub(super) fn as_json(flight: &MultiDroneTrace) -> Value {
    let metrics: Map<String, Value> = METRICS
        .iter()
        .zip(flight.metrics)
        .map(|((name, ..), value)| ((*name).to_owned(), value.into()))
        .collect();
    let drone = |(drone, trace): (usize, &flight::Trace)| {
        let errors = flight.errors_m(drone);
        json!({"flew_s": trace.t_s(trace.rows.len().saturating_sub(1)), "rms_error_m": rms(&errors), "final_error_m": errors.last()})
    };
    json!({"metrics": metrics, "drones": flight.drones.iter().enumerate().map(drone).collect::<Vec<_>>()})
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
