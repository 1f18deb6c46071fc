//! `crazyflie world replay`: the log of a shared world, flown again and compared.

use std::io::Write;
use std::path::PathBuf;

use super::{Failure, Outcome};
use crazyflie_server::worlds::{Flown, fly_again};

const EXAMPLES: &str = "\
Examples:
  curl -O http://127.0.0.1:8765/api/v1/worlds/room/log
  crazyflie world replay log
  crazyflie world replay log --json";

/// Fly a shared world again from its log, and compare bit by bit.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// The log, as a server hands it out
    #[arg(value_name = "LOG")]
    log: PathBuf,
    /// For machines
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let about = |problem: &dyn std::fmt::Display| Failure::about(args.log.display(), problem);
    let text = std::fs::read_to_string(&args.log).map_err(|e| about(&e))?;
    let flown = fly_again(&text).map_err(|e| about(&e))?;
    if args.json {
        serde_json::to_writer_pretty(&mut *out, &flown)?;
        writeln!(out)?;
    } else {
        say(&flown, out)?;
    }
    match flown.told == flown.flown {
        true => Ok(()),
        false => Err(about(&"the flight is not the one that the log tells of")),
    }
}

fn say(Flown { world, mission, drones, told, flown }: &Flown, out: &mut dyn Write) -> Outcome {
    writeln!(out, "world {world}: {mission}, {drones} drones, {} ticks", flown.ticks)?;
    for (name, value) in &flown.metrics {
        writeln!(out, "  {name} {value}")?;
    }
    let late: u64 = flown.late.iter().sum();
    writeln!(out, "  late {late}")?;
    writeln!(out, "told  {}\nflown {}", told.sha256, flown.sha256)?;
    Ok(())
}
