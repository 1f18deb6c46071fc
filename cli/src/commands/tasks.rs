//! `crazyflie tasks`: tasks for one drone and for several, and the thesis's flights.

use std::io::Write;

use crazyflie_env::task::registry;
use serde_json::json;

use super::{Outcome, Table};
use crazyflie_server::flight::{FlightScenario, SCENARIOS};

const EXAMPLES: &str = "\
Examples:
  crazyflie tasks
  crazyflie tasks --markdown";

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
                json!({"name": t.name, "id": t.id, "about": t.about, "reward": t.reward, "max_episode_steps": t.max_episode_steps, "drones": t.drones})
            })
            .collect();
        let flights: Vec<_> = thesis_flights()
            .map(|s| json!({"name": s.name, "task": s.task, "about": s.about, "source": s.source, "seconds": s.seconds}))
            .collect();
        serde_json::to_writer_pretty(&mut *out, &json!({"tasks": tasks, "thesis_flights": flights}))?;
        return Ok(writeln!(out)?);
    }
    if args.markdown {
        let mut table = Table::new(&["task", "Gymnasium id", "what", "reward and end", "steps", "drones"])
            .left(&[1, 2, 3]);
        for t in registry() {
            table.row(vec![
                format!("`{}`", t.name),
                format!("`{}`", t.id),
                t.about.into(),
                t.reward.into(),
                t.max_episode_steps.to_string(),
                t.drones.to_string(),
            ]);
        }
        let mut flights = Table::new(&["flight", "what", "thesis", "seconds"]).left(&[1, 2]);
        for s in thesis_flights() {
            flights.row(vec![
                format!("`{}`", s.name),
                s.about.into(),
                s.source.into(),
                s.seconds.to_string(),
            ]);
        }
        return Ok(write!(out, "{}\n{}", table.markdown(), flights.markdown())?);
    }
    writeln!(out, "Tasks:")?;
    for t in registry() {
        let drones = if t.drones == 1 { "1 drone".to_owned() } else { format!("{} drones", t.drones) };
        writeln!(
            out,
            "  {} ({})\n      {}\n      reward: {}\n      {drones}, {} steps",
            t.name, t.id, t.about, t.reward, t.max_episode_steps
        )?;
    }
    writeln!(out, "\nFlights of the thesis, for fly --task:")?;
    for s in thesis_flights() {
        writeln!(out, "  {} ({}, {} s)\n      {}", s.name, s.source, s.seconds, s.about)?;
    }
    Ok(())
}

/// The scenarios that are not simply a task.
fn thesis_flights() -> impl Iterator<Item = &'static FlightScenario> {
    SCENARIOS.iter().filter(|s| s.name != s.task)
}
