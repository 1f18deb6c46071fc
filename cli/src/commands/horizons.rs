//! `crazyflie horizons`: a motor-level model fitted to some flights, and its errors by horizon on others.

use std::io::Write;
use std::path::PathBuf;

use crazyflie_identify::motor::fit::{MotorModel, fit};
use crazyflie_identify::motor::flight::{MotorFlight, median_speed};
use crazyflie_identify::motor::horizons::{
    HORIZON_STEPS, HorizonTable, PUBLISHED, PUBLISHED_SUMS, QUANTITIES, horizon_table,
};
use crazyflie_identify::motor::model::{FORM, Parameter};
use crazyflie_identify::motor::regression::align;
use serde_json::{Value as Json, json};

use super::open::OpenArgs;
use super::{Failure, Outcome, Table, listed, number};

const SOURCE: &str = "Published rows: Busetto, Cereda et al., arXiv 2512.14450, on flights of their own, of another vehicle: a yardstick, no contest on the same data.";
const UNKNOWN: &str = "Motors recorded at 100 Hz hold little of a rate loop at 500 Hz, and what it does with noise is no torque.";

/// A prediction starts every so many rows of a test flight.
const TEST_STRIDE: usize = 5;

/// Fit thrust, motor lag, drag, authority and damping to the motors in logs, and table the errors after 1, 10
/// and 50 steps of 10 ms.
///
/// The table is that of the nano-drone system-identification benchmark. Each prediction starts from the
/// measured state and from what was learnt before it; then the logged motors alone drive the model. Logs need
/// motor PWM, battery voltage, body rates and velocity at 100 Hz.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Logs to fit
    #[arg(long, required = true, num_args = 1.., value_name = "LOG")]
    fit: Vec<PathBuf>,
    /// Logs to predict
    #[arg(long, required = true, num_args = 1.., value_name = "LOG")]
    test: Vec<PathBuf>,
    #[command(flatten)]
    logs: OpenArgs,
    /// Tables as Markdown
    #[arg(long)]
    markdown: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Result of the command.
struct Horizons {
    model: MotorModel,
    table: HorizonTable,
    /// Numbers of flights that were fitted and predicted.
    flights: [usize; 2],
    /// Flights whose rotors were aligned to the gyro, and by how many rows.
    aligned: Vec<(String, isize)>,
    left_out: Vec<String>,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let horizons = find(args)?;
    if args.json {
        args.logs.write_json(as_json(&horizons), out)
    } else {
        write_tables(&horizons, args.markdown, out)
    }
}

fn find(args: &Args) -> Outcome<Horizons> {
    let mut left_out = Vec::new();
    let mut fitted = flights(args, &args.fit, &mut left_out)?;
    let mut tested = flights(args, &args.test, &mut left_out)?;
    if let Some((a, b)) = same_flight(&fitted, &tested) {
        let words = format!("{a} is to be fitted and {b} to be predicted, and they are the same flight");
        return Err(Failure::Usage(words));
    }
    if tested.is_empty() {
        return Err(Failure::Failed(format!("no flight to predict{}", listed(&left_out))));
    }
    let median_speed = median_speed(&fitted);
    let lag_s = align(&mut fitted, median_speed, None);
    align(&mut tested, median_speed, Some(lag_s));
    let model = fit(&fitted, lag_s).map_err(|e| Failure::Failed(format!("{e}{}", listed(&left_out))))?;
    let table = horizon_table(&model, &tested, TEST_STRIDE);
    let moved = fitted.iter().chain(&tested).filter(|flight| flight.rotors_later != 0);
    let aligned = moved.map(|flight| (flight.name.clone(), flight.rotors_later)).collect();
    Ok(Horizons { model, table, flights: [fitted.len(), tested.len()], aligned, left_out })
}

fn write_tables(found: &Horizons, markdown: bool, out: &mut dyn Write) -> Outcome {
    let Horizons { model, table, flights: [fitted, tested], aligned, left_out } = found;
    let (errors, predictions) = (errors_table(table), table.predictions);
    let what = "length of the error, angle of attitude";
    writeln!(
        out,
        "Mean absolute errors of {predictions} predictions on {tested} flights that the fit of {fitted} has not seen: {what}.\n\n{}\n{SOURCE}\n",
        errors.text(markdown)
    )?;
    write!(out, "{}", parameters_table(model).text(markdown))?;
    let stuck: Vec<String> =
        (0..FORM.len()).filter(|i| model.at_bound[*i]).map(|i| bound(model, i)).collect();
    if !stuck.is_empty() {
        writeln!(out, "\nNot known: {}. {UNKNOWN}", stuck.join(", "))?;
    }
    if !aligned.is_empty() {
        let moved: Vec<String> = aligned.iter().map(|(name, rows)| format!("{name} {rows:+}")).collect();
        writeln!(out, "\nRows by which rotors were moved to fit the gyro: {}", moved.join(", "))?;
    }
    for line in left_out {
        writeln!(out, "Left out: {line}")?;
    }
    Ok(())
}

