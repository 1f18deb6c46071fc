//! `crazyflie controllers`, and the choice of a controller in the other commands.

use std::io::Write;

use crazyflie_control::{ControllerSpec, choose, registry};
use serde_json::{Value, json};

use super::{Failure, Outcome, write_json};

/// List the controllers that `fly` and `bench` know, with their options.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    if args.json {
        let all: Vec<_> = registry()
            .iter()
            .map(|e| {
                let options: Vec<_> = e.options.iter().map(|(name, about)| json!({"name": name, "about": about})).collect();
                json!({"name": e.name, "also": e.also, "about": e.about, "source": e.source, "file": e.file, "member": e.member, "options": options,
                    "defaults": (e.defaults)()})
            })
            .collect();
        return write_json(&all, out);
    }
    for e in registry() {
        let file = match (e.file, e.member) {
            (None, _) => "",
            (Some(_), None) => ":FILE",
            (Some(_), Some(_)) => ":FILE:NAME",
        };
        writeln!(out, "{}{file}\n    {}\n    source: {}", e.name, e.about, e.source)?;
        e.file.map_or(Ok(()), |what| writeln!(out, "    FILE: {what}"))?;
        e.member.map_or(Ok(()), |what| writeln!(out, "    NAME: {what}"))?;
        let defaults = (e.defaults)();
        for (option, about) in e.options {
            writeln!(out, "    {option} = {}: {about}", defaults[option])?;
        }
    }
    Ok(())
}

/// Returns the controller of `--controller` and `--controller-options`.
pub(super) fn chosen(controller: &str, options: Option<&str>) -> Outcome<ControllerSpec> {
    let options = match options {
        None => Value::Null,
        Some(text) => serde_json::from_str(text)
            .map_err(|e| Failure::Usage(format!("--controller-options is not JSON: {e}")))?,
    };
    Ok(choose(controller, options, &|path| std::fs::read(path))?)
}

/// Returns the controllers of `--controller NAME,NAME,...`, one for each drone, or one for all. The options are a
/// JSON object for all of them, or a list with one for each.
pub(super) fn chosen_each(controllers: &str, options: Option<&str>) -> Outcome<Vec<ControllerSpec>> {
    let names: Vec<&str> = controllers.split(',').collect();
    let list = options.and_then(|text| serde_json::from_str::<Vec<Value>>(text).ok());
    let Some(list) = list else { return names.iter().map(|name| chosen(name, options)).collect() };
    let (want, got) = (names.len(), list.len());
    Failure::unless(want == got, || {
        format!(
            "--controller-options: expected an object, or a list of {want}, one for each controller; got a list of {got}"
        )
    })?;
    names.iter().zip(list).map(|(name, options)| chosen(name, Some(&options.to_string()))).collect()
}
