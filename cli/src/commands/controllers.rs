//! `crazyflie controllers`, and how the other commands are told which one to fly.

use std::io::Write;

use crazyflie_control::{ControllerSpec, choose, registry};
use serde_json::{Value, json};

use super::{Failure, Outcome};

const EXAMPLES: &str = "\
Examples:
  crazyflie controllers
  crazyflie fly --controller stock-pid
  crazyflie fly --controller thesis-pid --controller-options '{\"yaw\": {\"kp\": 10, \"ki\": 0, \"kd\": 0, \"integral\": [0, 0], \"output\": [-90, 90]}}'
  crazyflie bench submit --controller pid:gains.json";

/// List the controllers that `fly` and `submit` know, with their options.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// For machines
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    if args.json {
        let all: Vec<_> = registry()
            .iter()
            .map(|e| {
                let options: Vec<_> = e.options.iter().map(|(name, about)| json!({"name": name, "about": about})).collect();
                json!({"name": e.name, "also": e.also, "about": e.about, "source": e.source, "file": e.file, "options": options,
                    "defaults": (e.defaults)()})
            })
            .collect();
        serde_json::to_writer_pretty(&mut *out, &all)?;
        return Ok(writeln!(out)?);
    }
    for e in registry() {
        let file = if e.file.is_some() { ":FILE" } else { "" };
        writeln!(out, "{}{file}\n    {}\n    source: {}", e.name, e.about, e.source)?;
        if let Some(what) = e.file {
            writeln!(out, "    FILE: {what}")?;
        }
        let defaults = (e.defaults)();
        for (option, about) in e.options {
            writeln!(out, "    {option} = {}: {about}", defaults[option])?;
        }
    }
    Ok(())
}

/// The controller that `--controller` and `--controller-options` ask for.
pub(super) fn chosen(controller: &str, options: Option<&str>) -> Outcome<ControllerSpec> {
    let options = match options {
        None => Value::Null,
        Some(text) => serde_json::from_str(text)
            .map_err(|e| Failure::Usage(format!("--controller-options is not JSON: {e}")))?,
    };
    Ok(choose(controller, options, &|path| std::fs::read(path))?)
}
