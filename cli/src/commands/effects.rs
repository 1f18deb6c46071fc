//! `crazyflie effects`: the registry of effects.

use std::io::Write;

use crazyflie_env::effects::{Entry, Hooks, Param, find, registry};
use serde_json::{Value, json};

use super::{Outcome, Table};

const EXAMPLES: &str = "\
Examples:
  crazyflie effects
  crazyflie effects camera_fov
  crazyflie effects --json | head -20
  crazyflie effects --markdown > docs/effects.md";

/// List the effects: what the identified linear model lacks. All are off unless asked for.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Only these
    names: Vec<String>,
    /// For machines
    #[arg(long, conflicts_with = "markdown")]
    json: bool,
    /// As a table for the documentation
    #[arg(long)]
    markdown: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let chosen: Vec<&Entry> = match &args.names[..] {
        [] => registry().iter().collect(),
        names => names.iter().map(|name| find(name).map(|(_, entry)| entry)).collect::<Result<_, _>>()?,
    };
    if args.json {
        let all: Vec<Value> = chosen.iter().map(|e| as_json(e)).collect();
        serde_json::to_writer_pretty(&mut *out, &all)?;
        return Ok(writeln!(out)?);
    }
    if args.markdown {
        return Ok(write!(out, "{}", table(&chosen).markdown())?);
    }
    for e in chosen {
        writeln!(
            out,
            "{} ({})\n    {}\n    source: {}",
            e.name,
            hooks(e.hooks).join(", "),
            e.about,
            e.source
        )?;
        for p in e.params {
            writeln!(
                out,
                "    .{} [{}], {} to {}, default {}: {}",
                p.name,
                p.unit,
                p.low,
                p.high,
                p.off,
                about(p)
            )?;
        }
    }
    Ok(())
}

/// The place where the effect enters the loop, in words.
fn hooks(h: Hooks) -> Vec<&'static str> {
    let all = [(h.command, "command"), (h.push, "motion"), (h.frame, "camera frame"), (h.sense, "reading")];
    all.into_iter().filter(|(on, _)| *on).map(|(_, name)| name).collect()
}

/// Meaning of a parameter, and the size from which `explain` calls it a cause.
fn about(p: &Param) -> String {
    let least =
        if p.least > 0.0 { format!(" (a cause from {} off the default)", p.least) } else { String::new() };
    format!("{}{least}", p.about)
}

fn as_json(e: &Entry) -> Value {
    let params: Vec<Value> = e
        .params
        .iter()
        .map(|p| json!({"name": p.name, "unit": p.unit, "default": p.off, "low": p.low, "high": p.high, "least_cause": p.least, "about": p.about}))
        .collect();
    json!({"name": e.name, "about": e.about, "source": e.source, "acts_on": hooks(e.hooks), "params": params})
}

fn table(chosen: &[&Entry]) -> Table {
    let mut table = Table::new(&["effect", "parameter", "unit", "default", "range", "what", "source"])
        .left(&[1, 2, 5, 6]);
    for e in chosen {
        for (i, p) in e.params.iter().enumerate() {
            let first = |text: String| if i == 0 { text } else { String::new() };
            let what = if i == 0 { format!("{}. {}", e.about, about(p)) } else { about(p) };
            let range = format!("{} to {}", p.low, p.high);
            let name = first(format!("`{}`", e.name));
            table.row(vec![
                name,
                format!("`{}`", p.name),
                p.unit.into(),
                p.off.to_string(),
                range,
                what,
                first(e.source.into()),
            ]);
        }
    }
    table
}
