//! `crazyflie tasks`: tasks for one drone and for several, and the thesis's flights.

use std::io::Write;

use crazyflie_env::observation::{ALL_FIELDS, CHOICES};
use crazyflie_env::task::{TaskOption, registry};
use serde_json::{Value, json};

use super::{Outcome, Table};
use crazyflie_server::flight::{FlightScenario, SCENARIOS};

const EXAMPLES: &str = "\
Examples:
  crazyflie tasks
  crazyflie tasks --json | head -20
  crazyflie tasks --markdown > docs/tasks.md";

/// List the tasks, for one drone and for several, and the flights of the thesis that `fly` knows by name.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// For machines
    #[arg(long, conflicts_with = "markdown")]
    json: bool,
    /// As a table for the documentation
    #[arg(long)]
    markdown: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    if args.json {
        let tasks: Vec<_> = registry()
            .iter()
            .map(|t| {
                json!({"name": t.name, "id": t.id, "about": t.about, "reward": t.reward, "max_episode_steps": t.max_episode_steps, "drones": t.drones, "options": t.options().iter().map(option_json).collect::<Vec<_>>()})
            })
            .collect();
        let flights: Vec<_> = thesis_flights()
            .map(|s| json!({"name": s.name, "task": s.task, "about": s.about, "source": s.source, "seconds": s.seconds}))
            .collect();
        let fields: Vec<_> = ALL_FIELDS
            .iter()
            .map(|f| json!({"name": f.name, "length": f.length, "unit": f.unit, "low": f.low, "high": f.high, "about": f.about}))
            .collect();
        let all = json!({"tasks": tasks, "thesis_flights": flights, "observation_fields": fields});
        serde_json::to_writer_pretty(&mut *out, &all)?;
        return Ok(writeln!(out)?);
    }
    if args.markdown {
        return Ok(write!(out, "{}", markdown())?);
    }
    writeln!(out, "Tasks:")?;
    for t in registry() {
        let drones = if t.drones == 1 { "1 drone".to_owned() } else { format!("{} drones", t.drones) };
        writeln!(
            out,
            "  {} ({})\n      {}\n      reward: {}\n      {drones}, {} steps",
            t.name, t.id, t.about, t.reward, t.max_episode_steps
        )?;
        for o in t.options() {
            let unit = if o.unit.is_empty() { String::new() } else { format!(" [{}]", o.unit) };
            let default = o.default_value();
            writeln!(out, "      .{}{unit}, {}, default {default}: {}", o.name, o.range(), o.about)?;
        }
    }
    writeln!(out, "\nFields of observations:")?;
    for f in ALL_FIELDS {
        let range = format!("{} to {}", f.low, f.high);
        writeln!(out, "  {} ({}) [{}], {range}: {}", f.name, f.length, f.unit, f.about)?;
    }
    writeln!(out, "\nFlights of the thesis, for fly --task:")?;
    for s in thesis_flights() {
        writeln!(out, "  {} ({}, {} s)\n      {}", s.name, s.source, s.seconds, s.about)?;
    }
    Ok(())
}

fn option_json(option: &TaskOption) -> Value {
    json!({
        "name": option.name, "unit": option.unit, "default": option.default_value(), "low": option.low(), "high": option.high(),
        "range": option.range(), "drawn": option.drawn, "about": option.about,
    })
}

const HEAD: &str = "\
# Tasks

Written by `crazyflie tasks --markdown`. `crazyflie tasks --json` and `crazyflie_gym.tasks()` say the same to programs.

";

const OPTIONS: &str = "
## Options

They are given as `task_options={...}`. An option marked with *d* may be a distribution, from which every
episode draws: `{\"uniform\": [low, high]}`, `{\"log_uniform\": [low, high]}`, `{\"normal\": [mean, deviation]}` or
`{\"choice\": [...]}`. For a point, bounds are points, or each coordinate is a number or a distribution. What is
drawn depends on seed and episode alone. A normal distribution is cut off at four deviations and at the range.

";

const FIELDS: &str = "
## Fields of observations

`observation` is the name of a choice, or a list of fields.

";

/// The page of the documentation.
fn markdown() -> String {
    let mut tasks =
        Table::new(&["task", "Gymnasium id", "what", "reward and end", "steps", "drones"]).left(&[1, 2, 3]);
    let header = ["task", "option", "unit", "default", "range", "d", "what"];
    let mut options = Table::new(&header).left(&[1, 2, 6]);
    for t in registry() {
        tasks.row(vec![
            format!("`{}`", t.name),
            format!("`{}`", t.id),
            t.about.into(),
            t.reward.into(),
            t.max_episode_steps.to_string(),
            t.drones.to_string(),
        ]);
        for o in t.options() {
            options.row(vec![
                format!("`{}`", t.name),
                format!("`{}`", o.name),
                o.unit.into(),
                o.default_value().to_string(),
                o.range(),
                if o.drawn { "d".into() } else { String::new() },
                o.about.into(),
            ]);
        }
    }
    let mut flights = Table::new(&["flight", "what", "thesis", "seconds"]).left(&[1, 2]);
    for s in thesis_flights() {
        flights.row(vec![format!("`{}`", s.name), s.about.into(), s.source.into(), s.seconds.to_string()]);
    }
    let mut fields = Table::new(&["field", "numbers", "unit", "range", "choices", "what"]).left(&[2, 4, 5]);
    for f in ALL_FIELDS {
        let in_choice = CHOICES.iter().filter(|c| c.fields.iter().any(|known| known.name == f.name));
        fields.row(vec![
            format!("`{}`", f.name),
            f.length.to_string(),
            f.unit.into(),
            format!("{} to {}", f.low, f.high),
            in_choice.map(|c| c.name).collect::<Vec<_>>().join(", "),
            f.about.into(),
        ]);
    }
    let (tasks, options, flights, fields) =
        (tasks.markdown(), options.markdown(), flights.markdown(), fields.markdown());
    format!("{HEAD}{tasks}{OPTIONS}{options}\n## Flights of the thesis\n\n{flights}{FIELDS}{fields}")
}

/// The scenarios that are not simply a task.
fn thesis_flights() -> impl Iterator<Item = &'static FlightScenario> {
    SCENARIOS.iter().filter(|s| s.name != s.task)
}
