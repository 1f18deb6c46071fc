//! `crazyflie fly`: a closed loop of model, effects and controller.

use std::io::Write;
use std::path::{Path, PathBuf};

use crazyflie_control::{ControllerSpec, ObservationSpec};
use crazyflie_env::action::ActionLevel;
use crazyflie_env::config::{EffectParams, EffectTable, Number, Options};
use crazyflie_env::effects::{check_effects, find};
use crazyflie_env::model::VerticalInput;
use crazyflie_env::task_file::TaskFile;
use crazyflie_picture::{Drawing, FilmFormat, PictureError};
use indicatif::ProgressBar;
use serde_json::{Value, json};

use super::files::ModelArg;
use super::{Failure, Outcome, controllers, files, fly_multi_drone, fly_table, write_json};
use crazyflie_server::flight::{
    self, EPISODE_HZ, Figures, FlightScenario, MultiDroneSetup, OwnTask, Setup, Trace,
};

/// Fly a task or one of the thesis's flights with a controller, and print the figures of the flight.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// A task, of one drone or of several, a flight of the thesis (see `crazyflie tasks`), or a task file that ends in
    /// .toml or .json
    #[arg(long, default_value = "hover", value_name = "NAME|FILE")]
    task: String,
    /// Task, the same as --task
    #[arg(value_name = "TASK", conflicts_with = "task")]
    named: Option<String>,
    /// The task's options, as JSON; they override those of a task file
    #[arg(long, value_name = "JSON")]
    task_options: Option<String>,
    /// CSV file with the track of the task `track`: columns t_s, x_m, y_m, z_m and optionally yaw_rad or
    /// yaw_deg
    #[arg(long, value_name = "FILE.csv")]
    track: Option<PathBuf>,
    /// Controller, as NAME, NAME:FILE or python:FILE:NAME (see `crazyflie controllers`); for several drones
    /// one each, separated by commas, or one for all [default: thesis-pid, or that of the flight]
    #[arg(long, value_name = "NAME")]
    controller: Option<String>,
    /// The controller's options, as JSON, merged with its defaults; a list for several
    #[arg(long, value_name = "JSON")]
    controller_options: Option<String>,
    /// Level of the controller's actions (see `crazyflie actions`) [default: attitude, or as the task file says]
    #[arg(long, value_name = "LEVEL")]
    action: Option<String>,
    /// An effect as NAME=VALUE or NAME.PARAMETER=VALUE, or several as JSON; may be repeated (see `crazyflie
    /// effects`)
    #[arg(long, value_name = "EFFECT")]
    effects: Vec<String>,
    /// ideal, or lab: a 30 Hz camera with 50 ms latency and noise; --effects add to them
    #[arg(long, default_value = "ideal", value_name = "NAME")]
    sensors: String,
    #[command(flatten)]
    model: ModelArg,
    /// Number of drones for a task of several [default: as the task says]
    #[arg(long, value_name = "N")]
    drones: Option<usize>,
    /// Keep several drones out of each other's way
    #[arg(long)]
    collision_avoidance: bool,
    /// Vertical form of the model that is commanded: height, pwm, thrust or motors [default: pwm, if the
    /// model has it]
    #[arg(long, value_parser = files::vertical, value_name = "FORM")]
    vertical: Option<VerticalInput>,
    /// Length of the flight [default: as the task says]
    #[arg(long, value_parser = |text: &str| files::seconds(text, 0.1, 3600.0))]
    seconds: Option<f64>,
    /// Seed of starts, noise and drawn parameters
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Number of seeds to fly, from --seed on; several print median and spread
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000), value_name = "N")]
    runs: u32,
    /// Write the (first) flight as a log that `replay` reads: CSV, or MCAP for a file ending in .mcap; of
    /// several drones one file each, FILE-0 and so on
    #[arg(long, visible_alias = "log", value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw the (first) flight over time
    #[arg(long, value_parser = files::picture, value_name = "FILE.svg|png|pdf")]
    picture: Option<PathBuf>,
    /// Draw the (first) flight's path through space
    #[arg(long, value_parser = files::picture, value_name = "FILE.svg|png|pdf")]
    picture3d: Option<PathBuf>,
    /// Film the (first) flight: the vehicle with its tilt, 20 frames a second; webp and mp4 need the program ffmpeg
    #[arg(long, value_parser = files::film, value_name = "FILE.gif|webp|mp4")]
    film: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Flights per batch: what is kept in memory at once.
