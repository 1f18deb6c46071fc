//! `crazyflie tasks`: tasks, missions of several drones, and the thesis's flights.

use std::io::Write;

use crazyflie_env::swarm::mission;
use crazyflie_env::task::registry;
use serde_json::json;

use super::{Outcome, Table};
use crate::flight::{SCENARIOS, Scenario};

const EXAMPLES: &str = "\
Examples:
  crazyflie tasks
  crazyflie tasks --markdown";

/// List the tasks, the missions of several drones, and the flights of the thesis that `fly` knows by name.
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
            .map(|t| json!({"name": t.name, "id": t.id, "about": t.about, "reward": t.reward, "max_episode_steps": t.max_episode_steps}))
            .collect();
        let flights: Vec<_> = thesis_flights()
            .map(|s| json!({"name": s.name, "task": s.task, "about": s.about, "source": s.source, "seconds": s.seconds}))
            .collect();
        let missions: Vec<_> = mission::registry()
            .iter()
            .map(|m| {
                json!({"name": m.name, "id": m.id, "about": m.about, "reward": m.reward, "max_episode_steps": m.max_episode_steps, "drones": m.drones})
            })
            .collect();
        serde_json::to_writer_pretty(&mut *out, &json!({"tasks": tasks, "missions": missions, "thesis_flights": flights}))?;
        return Ok(writeln!(out)?);
    }
    if args.markdown {
        let mut table = Table::new(&["task", "Gymnasium id", "what", "reward and end", "steps"]).left(&[1, 2, 3]);
        for t in registry() {
            table.row(vec![
                format!("`{}`", t.name),
                format!("`{}`", t.id),
                t.about.into(),
                t.reward.into(),
                t.max_episode_steps.to_string(),
            ]);
        }
        let mut missions = Table::new(&["mission", "Gymnasium id", "what", "reward and end", "steps", "drones"]).left(&[1, 2, 3]);
        for m in mission::registry() {
            missions.row(vec![
                format!("`{}`", m.name),
                format!("`{}`", m.id),
                m.about.into(),
                m.reward.into(),
                m.max_episode_steps.to_string(),
                m.drones.to_string(),
            ]);
        }
        let mut flights = Table::new(&["flight", "what", "thesis", "seconds"]).left(&[1, 2]);
        for s in thesis_flights() {
            flights.row(vec![format!("`{}`", s.name), s.about.into(), s.source.into(), s.seconds.to_string()]);
        }
        return Ok(write!(out, "{}\n{}\n{}", table.markdown(), missions.markdown(), flights.markdown())?);
    }
    writeln!(out, "Tasks:")?;
    for t in registry() {
        writeln!(out, "  {} ({})\n      {}\n      reward: {}\n      {} steps", t.name, t.id, t.about, t.reward, t.max_episode_steps)?;
    }
    writeln!(out, "\nMissions of several drones:")?;
    for m in mission::registry() {
        let (drones, steps) = (m.drones, m.max_episode_steps);
        writeln!(out, "  {} ({})\n      {}\n      reward: {}\n      {drones} drones, {steps} steps", m.name, m.id, m.about, m.reward)?;
    }
    writeln!(out, "\nFlights of the thesis, for fly --task:")?;
    for s in thesis_flights() {
        writeln!(out, "  {} ({}, {} s)\n      {}", s.name, s.source, s.seconds, s.about)?;
    }
    Ok(())
}

/// The scenarios that are not simply a task.
fn thesis_flights() -> impl Iterator<Item = &'static Scenario> {
    SCENARIOS.iter().filter(|s| s.name != s.task)
}
