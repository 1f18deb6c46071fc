//! `crazyflie identify`: transfer functions and the numbers of a model from flight logs.

use std::io::Write;
use std::path::{Path, PathBuf};

use crazyflie_env::model::{Model, PwmSource, VerticalInput};
use crazyflie_identify::FlightLog;
use crazyflie_identify::estimate::Comparison;
use crazyflie_identify::motor::form::{self, MotorRecord};
use crazyflie_identify::transfer::{self, Channel, Offset, Record, Structure, WindowLength};
use crazyflie_identify::vehicle;
use crazyflie_logs::AttitudeSource;
use indicatif::ProgressBar;

use super::open::OpenArgs;
use super::{Failure, Outcome, files, identify_motors_table, identify_table};

/// Identify a vehicle from flight logs: the numbers of a model file, or a transfer function of a given order.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Model to start from: a vehicle by name (see `crazyflie vehicles`), or its model file or data sheet
    /// [default: cf2-thesis]
    #[arg(value_name = "MODEL")]
    model: Option<PathBuf>,
    /// Logs to fit
    #[arg(long, num_args = 1.., value_name = "LOG", required = true)]
    fit: Vec<PathBuf>,
    /// Logs to judge by, which the fit does not see
    #[arg(long, num_args = 1.., value_name = "LOG")]
    test: Vec<PathBuf>,
    /// Numbers of the model to fit, such as roll.gain or vertical.thrust.hover [default: all that these logs
    /// determine]
    #[arg(long, num_args = 1.., value_name = "PATH", conflicts_with = "transfer")]
    free: Vec<String>,
    /// Fit a transfer function instead: roll, pitch, yaw, height, pwm, vx, vy (from the measured angle),
    /// command-vx, command-vy
    #[arg(long, value_parser = |name: &str| Channel::from_name(name).map_err(|e| e.to_string()), value_name = "CHANNEL")]
    transfer: Option<Channel>,
    /// Degrees of numerator and denominator; repeat to compare orders [default: the thesis's]
    #[arg(long, value_parser = order, value_name = "N,D", requires = "transfer")]
    order: Vec<(usize, usize)>,
    /// Put one pole at zero, or not [default: as in the thesis]
    #[arg(long, value_name = "BOOL", requires = "transfer")]
    integrator: Option<bool>,
    /// Fit a delay of the input as well
    #[arg(long, requires = "transfer")]
    delay: bool,
    /// Zero of the input: none (zero), one for all flights, or each its own [default: one for pwm, else none]
    #[arg(long, value_parser = offset, value_name = "none|one|each", requires = "transfer")]
    offset: Option<Offset>,
    /// Allow no pole to the right of zero
    #[arg(long, requires = "transfer")]
    stable: bool,
    /// Seconds of a window, which has an initial state of its own; whole for one per flight [default: 2, for
    /// slow channels 5 or 10]
    #[arg(long, value_parser = window, value_name = "SECONDS|whole", requires = "transfer")]
    window: Option<WindowLength>,
    /// Vertical form of the model that is fitted: height, pwm or thrust, or motors, from logs of motors, gyro
    /// and accelerometer [default: as the logs command]
    #[arg(long, visible_alias = "form", value_parser = files::vertical, value_name = "FORM", conflicts_with = "transfer")]
    vertical: Option<VerticalInput>,
    /// Source of the PWM that drives the model: command (the thrust command), or motors (mean motor
    /// PWM times battery voltage) [default: motors where flights have trims of their own and all logs hold it]
    #[arg(long, value_parser = |name: &str| PwmSource::named(name).map_err(|e| e.to_string()), value_name = "SOURCE", conflicts_with = "transfer")]
    pwm_source: Option<PwmSource>,
    /// Let every flight have trims and a hover PWM of its own [default: true under motion capture]
    #[arg(long, value_name = "BOOL", conflicts_with = "transfer")]
    trim: Option<bool>,
    /// Effects to fit as a part of the model; none for no effect [default: those of the powertrain where
    /// flights have trims of their own and command the thrust]
    #[arg(long, num_args = 1.., value_name = "EFFECT", conflicts_with = "transfer")]
    effects: Vec<String>,
    /// Mass of the vehicle that flew, in kilograms: it does not follow from logs [default: that of the model to start from]
    #[arg(long, value_name = "KG", conflicts_with = "transfer")]
    mass: Option<f64>,
    /// Name of the model that is found [default: the name of the file of --out]
    #[arg(long, value_name = "NAME", conflicts_with = "transfer")]
    name: Option<String>,
    #[command(flatten)]
    logs: OpenArgs,
    /// Write the model with what was found
    #[arg(long, value_name = "FILE.toml")]
    out: Option<PathBuf>,
    /// Draw prediction, measurement and the correlations of the residuals
    #[arg(long, value_parser = files::picture, value_name = "FILE.svg|png|pdf")]
    picture: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