const BATCH: usize = 64;

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let mut controllers = chosen(args)?;
    let setup = setup(args, &mut controllers)?;
    Failure::unless(args.csv.is_none() || setup.action.is_default(), || {
        let level = setup.action.name();
        format!(
            "--csv: a log holds the commands, and of actions of the level {level} only the onboard cascade knows them"
        )
    })?;
    if setup.scenario.flies_several()? {
        return fly_multi_drone(args, &setup, controllers, out);
    }
    let (name, count) = (setup.name(), controllers.len());
    Failure::unless(count == 1, || format!("--controller names {count} controllers, {name} has one drone"))?;
    let alone = !args.collision_avoidance && args.drones.is_none_or(|drones| drones == 1);
    Failure::unless(alone, || {
        format!("--drones and --collision-avoidance are for tasks of several drones, {name} has one")
    })?;
    let (all, first) = fly_all(args, &setup)?;
    if let Some(file) = &args.csv {
        files::write_log(file, &flight::log(&first))?;
    }
    let traces = std::slice::from_ref(&first);
    draw(args, &setup, traces, |title| flight::picture(&first, title), |title| flight::path(&first, title))?;
    tell(args, &setup, &setup.effects, &all, out, |out| fly_table::write(&all, &first, out))
}

/// Writes setup and runs for machines, or the setup and a table.
fn tell(
    args: &Args,
    setup: &Setup,
    effects: &EffectTable,
    runs: &[impl serde::Serialize],
    out: &mut dyn Write,
    table: impl FnOnce(&mut dyn Write) -> Outcome,
) -> Outcome {
    let (flight, controller, vertical) = (setup.name(), &setup.controller.label, setup.vertical.name());
    let (action, model, seconds, seed) = (setup.action.name(), &setup.model.name, setup.seconds, args.seed);
    if args.json {
        let setup = json!({"flight": flight, "controller": controller, "vertical": vertical, "action": action,
            "model": model, "seconds": seconds, "seed": seed, "effects": effects});
        return write_json(&json!({"setup": setup, "runs": runs}), out);
    }
    let effects = if effects.is_empty() { "none".into() } else { serde_json::to_string(effects)? };
    let how = format!("actions {action}, {seconds} s, seed {seed}, effects {effects}");
    writeln!(out, "{flight}: {}", setup.about())?;
    writeln!(out, "model {model}, vertical form {vertical}, controller {controller}, {how}\n")?;
    table(out)
}

/// Draws the requested pictures: the flight over time, its path, and a film.
fn draw(
    args: &Args,
    setup: &Setup,
    traces: &[Trace],
    over_time: impl FnOnce(&str) -> Result<Drawing, PictureError>,
    path: impl FnOnce(&str) -> Result<Drawing, PictureError>,
) -> Outcome {
    let title = format!("{}, {}, seed {}", setup.name(), setup.controller.label, args.seed);
    files::picture_to(args.picture.as_ref(), || over_time(&title))?;
    files::picture_to(args.picture3d.as_ref(), || path(&title))?;
    let Some(file) = &args.film else { return Ok(()) };
    let film = flight::film(traces).and_then(|film| film.encode(FilmFormat::from_path(file)?));
    files::write(file, &film.map_err(|e| Failure::about(file.display(), e))?)
}

/// The seeds of the flights.
fn seeds(args: &Args) -> Vec<u64> {
    (0..u64::from(args.runs)).map(|i| args.seed.wrapping_add(i)).collect()
}

