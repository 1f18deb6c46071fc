//! `crazyflie bench leaderboard`.

use std::io::Write;

use serde_json::json;

use super::{Common, Outcome, Table, cm, interval, number, write_json};
use crazyflie_bench::LeaderboardRow;

const EXAMPLES: &str = "\
Examples:
  crazyflie bench leaderboard
  crazyflie bench leaderboard --scenario hover-aruco
  crazyflie bench leaderboard --json

A team is ranked by the name that it used last, from five attempts on, by the median of all of them. Former names have
no rank; --json lists them.";

/// Show who flies the benchmark's scenarios best.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// A scenario (see `crazyflie bench scenarios`), or all
    #[arg(long, default_value = "all", value_name = "ID")]
    scenario: String,
    #[command(flatten)]
    common: Common,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let bench = args.common.database.open_existing()?;
    let scenarios = match args.scenario.as_str() {
        "all" => bench.scenarios().iter().collect(),
        name => vec![bench.scenario(name)?],
    };
    let mut boards = serde_json::Map::new();
    for scenario in scenarios {
        let rows = bench.leaderboard(scenario)?;
        if args.common.json {
            boards.insert(scenario.id(), json!(rows));
        } else {
            let body = if rows.is_empty() { "no attempts yet\n".into() } else { table(&rows).plain() };
            writeln!(out, "{}: {}\n{body}", scenario.id(), scenario.title())?;
        }
    }
    if args.common.json {
        write_json(&boards, out)?;
    }
    Ok(())
}

/// A row for each entry.
pub(super) fn table(rows: &[LeaderboardRow]) -> Table {
    let mut table = Table::new(&[
        "rank",
        "controller",
        "team",
        "score",
        "95 %",
        "failed",
        "attempts",
        "former names",
        "RMS error",
        "nearest",
        "attempt",
    ])
    .left(&[1, 2, 10]);
    for row in rows {
        let metrics = row.metrics.as_ref();
        table.row(vec![
            row.rank.map_or("-".into(), |rank| rank.to_string()),
            row.controller.clone(),
            row.team.clone(),
            number(row.score.score, 1),
            interval(row.score.low, row.score.high),
            format!("{} of {}", row.score.failed, row.score.episodes),
            row.attempts.to_string(),
            row.former.len().to_string(),
            cm(metrics.and_then(|m| m.rmse_m)),
            cm(metrics.and_then(|m| m.min_separation_m)),
            row.attempt.clone(),
        ]);
    }
    table
}
