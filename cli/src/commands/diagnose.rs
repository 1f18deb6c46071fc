//! `crazyflie diagnose`: suspect flights against normal ones, by the motors' demand in hover.

use std::io::Write;
use std::path::PathBuf;

use crazyflie_env::model::Model;
use crazyflie_identify::diagnose::demand::effect_demands;
use crazyflie_identify::diagnose::diagnose;

use super::files::ModelArg;
use super::open::OpenArgs;
use super::{Failure, Outcome, files, listed, write_json};
use crate::{diagnosis as report, trims::read_trims};

/// Name what is wrong with a vehicle: an added weight, a weak motor or a swinging load, from the motors in
/// its logs.
///
/// Files of one folder are one set-up (one battery put in, one trim); where file names begin alike up to an
/// underscore on both sides (E8_log00), that names the vehicle. All suspect flights are of one condition.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Logs, or folders of logs, of the vehicle as it should be
    #[arg(long, required = true, num_args = 1.., value_name = "LOG|FOLDER")]
    normal: Vec<PathBuf>,
    /// Logs, or folders of logs, that may have something wrong
    #[arg(long, required = true, num_args = 1.., value_name = "LOG|FOLDER")]
    suspect: Vec<PathBuf>,
    #[command(flatten)]
    model: ModelArg,
    /// Mass of the normal vehicle in grams, for what is added to it [default: the model's]
    #[arg(long, value_name = "GRAMS")]
    mass_g: Option<f64>,
    #[command(flatten)]
    logs: OpenArgs,
    /// Draw the trims
    #[arg(long, value_parser = files::picture, value_name = "FILE.svg|png|pdf")]
    picture: Option<PathBuf>,
    /// Folder for report.md, report.json and trims.svg
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let (model, mass_kg) = (args.model.read()?, args.mass_g.map(|mass_g| 1e-3 * mass_g));
    let weighed = mass_kg.map_or(Ok(model.clone()), |kg| model.with_parameter("vehicle.mass", kg))?;
    let demands = effect_demands(&hovering(&weighed))?;
    let mut unread = Vec::new();
    let (normal_logs, normal) = read_trims(&args.normal, &args.logs, &mut unread)?;
    let (_, suspect) = read_trims(&args.suspect, &args.logs, &mut unread)?;
    if args.model.is_given() {
        args.logs.warn_of_motors(&model, mass_kg, &normal_logs);
    }
    let mut diagnosis = diagnose(&normal, &suspect, &demands)
        .map_err(|e| Failure::Failed(e.to_string() + &listed(&unread)))?;
    diagnosis.left_out.extend(unread);
    let json = args.logs.with_warnings(report::as_json(&diagnosis, &demands));
    let text = report::as_text(&diagnosis, &demands);
    files::picture_to(args.picture.as_ref(), || report::picture(&diagnosis))?;
    if let Some(folder) = &args.out {
        files::write(&folder.join("report.json"), serde_json::to_string_pretty(&json)?.as_bytes())?;
        files::write(&folder.join("report.md"), report::as_markdown(&diagnosis, &demands).as_bytes())?;
        files::write_picture(&folder.join("trims.svg"), &report::picture(&diagnosis)?)?;
    }
    if args.json {
        return write_json(&json, out);
    }
    Ok(write!(out, "{text}")?)
}

/// A model with a thrust form, which the demands are flown with; the thesis's if there is none.
fn hovering(model: &Model) -> Model {
    if model.parameter("vertical.thrust.hover").is_ok() { model.clone() } else { Model::thesis() }
}
