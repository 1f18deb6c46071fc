//! `crazyflie identify --thesis`: the thesis's identification flights, flown, recorded and identified.

use std::io::Write;

use crazyflie_env::model::Model;
use indicatif::ProgressBar;
use serde_json::json;

use super::{Outcome, Table, identify_table, number};
use crate::recovery::{COUNT, RecoveredParameter, Sensors, equations, whole_model};

const LEGEND: &str = "\
Each flight hovers at 70 cm by the thesis's PID for 10 s and then does what 5.1 says. Ideal: the controller and the log have the true pose at 50 Hz.
Camera rig: 30 Hz frames, 50 ms late, with 5 mm (x, y) and 10 mm (z) of noise, and angles with 0.2 degrees. Fit: MATLAB's, of that flight.
Without noise, what is left is the recording's 32-bit rounding, and standard errors are below what it does.";

pub(super) fn run(model: &Model, seed: u64, as_json: bool, out: &mut dyn Write) -> Outcome {
    let bar = ProgressBar::new(COUNT as u64);
    let mut all = Vec::new();
    for sensors in [Sensors::Ideal, Sensors::Rig] {
        all.extend(equations(model, sensors, seed, &|| bar.inc(1))?);
        all.extend(whole_model(model, sensors, seed, &|| bar.inc(1))?);
    }
    bar.finish_and_clear();
    if as_json {
        let line = |recovered: &RecoveredParameter| {
            json!({"equation": recovered.equation, "experiment": recovered.experiment, "sensors": recovered.sensors.name(), "true": recovered.truth,
                "estimate": identify_table::estimates(std::slice::from_ref(&recovered.estimate))[0], "fit_percent": recovered.fit_percent})
        };
        serde_json::to_writer_pretty(&mut *out, &all.iter().map(line).collect::<Vec<_>>())?;
        return Ok(writeln!(out)?);
    }
    let header = [
        "equation",
        "experiment",
        "sensors",
        "number",
        "true",
        "estimate",
        "standard error",
        "off by",
        "in s.e.",
        "fit",
    ];
    let mut table = Table::new(&header).left(&[1, 2, 3]);
    for recovered in &all {
        let digits = |value: f64| format!("{value:.4e}");
        let off = if recovered.truth == 0.0 {
            digits(recovered.relative())
        } else {
            format!("{} %", number(100.0 * recovered.relative(), 2))
        };
        table.row(vec![
            recovered.equation.into(),
            recovered.experiment.into(),
            recovered.sensors.name().into(),
            recovered.estimate.name.clone(),
            digits(recovered.truth),
            digits(recovered.estimate.value),
            digits(recovered.estimate.standard_error),
            off,
            if recovered.sensors == Sensors::Ideal {
                String::new()
            } else {
                number(recovered.deviations(), 1)
            },
            recovered.fit_percent.map_or(String::new(), |fit| format!("{} %", number(fit, 2))),
        ]);
    }
    Ok(write!(out, "{}\n{LEGEND}\n", table.plain())?)
}
