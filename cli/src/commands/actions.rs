//! `crazyflie actions`: what the four numbers of an action set.

use std::io::Write;

use crazyflie_env::action::{Channel, Entry, Interface, registry};
use crazyflie_env::model::{Model, VerticalInput};
use minijinja::render;
use serde_json::{Value, json};

use super::files::ModelArg;
use super::{Outcome, Table, files, write_json};

/// List the action levels, which `fly --action` and the Python package's `action=` take.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    model: ModelArg,
    /// Vertical form of the model: height, pwm, thrust or motors [default: the model's first]
    #[arg(long, value_parser = files::vertical, value_name = "FORM")]
    vertical: Option<VerticalInput>,
    /// Print JSON
    #[arg(long, conflicts_with = "markdown")]
    json: bool,
    /// Print it as a page of the documentation
    #[arg(long)]
    markdown: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let model = args.model.read()?;
    let levels = levels(&model, args.vertical)?;
    if args.json {
        let all: Vec<Value> = levels.iter().map(|(entry, interface)| as_json(entry, interface)).collect();
        return write_json(&all, out);
    }
    if args.markdown {
        return Ok(write!(out, "{}", page(&levels))?);
    }
    for (entry, interface) in &levels {
        writeln!(out, "{}\n    {}\n    validity: {}", entry.name, entry.about, entry.validity)?;
        writeln!(out, "    source: {}", entry.source)?;
        for (channel, [low, high], bandwidth) in rows(entry, interface) {
            let Channel { name, unit, about } = channel;
            let range = format!("{} to {}", rounded(low), rounded(high));
            writeln!(out, "    .{name} [{unit}], {range}, bandwidth {bandwidth} rad/s: {about}")?;
        }
    }
    Ok(())
}

/// The levels that the model has a form for, each with what its actions mean.
fn levels(model: &Model, asked: Option<VerticalInput>) -> Outcome<Vec<(&'static Entry, Interface)>> {
    let mut levels = Vec::new();
    for entry in registry() {
        if let Some(interface) = entry.interface(model, asked)? {
            levels.push((entry, interface));
        }
    }
    Ok(levels)
}

/// Returns, for each number of an action: its channel, the values of -1 and 1, and its bandwidth.
fn rows(entry: &Entry, interface: &Interface) -> impl Iterator<Item = (Channel, [f64; 2], f64)> {
    let ranges = interface.ranges();
    entry.channels.into_iter().zip(ranges).zip(entry.bandwidth_radps).map(|((c, range), b)| (c, range, b))
}

fn as_json(entry: &Entry, interface: &Interface) -> Value {
    let channels = rows(entry, interface).map(|(channel, [low, high], bandwidth)| {
        json!({"name": channel.name, "unit": channel.unit, "low": low, "high": high, "bandwidth_radps": bandwidth, "about": channel.about})
    });
    let channels: Vec<Value> = channels.collect();
    json!({"name": entry.name, "about": entry.about, "validity": entry.validity, "source": entry.source, "channels": channels})
}

/// The page of the documentation, by its table and list.
const PAGE: &str = include_str!("../../templates/actions.md");

fn page(levels: &[(&Entry, Interface)]) -> String {
    let rows =
        levels.iter().flat_map(|(entry, interface)| rows(entry, interface).map(move |row| (*entry, row)));
    let table = Table::from_rows(rows)
        .words("level", |(entry, _)| format!("`{}`", entry.name))
        .words("number", |(_, (channel, ..))| format!("`{}`", channel.name))
        .words("unit", |(_, (channel, ..))| channel.unit)
        .values("from", |(_, (_, [low, _], _))| rounded(low))
        .values("to", |(_, (_, [_, high], _))| rounded(high))
        .values("bandwidth, rad/s", |(_, (.., bandwidth))| bandwidth)
        .words("about", |(_, (channel, ..))| channel.about);
    let list = levels.iter().map(|(Entry { name, about, validity, source, .. }, _)| {
        format!("- `{name}`: {about}. Validity: {validity}. Source: {source}.\n")
    });
    render!(PAGE, table => table.markdown(), list => list.collect::<String>()) + "\n"
}

fn rounded(number: f64) -> f64 {
    (number * 1000.0).round() / 1000.0
}
