//! `crazyflie diagnose`: suspect flights against normal ones, by what hovering asks of the motors.

use std::io::Write;
use std::path::{Path, PathBuf};

use crazyflie_env::model::Model;
use crazyflie_identify::FlightLog;
use crazyflie_identify::diagnose::demand::effect_demands;
use crazyflie_identify::diagnose::diagnose;
use crazyflie_identify::diagnose::trim::FlightTrim;

use super::{Failure, Outcome, diagnose_report as report, files};

const EXAMPLES: &str = "\
Examples:
  crazyflie diagnose --normal monday/ tuesday/ --suspect friday/ --picture trims.svg
  crazyflie diagnose --normal normal/E8_* --suspect repaired/E8_* --mass-g 33 --out found/
  crazyflie diagnose --normal normal/ --suspect odd/ --json";

/// Name what is wrong with a vehicle: an added weight, a weak motor or a swinging load, from the motors in its logs.
///
/// Files of one folder are one set-up (one battery put in, one trim); where file names begin alike up to an underscore on both sides (E8_log00),
/// that names the vehicle. All suspect flights are of one condition.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Logs, or folders of logs, of the vehicle as it should be
    #[arg(long, required = true, num_args = 1.., value_name = "LOG|FOLDER")]
    normal: Vec<PathBuf>,
    /// Logs, or folders of logs, that may have something wrong
    #[arg(long, required = true, num_args = 1.., value_name = "LOG|FOLDER")]
    suspect: Vec<PathBuf>,
    /// Model file whose mass and motors are meant [default: the thesis's]
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// Mass of the normal vehicle in grams, for what is added to it [default: the model's]
    #[arg(long, value_name = "GRAMS")]
    mass_g: Option<f64>,
    /// Draw the trims
    #[arg(long, value_parser = files::picture, value_name = "FILE.svg")]
    picture: Option<PathBuf>,
    /// Leave report.md, report.json and trims.svg here
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// For machines
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let mut model = files::model(args.model.as_deref())?;
    if let Some(mass_g) = args.mass_g {
        model = model.with_parameter("vehicle.mass", 1e-3 * mass_g)?;
    }
    let demands = effect_demands(&hovering(&model))?;
    let mut unread = Vec::new();
    let normal = read_trims(&args.normal, &mut unread)?;
    let suspect = read_trims(&args.suspect, &mut unread)?;
    let mut diagnosis = diagnose(&normal, &suspect, &demands).map_err(|e| Failure::Failed(e.to_string() + &list(&unread)))?;
    diagnosis.left_out.extend(unread);
    let json = serde_json::to_string_pretty(&report::as_json(&diagnosis, &demands))?;
    let text = report::as_text(&diagnosis, &demands);
    if let Some(picture) = &args.picture {
        files::write(picture, report::picture(&diagnosis)?.as_bytes())?;
    }
    if let Some(folder) = &args.out {
        files::write(&folder.join("report.json"), json.as_bytes())?;
        files::write(&folder.join("report.md"), report::as_markdown(&diagnosis, &demands).as_bytes())?;
        files::write(&folder.join("trims.svg"), report::picture(&diagnosis)?.as_bytes())?;
    }
    if args.json {
        writeln!(out, "{json}")?;
    } else {
        write!(out, "{text}")?;
    }
    Ok(())
}

fn list(lines: &[String]) -> String {
    lines.iter().map(|line| format!("\n  {line}")).collect()
}

/// A model with a thrust form, which the demands are flown with; the thesis's if there is none.
fn hovering(model: &Model) -> Model {
    if model.parameter("vertical.thrust.hover").is_ok() { model.clone() } else { Model::thesis() }
}

/// Trims of all logs. A log that is named must have one; a file found in a folder may be something else.
pub(crate) fn read_trims(paths: &[PathBuf], left_out: &mut Vec<String>) -> Outcome<Vec<FlightTrim>> {
    let mut trims = Vec::new();
    for path in paths {
        if path.is_dir() {
            for file in files_below(path)? {
                match read_trim(&file) {
                    Ok(trim) => trims.push(trim),
                    Err(why) => left_out.push(why),
                }
            }
        } else {
            match read_trim(path) {
                Ok(trim) => trims.push(trim),
                Err(why) if path.exists() => left_out.push(why),
                Err(why) => return Err(Failure::Failed(why)),
            }
        }
    }
    Ok(trims)
}

fn read_trim(path: &Path) -> Result<FlightTrim, String> {
    let log = FlightLog::read(path).map_err(|e| super::with_cause(&e))?;
    let folder = path.parent().map_or(String::new(), |p| p.display().to_string());
    let file = path.file_name().map_or(String::new(), |n| n.to_string_lossy().into_owned());
    FlightTrim::from_log(&folder, &file, &log).map_err(|e| e.to_string())
}

/// All files below a folder, in order of their names.
fn files_below(folder: &Path) -> Outcome<Vec<PathBuf>> {
    let failed = |e| Failure::about(folder.display(), e);
    let entries: Result<Vec<_>, _> = std::fs::read_dir(folder).map_err(failed)?.collect();
    let mut paths: Vec<PathBuf> = entries.map_err(failed)?.into_iter().map(|e| e.path()).collect();
    paths.sort();
    let mut found = Vec::new();
    for path in paths {
        if path.is_dir() { found.extend(files_below(&path)?) } else { found.push(path) }
    }
    Ok(found)
}
