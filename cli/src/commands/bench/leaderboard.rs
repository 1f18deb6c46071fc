//! `crazyflie bench leaderboard`.

use std::io::Write;

use serde_json::json;

use super::{Common, Outcome, Table, cm, interval, number, or_dash, write_json};
use crazyflie_bench::LeaderboardRow;

/// Show the leaderboard of each scenario.
#[derive(Debug, clap::Args)]
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
            let body = if rows.is_empty() { "no attempts yet\n".into() } else { table(&rows).to_string() };
            writeln!(out, "{}: {}\n{body}", scenario.id(), scenario.title())?;
        }
    }
    if args.common.json {
        write_json(&boards, out)?;
    }
    Ok(())
}

/// A row for each entry.
pub(super) fn table(rows: &[LeaderboardRow]) -> Table<&LeaderboardRow> {
    Table::from_rows(rows)
        .words("rank", |row| or_dash(row.rank))
        .words("controller", |row| &row.controller)
        .words("team", |row| &row.team)
        .values("score", |row| number(row.score.score, 1))
        .values("95 %", |row| interval(row.score.low, row.score.high))
        .values("failed", |row| format!("{} of {}", row.score.failed, row.score.episodes))
        .values("attempts", |row| row.attempts)
        .values("former names", |row| row.former.len())
        .values("RMS error", |row| cm(row.metrics.as_ref().and_then(|m| m.rmse_m)))
        .values("nearest", |row| cm(row.metrics.as_ref().and_then(|m| m.min_separation_m)))
        .words("attempt", |row| &row.attempt)
}
