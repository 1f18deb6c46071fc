//! `crazyflie world replay`: the log of a shared world, flown again and compared.

use std::io::Write;
use std::path::PathBuf;

use super::{Failure, Outcome, write_json};
use crazyflie_server::worlds::{WorldReplay, replay_log};

/// Fly a shared world again from its log, and compare bit by bit.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The log, downloaded from a server
    #[arg(value_name = "LOG")]
    log: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let about = |problem: &dyn std::fmt::Display| Failure::about(args.log.display(), problem);
    let text = std::fs::read_to_string(&args.log).map_err(|e| about(&e))?;
    let replay = replay_log(&text).map_err(|e| about(&e))?;
    if args.json {
        write_json(&replay, out)?;
    } else {
        write_text(&replay, out)?;
    }
    match replay.logged == replay.replayed {
        true => Ok(()),
        false => Err(about(&"the flight is not the one that the log tells of")),
    }
}

fn write_text(replay: &WorldReplay, out: &mut dyn Write) -> Outcome {
    let WorldReplay { world, mission, drones, logged, replayed } = replay;
    writeln!(out, "world {world}: {mission}, {drones} drones, {} ticks", replayed.ticks)?;
    replayed.metrics.iter().try_for_each(|(name, value)| writeln!(out, "  {name} {value}"))?;
    writeln!(out, "  late {}", replayed.late.iter().sum::<u64>())?;
    Ok(writeln!(out, "told  {}\nflown {}", logged.sha256, replayed.sha256)?)
}
