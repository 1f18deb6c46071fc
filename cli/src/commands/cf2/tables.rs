//! Parameters and log variables of the simulated Crazyflie, as tables.

use std::io::Write;

use crazyflie_crtp::{LOGS, LogVariable, PARAMS, Param};
use serde_json::{Value, json};

use crate::failure::Outcome;
use crate::text::Table;

pub(super) fn write(json: bool, markdown: bool, out: &mut dyn Write) -> Outcome {
    if json {
        let params: Vec<Value> = PARAMS.iter().map(param_json).collect();
        let logs: Vec<Value> = LOGS.iter().map(log_json).collect();
        serde_json::to_writer_pretty(&mut *out, &json!({"parameters": params, "logs": logs}))?;
        return Ok(writeln!(out)?);
    }
    if markdown {
        return Ok(write!(out, "{}", page())?);
    }
    writeln!(out, "parameters")?;
    for Param { name, kind, read_only, default, unit, about, .. } in PARAMS {
        let access = if *read_only { ", read only" } else { "" };
        writeln!(out, "    {name} [{unit}], {}{access}, default {default}: {about}", kind.name())?;
    }
    writeln!(out, "log variables")?;
    for LogVariable { name, kind, unit, about, .. } in LOGS {
        writeln!(out, "    {name} [{unit}], {}: {about}", kind.name())?;
    }
    Ok(())
}

fn param_json(param: &Param) -> Value {
    let Param { name, kind, read_only, default, unit, about, .. } = param;
    json!({"name": name, "kind": kind.name(), "read_only": read_only, "default": default, "unit": unit, "about": about})
}

fn log_json(log: &LogVariable) -> Value {
    let LogVariable { name, kind, unit, about, .. } = log;
    json!({"name": name, "kind": kind.name(), "unit": unit, "about": about})
}

const HEAD: &str = include_str!("../../../templates/cflib.md");

/// The page of the documentation: what a person wrote, then the tables.
fn page() -> String {
    let params = Table::from_rows(PARAMS)
        .words("parameter", |p| format!("`{}`", p.name))
        .words("kind", |p| format!("{}{}", p.kind.name(), if p.read_only { ", read only" } else { "" }))
        .values("default", |p| p.default)
        .words("unit", |p| p.unit)
        .words("about", |p| p.about);
    let logs = Table::from_rows(LOGS)
        .words("log variable", |log| format!("`{}`", log.name))
        .words("kind", |log| log.kind.name())
        .words("unit", |log| log.unit)
        .words("about", |log| log.about);
    format!("{HEAD}\n## Parameters\n\n{}\n## Log variables\n\n{}", params.markdown(), logs.markdown())
}