/// The requested controllers, or that of the flight.
fn chosen(args: &Args) -> Outcome<Vec<ControllerSpec>> {
    let options = args.controller_options.as_deref();
    let named = FlightScenario::find(args.named.as_ref().unwrap_or(&args.task));
    match (&args.controller, named.ok().and_then(|flight| flight.controller)) {
        (Some(names), _) => controllers::chosen_each(names, options),
        (None, Some((name, own))) => controllers::chosen_each(name, Some(options.unwrap_or(own))),
        (None, None) => controllers::chosen_each("thesis-pid", options),
    }
}

fn setup(args: &Args, controllers: &mut [ControllerSpec]) -> Outcome<Setup> {
    let named = args.named.as_ref().unwrap_or(&args.task);
    let own = own_task(named)?;
    let asked = own.as_ref().map(|own| &own.options);
    if let Some(Options { observation, history, .. }) = asked {
        let spec = ObservationSpec { observation: observation.clone(), history: *history, others: 0 };
        controllers.iter_mut().for_each(|controller| controller.task_observation = spec.clone());
    }
    let scenario = FlightScenario::find(asked.map_or(named, |options| &options.task))?;
    // there is one at least: of several drones each may have its own, see `fly_multi_drone`
    let labels: Vec<&str> = controllers.iter().map(|controller| &controller.label[..]).collect();
    let mut controller = controllers[0].clone();
    controller.label = labels.join(",");
    let trained = controller.trained_for();
    let (mut effects, _) = flight::sensor_rig(&args.sensors)?;
    effects.extend(asked.map(|options| options.effects.clone()).unwrap_or_default());
    args.effects.iter().try_for_each(|text| add_effects(&mut effects, text))?;
    check_effects(&effects)?;
    let of_file = asked.map(|options| &options.task_options);
    let (given, track) = (args.task_options.as_deref(), args.track.as_deref());
    let task_options = task_options(scenario.task, of_file, given, track)?;
    let model = args.model.read()?;
    let vertical = args.vertical.or(asked.and_then(|options| options.vertical));
    let vertical = vertical.or(trained.map(|(_, form)| form)).or(scenario.vertical);
    let vertical = vertical.unwrap_or_else(|| files::default_vertical(&model));
    let action = match &args.action {
        Some(name) => ActionLevel::named(name)?,
        None => asked.map(|options| options.action).or(trained.map(|(level, _)| level)).unwrap_or_default(),
    };
    let length_s = asked.map(|options| f64::from(options.max_episode_steps) / EPISODE_HZ);
    let seconds = args.seconds.or(length_s).unwrap_or(scenario.seconds);
    Ok(Setup { model, scenario, task_options, own, action, controller, effects, vertical, seconds })
}

/// The task of a file, where `--task` names one.
pub(super) fn own_task(task: &str) -> Outcome<Option<OwnTask>> {
    let file = Path::new(task);
    if !file.extension().is_some_and(|ending| ending == "toml" || ending == "json") {
        return Ok(None);
    }
    let failed = |error: &dyn std::fmt::Display| Failure::about(file.display(), error);
    let text = std::fs::read_to_string(file).map_err(|e| failed(&e))?;
    let TaskFile { name, about, options } = TaskFile::parse(&text).map_err(|e| failed(&e))?;
    let options = Options::parse(&Value::Object(options).to_string()).map_err(|e| failed(&e))?;
    Ok(Some(OwnTask { name, about, options }))
}

/// Options of the task, if any are given: those of the task file, then `--task-options`, then `--track`.
pub(super) fn task_options(
    task: &str,
    of_file: Option<&Value>,
    given: Option<&str>,
    track: Option<&Path>,
) -> Outcome<Option<Value>> {
    let mut options = of_file.cloned().unwrap_or_default();
    if let Some(text) = given {
        let more: Value = serde_json::from_str(text)
            .map_err(|e| Failure::Usage(format!("--task-options is not JSON: {e}")))?;
        match (&mut options, more) {
            (Value::Object(options), Value::Object(more)) => options.extend(more),
            (options, more) => *options = more,
        }
    }
    if let Some(file) = track {
        Failure::unless(task == "track", || format!("--track is for the task track, --task is {task}"))?;
        let text = std::fs::read_to_string(file).map_err(|e| Failure::about(file.display(), e))?;
        let points = crazyflie_env::task::track_rows(&text, &file.display().to_string())?;
        if options.is_null() {
            options = json!({});
        }
        options["points"] = json!(points);
    }
    Ok((!options.is_null()).then_some(options))
}

