//! `crazyflie bench robustness`: controllers against faults unknown to them.

use std::io::Write;
use std::path::PathBuf;

use crazyflie_control::registry;
use crazyflie_picture::{Drawing, PALETTE, Panel, PictureError, Style, chart};
use indicatif::ProgressBar;

use super::{Outcome, Table, cm, controllers, files, interval, number, settled, write_json};
use crazyflie_bench::conditions::CONDITIONS;
use crazyflie_bench::robustness::{RobustnessRow, compare};

/// Fly controllers in scenarios of the benchmark as declared, with parameters drawn anew in every flight, and
/// with an undeclared effect.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Which controllers, as NAME, NAME:FILE, python:FILE:NAME or kalman+NAME [default: all that need no file, and the thesis's
    /// PID behind the Kalman filter]
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    controllers: Vec<String>,
    /// Which scenarios (see `crazyflie bench scenarios`)
    #[arg(long, value_delimiter = ',', default_value = "hover-aruco,fly-80cm", value_name = "NAMES")]
    scenarios: Vec<String>,
    /// Flights per controller, scenario and condition
    #[arg(long, default_value_t = 48, value_parser = clap::value_parser!(u32).range(20..=10_000), value_name = "N")]
    seeds: u32,
    /// First seed, far from the seeds of training
    #[arg(long, default_value_t = 1_000_000, value_name = "N")]
    first_seed: u64,
    /// Draw scores and intervals
    #[arg(long, value_parser = files::picture, value_name = "FILE.svg|png|pdf")]
    picture: Option<PathBuf>,
    /// Print JSON
    #[arg(long, conflicts_with = "markdown")]
    json: bool,
    /// Print a Markdown table
    #[arg(long)]
    markdown: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let built_in = registry().iter().filter(|e| e.file.is_none()).map(|e| e.name.to_owned());
    let default: Vec<String> = built_in.chain(["kalman+thesis-pid".into()]).collect();
    let controllers = if args.controllers.is_empty() { &default } else { &args.controllers };
    let chosen =
        controllers.iter().map(|name| controllers::chosen(name, None)).collect::<Outcome<Vec<_>>>()?;
    let seeds: Vec<u64> = (0..u64::from(args.seeds)).map(|i| args.first_seed.wrapping_add(i)).collect();
    let bar = ProgressBar::new((chosen.len() * args.scenarios.len() * CONDITIONS.len()) as u64);
    let lines = compare(&chosen, &args.scenarios, &seeds, &|| bar.inc(1))?;
    bar.finish_and_clear();
    files::picture_to(args.picture.as_ref(), || picture(&lines))?;
    if args.json {
        return write_json(&lines, out);
    }
    let table = table(&lines);
    if args.markdown {
        return Ok(write!(out, "{}", table.markdown())?);
    }
    writeln!(out, "{table}")?;
    for condition in &CONDITIONS {
        writeln!(out, "{}: {}", condition.name, condition.about)?;
    }
    Ok(())
}

fn table(lines: &[RobustnessRow]) -> Table<&RobustnessRow> {
    Table::from_rows(lines)
        .words("scenario", |l| &l.scenario)
        .words("condition", |l| l.condition)
        .words("controller", |l| &l.controller)
        .values("score", |l| number(l.score, 1))
        .values("95 %", |l| interval(l.low, l.high))
        .values("failed", |l| format!("{} of {}", l.failed, l.flights))
        .values("RMS error", |l| cm(l.rmse_m))
        .values("overshoot", |l| cm(l.overshoot_m))
        .values("settled", |l| settled(l.settled, l.flights, l.settling_s))
}

/// Per scenario: scores with their intervals, and the first nominal flight; a colour per controller.
fn picture(lines: &[RobustnessRow]) -> Result<Drawing, PictureError> {
    let controllers = names(lines, |l| &l.controller);
    let mut panels = Vec::new();
    for scenario in names(lines, |l| &l.scenario) {
        let mut scores = Panel::new("condition", "score (1)")
            .title(scenario)
            .categories(CONDITIONS.each_ref().map(|condition| condition.name));
        let mut flights = Panel::new("time (s)", "distance to the set-point (m)").title(scenario);
        for ((i, controller), color) in controllers.iter().enumerate().zip(PALETTE.into_iter().cycle()) {
            let own = lines.iter().filter(|l| l.scenario == scenario && l.controller == *controller);
            // side by side, so that intervals can be told apart
            let aside = 0.06 * (i as f64 - 0.5 * (controllers.len() - 1) as f64);
            let (mut x, mut y) = (Vec::new(), Vec::new());
            for (condition, l) in own.enumerate() {
                x.push(condition as f64 + aside);
                y.push(l.score);
                scores = scores.curve(Style::Solid, color, "", [x[condition]; 2], [l.low, l.high]);
                if l.condition == CONDITIONS[0].name && !l.first[0].is_empty() {
                    flights = flights.curve(Style::Solid, color, *controller, &l.first[0], &l.first[1]);
                }
            }
            scores = scores.curve(Style::Points, color, *controller, x, y);
        }
        panels.extend([scores, flights]);
    }
    chart(&panels, 2, "Score and 95 % interval under each condition; beside it the first nominal flight")
}

fn names<'a>(lines: &'a [RobustnessRow], name_of: impl Fn(&'a RobustnessRow) -> &'a String) -> Vec<&'a str> {
    let mut all: Vec<&str> = Vec::new();
    for name in lines.iter().map(name_of).map(String::as_str) {
        if !all.contains(&name) {
            all.push(name);
        }
    }
    all
}