fn order(text: &str) -> Result<(usize, usize), String> {
    let parsed =
        text.split_once(',').and_then(|(n, d)| Some((n.trim().parse().ok()?, d.trim().parse().ok()?)));
    parsed.ok_or_else(|| "expected two degrees such as 0,2".into())
}

fn offset(text: &str) -> Result<Offset, String> {
    match text {
        "none" => Ok(Offset::None),
        "one" => Ok(Offset::Shared),
        "each" => Ok(Offset::PerFlight),
        _ => Err("expected none, one or each".into()),
    }
}

fn window(text: &str) -> Result<WindowLength, String> {
    if text == "whole" {
        return Ok(WindowLength::Whole);
    }
    files::seconds(text, 0.5, 3600.0).map(WindowLength::Seconds).map_err(|e| format!("{e}, or whole"))
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let model = files::model(args.model.as_deref())?;
    let (fit, test) = (read(args, &args.fit)?, read(args, &args.test)?);
    vehicle::refuse_duplicates(&fit.iter().chain(&test).collect::<Vec<_>>())?;
    if args.model.is_some() {
        args.logs.warn_of_motors(&model, args.mass, fit.iter().map(|(_, log)| log));
    }
    match (args.transfer, args.vertical) {
        (Some(channel), _) => transfer(args, channel, &model, (&fit, &test), out),
        (None, Some(VerticalInput::Motors)) => identify_motors(args, &model, (&fit, &test), out),
        (None, _) => identify_model(args, &model, (&fit, &test), out),
    }
}

type Logs = [(String, FlightLog)];

/// Logs with short names; files of one name in two folders keep their paths.
fn read(args: &Args, paths: &[PathBuf]) -> Outcome<Vec<(String, FlightLog)>> {
    let short = |path: &Path| super::files::stem(&path.display().to_string());
    let name = |path: &PathBuf| {
        let alone = paths.iter().filter(|other| short(other) == short(path)).count() == 1;
        if alone { short(path) } else { path.display().to_string() }
    };
    let read = |path: &PathBuf| Ok((name(path), args.logs.open(path)?));
    paths.iter().map(read).collect()
}