/// Adds the effects of one `--effects`.
pub(super) fn add_effects(table: &mut EffectTable, text: &str) -> Outcome {
    if text.trim_start().starts_with('{') {
        let more: EffectTable = serde_json::from_str(text)
            .map_err(|e| Failure::Usage(format!("--effects is not a JSON object of effects: {e}")))?;
        table.extend(more);
        return Ok(());
    }
    let (path, value) = text.split_once('=').unwrap_or((text, ""));
    let (name, param) = path.split_once('.').unwrap_or((path, ""));
    let (_, entry) = find(name)?;
    let names = || entry.params.iter().map(|p| p.name);
    Failure::unless(!value.is_empty(), || {
        let known = names().collect::<Vec<_>>().join(", ");
        format!("the effect {name} needs a value: {name}.PARAMETER=VALUE with one of {known}")
    })?;
    let param = if param.is_empty() { names().next().unwrap_or_default() } else { param };
    let number = match value.parse::<f64>() {
        Ok(number) => Number::Fixed(number),
        Err(_) => serde_json::from_str(value).map_err(|_| {
            Failure::Usage(format!("--effects {text}: {value:?} is neither a number nor a distribution such as {{\"uniform\": [0, 1]}}"))
        })?,
    };
    // parameters of one effect may come one by one
    let mut params = match table.remove(name) {
        Some(EffectParams::Named(params)) => params,
        Some(EffectParams::First(first)) => {
            names().next().map(|p| (p.to_owned(), first)).into_iter().collect()
        }
        None => Default::default(),
    };
    params.insert(param.to_owned(), number);
    table.insert(name.to_owned(), EffectParams::Named(params));
    Ok(())
}

/// A task of several drones: flown, printed and drawn together.
fn fly_multi_drone(
    args: &Args,
    setup: &Setup,
    controllers: Vec<ControllerSpec>,
    out: &mut dyn Write,
) -> Outcome {
    let multi_drone =
        MultiDroneSetup { drones: args.drones.unwrap_or(0), avoid: args.collision_avoidance, controllers };
    let (seeds, mut flights) = (seeds(args), Vec::new());
    for seeds in seeds.chunks(BATCH) {
        flights.extend(flight::fly_multi_drone(setup, &multi_drone, seeds)?);
    }
    let first = flights.first().ok_or_else(|| Failure::Usage("--runs must be at least 1".into()))?;
    if let Some(file) = &args.csv {
        fly_multi_drone::write_logs(file, first)?;
    }
    let (over_time, path) = (flight::multi_drone_picture, flight::multi_drone_path);
    draw(args, setup, &first.drones, |title| over_time(first, title), |title| path(first, title))?;
    // between several drones downwash is on unless it is told otherwise
    let effects = flight::options(setup, multi_drone.drones)?.effects;
    let runs: Vec<_> = flights.iter().map(fly_multi_drone::as_json).collect();
    tell(args, setup, &effects, &runs, out, |out| {
        fly_multi_drone::table(&flights, args.collision_avoidance, out)
    })
}

/// Every run's figures, and the first flight in full.
fn fly_all(args: &Args, setup: &Setup) -> Outcome<(Vec<Figures>, Trace)> {
    let seeds = seeds(args);
    let bar = if seeds.len() > BATCH { ProgressBar::new(seeds.len() as u64) } else { ProgressBar::hidden() };
    let (mut all, mut first_trace) = (Vec::new(), None);
    for seeds in seeds.chunks(BATCH) {
        let traces = flight::fly(setup, seeds)?;
        all.extend(traces.iter().map(|trace| flight::figures(setup.scenario.phases, trace)));
        first_trace = first_trace.or_else(|| traces.into_iter().next());
        bar.inc(seeds.len() as u64);
    }
    bar.finish_and_clear();
    let first = first_trace.ok_or_else(|| Failure::Usage("--runs must be at least 1".into()))?;
    Ok((all, first))
}
