//! `crazyflie replay`: recorded commands drive the model open loop.

use std::io::Write;
use std::path::{Path, PathBuf};

use crazyflie_env::model::{Model, Vehicle, VerticalInput};
use crazyflie_identify::FlightLog;
use crazyflie_identify::replay::{HoverSource, Replay, ReplayOptions, replay};
use serde_json::json;

use super::open::OpenArgs;
use super::{Failure, Outcome, files, replay_table};

/// Replay recorded flights: their commands drive the model, and its prediction is compared with the
/// measurement.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Logs of any format that crazyflie inspect reads; a first file ending in .toml or .json is the model
    #[arg(required = true, value_name = "[MODEL] LOG")]
    files: Vec<PathBuf>,
    /// Start again from the measurement every so many seconds [default: the free run, and horizons of 2 and
    /// 0.5 s]
    #[arg(long, value_parser = |text: &str| files::seconds(text, 0.01, 3600.0), value_name = "SECONDS")]
    horizon: Option<f64>,
    /// Vertical form of the model that is driven: height, pwm or thrust [default: the first whose command the
    /// log holds]
    #[arg(long, value_parser = files::vertical, value_name = "FORM")]
    vertical: Option<VerticalInput>,
    /// The PWM that carries the vehicle, for the thrust form: a number, or auto for the median thrust command
    /// of each flight
    #[arg(long, value_parser = str::parse::<HoverSource>, value_name = "auto|PWM")]
    hover_pwm: Option<HoverSource>,
    /// Give the model the measured yaw rate instead of zero, if a log has no yaw-rate command
    #[arg(long)]
    measured_yaw_rate: bool,
    #[command(flatten)]
    logs: OpenArgs,
    /// Draw measurement and prediction; a folder if there are several logs
    #[arg(long, value_parser = files::picture_or_folder, value_name = "FILE.svg|png|pdf")]
    picture: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// One log, replayed over several horizons (`None` is the free run).
pub(super) struct LogReplay {
    pub file: String,
    pub log: FlightLog,
    pub runs: Vec<(Option<f64>, Replay)>,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let (model, logs) = inputs(&args.files)?;
    files::check_target(args.picture.as_deref(), logs.len())?;
    let (replays, failed) = files::each(logs, |path| replay_file(args, &model, path))?;
    args.logs.warn_of_motors(&model, None, replays.iter().map(|r| &r.log));
    if args.json {
        let logs: Vec<_> = replays.iter().map(replay_table::as_json).collect();
        args.logs.write_json(json!({"model": model.name, "logs": logs, "failed": failed}), out)?;
    } else {
        replay_table::write(&replays, &model.name, out)?;
    }
    for r in &replays {
        files::write_log_picture(args.picture.as_deref(), &r.file, || replay_table::picture(r))?;
    }
    files::refuse_failed(&failed, logs.len(), "could not be replayed")
}

/// The model and the logs that the arguments name.
fn inputs(paths: &[PathBuf]) -> Outcome<(Model, &[PathBuf])> {
    let is_file = |path: &Path| path.extension().is_some_and(|e| e == "toml" || e == "json");
    let is_model = |path: &Path| is_file(path) || Vehicle::name_in(path).is_some();
    let (model, logs) = match paths.split_first() {
        Some((first, rest)) if is_model(first) => (files::model(Some(first))?, rest),
        _ => (files::model(None)?, paths),
    };
    if logs.is_empty() {
        return Err(Failure::Usage("name at least one log after the model".into()));
    }
    Ok((model, logs))
}

fn replay_file(args: &Args, model: &Model, path: &Path) -> Outcome<LogReplay> {
    let file = path.display().to_string();
    let log = args.logs.open(path)?;
    let horizons = args.horizon.map_or(vec![None, Some(2.0), Some(0.5)], |h| vec![Some(h)]);
    let mut runs = Vec::new();
    for horizon_s in horizons {
        let plan = ReplayOptions {
            vertical: args.vertical,
            horizon_s,
            hover: args.hover_pwm.unwrap_or(HoverSource::OfModel),
            measured_yaw_rate: args.measured_yaw_rate,
        };
        let done = replay(model, &log, &plan).map_err(|e| Failure::about(&file, e))?;
        runs.push((horizon_s, done));
    }
    Ok(LogReplay { file, log, runs })
}
