//! `crazyflie export`: an environment as a module for other number crunchers.

use std::io::Write;
use std::path::PathBuf;

use crazyflie_env::action::ActionLevel;
use crazyflie_env::config::{EffectTable, Options};
use crazyflie_env::model::VerticalInput;
use crazyflie_env::observation::ObservationChoice;
use crazyflie_env::recording::record_environment;
use crazyflie_env::task;
use crazyflie_jax::write_module;
use serde_json::json;

use super::files::ModelArg;
use super::fly::{add_effects, own_task, task_options};
use super::{Failure, Outcome, files};

/// Write an environment as a module of pure JAX functions: the simulator's own formulas with the effects, sensors
/// and task that are chosen. It needs JAX and NumPy alone.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// File of the module
    #[arg(long, value_name = "FILE.py")]
    jax: PathBuf,
    /// A task (see `crazyflie tasks`), or a task file that ends in .toml or .json
    #[arg(long, default_value = "hover", value_name = "NAME|FILE")]
    task: String,
    /// The task's options, as JSON; they override those of a task file
    #[arg(long, value_name = "JSON")]
    task_options: Option<String>,
    /// An effect as NAME=VALUE or NAME.PARAMETER=VALUE, or several as JSON; may be repeated (see `crazyflie
    /// effects`). Its parameters can be changed in the module
    #[arg(long, value_name = "EFFECT")]
    effects: Vec<String>,
    /// Fields of an observation: measured, estimate, state, or names of fields with commas between
    #[arg(long, value_name = "NAME")]
    observation: Option<String>,
    /// Level of the actions (see `crazyflie actions`) [default: attitude, or as the task file says]
    #[arg(long, value_name = "LEVEL")]
    action: Option<String>,
    #[command(flatten)]
    model: ModelArg,
    /// Vertical form of the model that is commanded: height, pwm, thrust or motors [default: pwm, if the
    /// model has it]
    #[arg(long, value_parser = files::vertical, value_name = "FORM")]
    vertical: Option<VerticalInput>,
    /// Number of drones for a task of several [default: as the task says]
    #[arg(long, value_name = "N")]
    drones: Option<usize>,
    /// Length of an episode in steps, 0 for no end [default: as the task says]
    #[arg(long, value_name = "N")]
    max_episode_steps: Option<u32>,
    /// Starts of episodes that the module picks from
    #[arg(long, default_value_t = 256, value_name = "N")]
    starts: usize,
    /// Seed of the first of these starts
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let (file, is_python) = (args.jax.display(), args.jax.extension().is_some_and(|ending| ending == "py"));
    Failure::unless(is_python, || format!("{file}: name a file that ends in .py"))?;
    let model = args.model.read()?;
    let mut options = options(args)?;
    if !options.action.is_below_attitude() {
        options.vertical = options.vertical.or_else(|| Some(files::default_vertical(&model)));
    }
    let recording = record_environment(&[model], &options, (args.seed, args.starts))?;
    let text = write_module(&recording)?;
    files::write(&args.jax, text.as_bytes())?;
    let numbers: usize = recording.state.iter().map(|field| field.length).sum();
    let operations = recording.tick.live_nodes().iter().filter(|live| **live).count();
    if args.json {
        let summary = json!({
            "module": &args.jax, "drones": recording.drones, "state": numbers, "operations": operations,
            "observation": recording.observation.iter().map(|field| field.length).sum::<usize>(),
        });
        return Ok(writeln!(out, "{summary}")?);
    }
    Ok(writeln!(out, "wrote {file}: a tick has {operations} operations, a state {numbers} numbers")?)
}

/// The options of a task file, or defaults, with those of the command line on top.
fn options(args: &Args) -> Outcome<Options> {
    let own = own_task(&args.task)?;
    let mut options = match own {
        Some(own) => own.options,
        None => Options::parse(&json!({ "task": args.task }).to_string())?,
    };
    let mut effects = EffectTable::new();
    args.effects.iter().try_for_each(|text| add_effects(&mut effects, text))?;
    options.effects.extend(effects);
    let (of_file, given) = (&options.task_options, args.task_options.as_deref());
    options.task_options = task_options(&options.task, Some(of_file), given, None)?.unwrap_or_default();
    if let Some(names) = &args.observation {
        let names: Vec<&str> = names.split(',').collect();
        let named =
            names.len() == 1 && crazyflie_env::observation::CHOICES.iter().any(|c| c.name == names[0]);
        options.observation = if named {
            ObservationChoice::Named(names[0].to_owned())
        } else {
            ObservationChoice::Fields(names.into_iter().map(str::to_owned).collect())
        };
    }
    if let Some(name) = &args.action {
        options.action = ActionLevel::named(name)?;
    }
    options.vertical = args.vertical.or(options.vertical);
    options.drones = args.drones.unwrap_or(options.drones);
    let length = task::find(&options.task)?.max_episode_steps;
    let of_file = Some(options.max_episode_steps).filter(|steps| *steps > 0);
    options.max_episode_steps = args.max_episode_steps.or(of_file).unwrap_or(length);
    // once more, for what was put together
    Ok(Options::parse(&serde_json::to_string(&options)?)?)
}