fn transfer(
    args: &Args,
    channel: Channel,
    model: &Model,
    (fit, test): (&Logs, &Logs),
    out: &mut dyn Write,
) -> Outcome {
    let records = |logs: &Logs| {
        logs.iter().map(|(name, log)| Record::from_log(name, log, channel)).collect::<Result<Vec<_>, _>>()
    };
    let (fit, test) = (records(fit)?, records(test)?);
    let structures = structures(args, channel);
    let bar =
        if structures.len() > 1 { ProgressBar::new(structures.len() as u64) } else { ProgressBar::hidden() };
    let (mut found, mut failed) = (Vec::new(), Vec::new());
    for structure in structures {
        match transfer::identify(&fit, channel, structure, args.window.unwrap_or(WindowLength::OfChannel)) {
            Ok(identified) => {
                let held_out = identified.compare(&test)?;
                found.push((identified, held_out));
            }
            Err(error) => failed.push((identify_table::order(&structure), error)),
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    // an order too high for the logs is worth saying, but the others are still worth printing
    if found.is_empty() && !failed.is_empty() {
        return Err(failed.remove(0).1.into());
    }
    let failed: Vec<String> =
        failed.into_iter().map(|(order, error)| format!("order {order}: {error}")).collect();
    // the first is the best
    found.sort_by(|(a, _), (b, _)| a.criteria.bic.total_cmp(&b.criteria.bic));
    if args.json {
        args.logs.write_json(identify_table::transfer_json(&found, &failed), out)?;
    } else {
        identify_table::transfer(&found, &failed, out)?;
    }
    let Some((best, held_out)) = found.first() else { return Ok(()) };
    if let Some(file) = &args.out {
        let names: Vec<&str> = fit.iter().map(|r| r.name.as_str()).collect();
        write_model(file, &best.in_model(model, &names.join(", "))?)?;
    }
    files::picture_to(args.picture.as_ref(), || identify_table::picture(&best.fit, held_out))
}

fn structures(args: &Args, channel: Channel) -> Vec<Structure> {
    let usual = channel.structure();
    let orders =
        if args.order.is_empty() { vec![(usual.numerator, usual.denominator)] } else { args.order.clone() };
    let structure = |(numerator, denominator): (usize, usize)| Structure {
        numerator,
        denominator,
        integrator: args.integrator.unwrap_or(usual.integrator),
        delay: args.delay,
        offset: args.offset.unwrap_or(usual.offset),
        stable: args.stable,
    };
    orders.into_iter().map(structure).collect()
}

fn identify_model(args: &Args, model: &Model, (fit, test): (&Logs, &Logs), out: &mut dyn Write) -> Outcome {
    let plan = plan(args, model, fit);
    let bar = ProgressBar::new(vehicle::STAGES as u64);
    let fitted = vehicle::identify(model, fit, &plan, &|| bar.inc(1))?;
    let judged = if test.is_empty() {
        None
    } else {
        Some([fitted.compare_with(model, test)?, fitted.compare_logs(test)?])
    };
    bar.finish_and_clear();
    let before_fit = fitted.compare_with(model, fit)?;
    let shown = identify_table::ModelIdentification {
        found: &fitted,
        before_fit: &before_fit,
        test: judged.as_ref(),
        mass_is_given: args.mass.is_some(),
    };
    if args.json {
        args.logs.write_json(identify_table::model_json(&shown), out)?;
    } else {
        identify_table::write_model(&shown, out)?;
    }
    let predicted: &[Comparison] = judged.as_ref().map_or(&[], |[_, after]| &after.comparisons);
    files::picture_to(args.picture.as_ref(), || identify_table::picture(&fitted.fit.comparisons, predicted))?;
    if let Some(sentence) = identify_table::unexplained(&fitted) {
        return Err(Failure::Failed(format!(
            "{sentence}: look at signs, units and lags with `crazyflie inspect`, or name the numbers to fit with --free"
        )));
    }
    args.out.as_ref().map_or(Ok(()), |file| write_model(file, &fitted.model))
}

/// Name of the model that is found: as given, or that of its file.
fn model_name(args: &Args) -> Option<String> {
    let stem = |file: &PathBuf| file.file_stem().map(|stem| stem.to_string_lossy().into_owned());
    args.name.clone().or_else(|| args.out.as_ref().and_then(stem))
}

/// Identifies the motor-level form, for the mass and the arm of the model.
fn identify_motors(args: &Args, model: &Model, (fit, test): (&Logs, &Logs), out: &mut dyn Write) -> Outcome {
    let idle = [
        ("--free", !args.free.is_empty()),
        ("--pwm-source", args.pwm_source.is_some()),
        ("--trim", args.trim.is_some()),
        ("--effects", !args.effects.is_empty()),
        ("--picture", args.picture.is_some()),
    ];
    if let Some((option, _)) = idle.into_iter().find(|(_, is_given)| *is_given) {
        return Err(Failure::Usage(format!("{option} has no meaning with --vertical motors")));
    }
    let model = match args.mass {
        Some(mass_kg) => model.with_parameter("vehicle.mass", mass_kg)?,
        None => model.clone(),
    };
    let records = |logs: &Logs| {
        logs.iter().map(|(name, log)| MotorRecord::from_log(name, log, &model)).collect::<Result<Vec<_>, _>>()
    };
    let (fit, test) = (records(fit)?, records(test)?);
    let mut fitted = form::identify_motors(&model, &fit)?;
    if let Some(name) = model_name(args) {
        fitted.model.name = name;
    }
    let shown = identify_motors_table::MotorIdentification {
        before: &model,
        found: &fitted,
        flights: fit.len(),
        test: &test,
    };
    if args.json {
        args.logs.write_json(identify_motors_table::as_json(&shown), out)?;
    } else {
        identify_motors_table::write(&shown, out)?;
    }
    args.out.as_ref().map_or(Ok(()), |file| write_model(file, &fitted.model))
}

/// Plan of the fit, by the options and otherwise by the contents of the logs.
fn plan(args: &Args, model: &Model, fit: &Logs) -> vehicle::FitOptions {
    let nuisance = args.trim.unwrap_or_else(|| {
        fit.iter().any(|(_, log)| log.provenance.attitude == AttitudeSource::MotionCapture)
    });
    // a motor-level form is none that is fitted
    let vertical = args.vertical.or(model.default_input());
    let best_source = vehicle::best_pwm_source(fit);
    let holds_thrust =
        best_source == PwmSource::Motors || fit.iter().all(|(_, log)| log.cmd_thrust_pwm.is_some());
    let commands_thrust = holds_thrust && vertical.is_none_or(|v| v == VerticalInput::Thrust);
    let is_chosen = best_source == PwmSource::Command || nuisance && commands_thrust;
    let effects = match &args.effects[..] {
        [] if nuisance && commands_thrust => vehicle::ubiquitous_effects(fit),
        [none] if none == "none" => Vec::new(),
        named => named.to_vec(),
    };
    // effects that the model declares are a part of it already
    let effects = effects.into_iter().filter(|name| !model.effects.contains_key(name)).collect();
    let name = model_name(args);
    vehicle::FitOptions {
        free: (!args.free.is_empty()).then(|| args.free.clone()),
        vertical: args.vertical,
        pwm_source: args.pwm_source.or_else(|| is_chosen.then_some(best_source)),
        nuisance,
        effects,
        name,
        mass_kg: args.mass,
    }
}

fn write_model(file: &Path, model: &Model) -> Outcome {
    files::write(file, model.to_toml()?.as_bytes())
}

/// Logs that do not suffice are a failure; wrong options are the user's error.
impl From<crazyflie_identify::Error> for Failure {
    fn from(error: crazyflie_identify::Error) -> Self {
        match error {
            crazyflie_identify::Error::Model(error) => error.into(),
            crazyflie_identify::Error::Options(words) => Failure::Usage(words),
            other => Failure::Failed(other.to_string()),
        }
    }
}
