//! `crazyflie tasks`: tasks for one drone and for several, and the thesis's flights.

use std::io::Write;

use crazyflie_env::observation::{ALL_FIELDS, CHOICES, Field};
use crazyflie_env::task::{TaskOption, registry};
use minijinja::render;
use serde_json::{Value, json};

use super::{Outcome, Table, write_json};
use crazyflie_server::flight::{FlightScenario, SCENARIOS};

/// List the tasks, for one drone and for several, and the flights of the thesis that `fly` knows by name.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Print JSON
    #[arg(long, conflicts_with = "markdown")]
    json: bool,
    /// Print a Markdown table
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
        return write_json(&all, out);
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

/// The page of the documentation, by its tables.
const PAGE: &str = include_str!("../../templates/tasks.md");

fn markdown() -> String {
    let tasks = Table::from_rows(registry())
        .words("task", |t| format!("`{}`", t.name))
        .words("Gymnasium id", |t| format!("`{}`", t.id))
        .words("what", |t| t.about)
        .words("reward and end", |t| t.reward)
        .values("steps", |t| t.max_episode_steps)
        .values("drones", |t| t.drones);
    let options: Vec<_> =
        registry().iter().flat_map(|t| t.options().into_iter().map(move |o| (t, o))).collect();
    let options = Table::from_rows(&options)
        .words("task", |(t, _)| format!("`{}`", t.name))
        .words("option", |(_, o)| format!("`{}`", o.name))
        .words("unit", |(_, o)| o.unit)
        .values("default", |(_, o)| o.default_value())
        .values("range", |(_, o)| o.range())
        .values("d", |(_, o)| if o.drawn { "d" } else { "" })
        .words("what", |(_, o)| o.about);
    let flights = Table::from_rows(thesis_flights())
        .words("flight", |s| format!("`{}`", s.name))
        .words("what", |s| s.about)
        .words("thesis", |s| s.source)
        .values("seconds", |s| s.seconds);
    let choices = |f: &Field| {
        let holds = CHOICES.iter().filter(|c| c.fields.iter().any(|known| known.name == f.name));
        holds.map(|c| c.name).collect::<Vec<_>>().join(", ")
    };
    let fields = Table::from_rows(ALL_FIELDS)
        .words("field", |f| format!("`{}`", f.name))
        .values("numbers", |f| f.length)
        .words("unit", |f| f.unit)
        .values("range", |f| format!("{} to {}", f.low, f.high))
        .words("choices", |f| choices(&f))
        .words("what", |f| f.about);
    let (tasks, options, flights, fields) =
        (tasks.markdown(), options.markdown(), flights.markdown(), fields.markdown());
    render!(PAGE, tasks, options, flights, fields)
}

/// The scenarios that are not simply a task.
fn thesis_flights() -> impl Iterator<Item = &'static FlightScenario> {
    SCENARIOS.iter().filter(|s| s.name != s.task)
}
