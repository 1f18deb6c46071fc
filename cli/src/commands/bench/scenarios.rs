//! `crazyflie bench scenarios`.

use std::io::Write;

use super::{Common, Outcome, Table, number, write_json};

/// List the benchmark's scenarios.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Every level of each: 0 without the camera, 1 as declared, 2 drawn anew for every flight, 3 with an
    /// undeclared effect
    #[arg(long)]
    levels: bool,
    #[command(flatten)]
    common: Common,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let bench = args.common.database.open()?;
    let scenarios = if args.levels { bench.all_scenarios() } else { bench.scenarios() };
    if args.common.json {
        let all: Vec<_> = scenarios.iter().map(|s| s.public()).collect();
        return write_json(&all, out);
    }
    let table = Table::from_rows(scenarios)
        .words("scenario", |s| s.id())
        .words("what", |s| s.title())
        .values("episodes", |s| s.episodes())
        .values("seconds", |s| number(s.seconds(), 0))
        .words("hash", |s| &s.hash()[..12]);
    Ok(write!(out, "{table}")?)
}
