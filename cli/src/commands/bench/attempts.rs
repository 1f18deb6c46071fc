//! `crazyflie bench attempts`: what was flown, and its flights as files.

use std::io::Write;
use std::path::PathBuf;

use super::{Common, Outcome, Table, files, moment, number, or_dash};
use crazyflie_bench::{AttemptEntry, AttemptPage, Bench, Document, api};

/// List every attempt, show one whole, or write one of its flights as a log that `replay` reads.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Show this attempt whole, as JSON
    #[arg(value_name = "ID")]
    attempt: Option<String>,
    /// Only attempts at this scenario
    #[arg(long, value_name = "ID", conflicts_with = "attempt")]
    scenario: Option<String>,
    /// Write one flight of the attempt as a log
    #[arg(long, value_name = "FILE", requires = "attempt")]
    csv: Option<PathBuf>,
    /// Number of the flight
    #[arg(long, default_value_t = 0, value_name = "N")]
    episode: usize,
    /// Number of the drone, if several share the air
    #[arg(long, default_value_t = 0, value_name = "N")]
    drone: usize,
    #[command(flatten)]
    common: Common,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let bench = args.common.database.open_existing()?;
    let reply = match (&args.attempt, &args.csv) {
        (Some(id), Some(file)) => {
            return files::write(file, &api::log_csv(&bench, id, args.episode, args.drone)?.bytes);
        }
        (Some(id), None) => api::attempt(&bench, id)?,
        (None, _) if args.common.json => {
            api::attempts(&bench, args.scenario.as_deref(), AttemptPage::default())?
        }
        (None, _) => return list(&bench, args.scenario.as_deref(), out),
    };
    out.write_all(&reply.bytes)?;
    Ok(writeln!(out)?)
}

fn list(bench: &Bench, scenario: Option<&str>, out: &mut dyn Write) -> Outcome {
    let scenario = scenario.map(|name| bench.scenario(name)).transpose()?.map(|s| s.id());
    let entries = bench.attempts(scenario.as_deref())?;
    let cell = |entry: &AttemptEntry, text: fn(&Document) -> String| {
        entry.document.as_ref().map_or(String::new(), text)
    };
    let begun = |d: &Document| moment(d.begun_ms);
    let table = Table::from_rows(&entries)
        .words("attempt", |e| &e.id)
        .words("begun", |e| {
            e.document.as_ref().map_or_else(|_| "damaged: see crazyflie bench verify".into(), begun)
        })
        .words("scenario", |e| cell(e, |d| d.scenario.clone()))
        .words("team", |e| cell(e, |d| d.team.clone()))
        .words("controller", |e| cell(e, |d| d.controller.clone()))
        .words("status", |e| cell(e, |d| d.status.name().into()))
        .values("score", |e| cell(e, |d| or_dash(d.result.as_ref().map(|r| number(r.score.score, 1)))));
    Ok(write!(out, "{table}")?)
}
