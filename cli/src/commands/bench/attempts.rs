//! `crazyflie bench attempts`: what was flown, and its flights as files.

use std::io::Write;
use std::path::PathBuf;

use super::{Common, Outcome, Table, files, moment, number};
use crazyflie_bench::{AttemptEntry, AttemptPage, Bench, api};

const EXAMPLES: &str = "\
Examples:
  crazyflie bench attempts --scenario wind
  crazyflie bench attempts --json
  crazyflie bench attempts 0123456789abcdef0123456789abcdef --episode 3 --csv flight.csv";

/// List every attempt, show one whole, or write one of its flights as a log that `replay` reads.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
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
    /// Which of its flights
    #[arg(long, default_value_t = 0, value_name = "N")]
    episode: usize,
    /// Which of the drones that share the air
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
    let mut table = Table::new(&["attempt", "begun", "scenario", "team", "controller", "status", "score"])
        .left(&[1, 2, 3, 4, 5]);
    for AttemptEntry { id, document, .. } in bench.attempts(scenario.as_deref())? {
        let Ok(d) = document else {
            table.row(vec![id, "damaged: see crazyflie bench verify".into()]);
            continue;
        };
        let score = d.result.as_ref().map_or("-".into(), |result| number(result.score.score, 1));
        table.row(vec![
            d.id,
            moment(d.begun_ms),
            d.scenario,
            d.team,
            d.controller,
            d.status.name().into(),
            score,
        ]);
    }
    Ok(write!(out, "{table}")?)
}
