//! `crazyflie effects`: the registry of effects.

use std::io::Write;

use crazyflie_env::effects::{Entry, Hooks, Param, find, registry};
use serde_json::{Value, json};

use super::{Outcome, Table, write_json};

/// List the effects that the identified linear model lacks; all are off by default.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Only these
    names: Vec<String>,
    /// Print JSON
    #[arg(long, conflicts_with = "markdown")]
    json: bool,
    /// Print a Markdown table
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
        return write_json(&all, out);
    }
    if args.markdown {
        return Ok(write!(out, "{}", table(&chosen).markdown())?);
    }
    for e in chosen {
        let Entry { name, about, source, params, .. } = e;
        writeln!(out, "{name} ({})\n    {about}\n    source: {source}", hooks(e.hooks).join(", "))?;
        for p in *params {
            let Param { name, unit, low, high, off, .. } = p;
            writeln!(out, "    .{name} [{unit}], {low} to {high}, default {off}: {}", meaning(p))?;
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
fn meaning(p: &Param) -> String {
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

fn table<'a>(chosen: &[&'a Entry]) -> Table<(&'a Entry, usize, &'a Param)> {
    let rows = chosen.iter().flat_map(|e| e.params.iter().enumerate().map(|(i, p)| (*e, i, p)));
    Table::from_rows(rows)
        .words("effect", |(e, i, _)| if i == 0 { format!("`{}`", e.name) } else { String::new() })
        .words("parameter", |(.., p)| format!("`{}`", p.name))
        .words("unit", |(.., p)| p.unit)
        .values("default", |(.., p)| p.off)
        .values("range", |(.., p)| format!("{} to {}", p.low, p.high))
        .words("what", |(e, i, p)| if i == 0 { format!("{}. {}", e.about, meaning(p)) } else { meaning(p) })
        .words("source", |(e, i, _)| if i == 0 { e.source } else { "" })
}