/// Flights that can drive the model. A file that is no log fails; a log without motors is left out.
fn flights(args: &Args, paths: &[PathBuf], left_out: &mut Vec<String>) -> Outcome<Vec<MotorFlight>> {
    let mut flights = Vec::new();
    for path in paths {
        let log = args.logs.open(path)?;
        match MotorFlight::from_log(&path.display().to_string(), &log) {
            Ok(flight) => flights.push(flight),
            Err(why) => left_out.push(why.to_string()),
        }
    }
    Ok(flights)
}

/// Names of a flight on both sides; measured motion never repeats to the last bit.
fn same_flight(a: &[MotorFlight], b: &[MotorFlight]) -> Option<(String, String)> {
    let pairs = a.iter().flat_map(|a| b.iter().map(move |b| (a, b)));
    pairs.filter(|(a, b)| a.motion == b.motion).map(|(a, b)| (a.name.clone(), b.name.clone())).next()
}

fn errors_table(table: &HorizonTable) -> Table<(usize, &'static (&'static str, &'static str))> {
    let mut shown = Table::from_rows(QUANTITIES.iter().enumerate())
        .words("error", |(_, (quantity, unit))| format!("{quantity} ({unit})"));
    for (errors, before, after) in [(&table.model, "", " steps"), (&table.unchanged, "unchanged, ", "")] {
        for (at, steps) in HORIZON_STEPS.iter().enumerate() {
            shown = shown.values(format!("{before}{steps}{after}"), |(q, _)| number(errors[q][at], 4));
        }
    }
    let shown = PUBLISHED.iter().fold(shown, |shown, row| {
        let error = |q: usize| row.errors[q].map_or(String::new(), |e| number(e, 3));
        shown.values(format!("{}, 50", row.name), |(q, _)| error(q))
    });
    shown
        .values("sum of 1 to 50", |(q, _)| number(table.sums[q], 2))
        .values("published, best sum", |(q, _)| number(PUBLISHED_SUMS[q], 2))
}

fn parameters_table(model: &MotorModel) -> Table<(usize, &'static Parameter)> {
    let bound = |i: usize| if model.at_bound[i] { ", at its bound" } else { "" };
    Table::from_rows(FORM.iter().enumerate())
        .words("parameter", |(_, p)| p.name)
        .values("value", |(i, _)| {
            format!("{} +- {}{}", number(model.values[i], 3), number(model.stderr[i], 3), bound(i))
        })
        .words("unit", |(_, p)| p.unit)
        .words("meaning", |(_, p)| p.about)
}

/// A parameter at a bound, in words.
fn bound(model: &MotorModel, i: usize) -> String {
    let Parameter { name, unit, low, high, .. } = FORM[i];
    let (side, limit) = if model.values[i] <= low { ("least", low) } else { ("largest", high) };
    format!("{name}, which ran to the {side} value allowed ({limit} {unit})")
}

fn as_json(found: &Horizons) -> Json {
    let Horizons { model, table, aligned, left_out, .. } = found;
    let parameter = |i: usize| json!({"name": FORM[i].name, "unit": FORM[i].unit, "value": model.values[i], "stderr": model.stderr[i], "at_bound": model.at_bound[i]});
    json!({
        "horizon_steps": HORIZON_STEPS,
        "quantities": QUANTITIES.iter().map(|(name, unit)| json!({"name": name, "unit": unit})).collect::<Vec<_>>(),
        "errors": table,
        "published_after_50_steps": PUBLISHED,
        "published_sums_of_50_steps": PUBLISHED_SUMS,
        "published_source": "arXiv 2512.14450, other flights of another vehicle",
        "parameters": (0..FORM.len()).map(parameter).collect::<Vec<_>>(),
        "median_speed_v": model.median_speed,
        "rotors_later_rows": aligned.iter().map(|(name, rows)| json!({"log": name, "rows": rows})).collect::<Vec<_>>(),
        "left_out": left_out,
    })
}
