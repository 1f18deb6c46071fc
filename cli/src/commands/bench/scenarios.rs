//! `crazyflie bench scenarios`.

use std::io::Write;

use super::{Common, Outcome, Table, number, write_json};

const EXAMPLES: &str = "\
Examples:
  crazyflie bench scenarios
  crazyflie bench scenarios --levels
  crazyflie bench scenarios --json

The database's secret decides what the mystery scenario hides, and so that scenario's hash.";

/// List the benchmark's scenarios.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Every level of each: 0 without the camera, 1 as declared, 2 drawn anew for every flight, 3 with an effect that
    /// nobody is told of
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
    let mut table = Table::new(&["scenario", "what", "episodes", "seconds", "hash"]).left(&[1, 4]);
    for s in scenarios {
        table.row(vec![
            s.id(),
            s.title().into(),
            s.episodes().to_string(),
            number(s.seconds(), 0),
            s.hash()[..12].into(),
        ]);
    }
    Ok(write!(out, "{}", table.plain())?)
}
