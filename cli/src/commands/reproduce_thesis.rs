//! `crazyflie reproduce thesis`: the thesis's experiments again, its figures beside ours.

use std::io::Write;
use std::path::PathBuf;

use indicatif::ProgressBar;
use serde_json::{Value, json};

use super::{Failure, Outcome, Table, files, number};
use crate::scorecard::{COUNT, Measurement, ScorecardRow, lines, pictures};

const EXAMPLES: &str = "\
Examples:
  crazyflie reproduce thesis
  crazyflie reproduce thesis --markdown              the table that docs/thesis.md holds
  crazyflie reproduce thesis --picture pictures/";

/// Run every experiment of the thesis on the simulator, and print its figures beside ours.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// For machines
    #[arg(long, conflicts_with = "markdown")]
    json: bool,
    /// The table between the scorecard markers of docs/thesis.md
    #[arg(long)]
    markdown: bool,
    /// Draw the closed-loop flights, one SVG each
    #[arg(long, value_parser = files::picture_or_folder, value_name = "FOLDER")]
    picture: Option<PathBuf>,
}

const LEGEND: &str = "\
Ideal: the controller knows the true position at every 50 Hz tick. Camera rig: 30 Hz frames, 50 ms late, with 5 mm (x, y) and 10 mm (z) of
noise at 70 cm; median over 15 seeds. In brackets the deviation from the thesis's figure; \"agrees\" is within 25 %, about what the thesis's
words and plots can be read to. Old gains: `crazyflie_ros` defaults, since the thesis does not print what it flew before table 7.1.";

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let bar = ProgressBar::new(COUNT as u64);
    let all = lines(&|| bar.inc(1))?;
    bar.finish_and_clear();
    if let Some(folder) = &args.picture {
        for (name, svg) in pictures().map_err(|e| Failure::about("the scorecard's pictures", e))? {
            files::write_picture(&folder.join(name), &svg)?;
        }
    }
    if args.json {
        let list: Vec<Value> = all.iter().map(as_json).collect();
        serde_json::to_writer_pretty(&mut *out, &list)?;
        return Ok(writeln!(out)?);
    }
    if args.markdown {
        // where the thesis gives no figure, rows are there for the reader who unfolds them
        let (folded, open): (Vec<_>, Vec<_>) = all.iter().partition(|line| line.mark() == "not comparable");
        let (count, open, folded) = (folded.len(), table(&open).markdown(), table(&folded).markdown());
        let summary = format!("{count} more rows, which are not comparable");
        return Ok(write!(
            out,
            "{open}\n<details markdown=\"1\">\n<summary>{summary}</summary>\n\n{folded}\n</details>\n\n{LEGEND}\n"
        )?);
    }
    let all: Vec<_> = all.iter().collect();
    Ok(write!(out, "{}\n{LEGEND}\n", table(&all).plain())?)
}

fn table(all: &[&ScorecardRow]) -> Table {
    let header = [
        "experiment",
        "thesis",
        "gains",
        "quantity",
        "thesis's figure",
        "ours, ideal",
        "ours, camera rig",
        "mark",
        "why",
    ];
    let mut table = Table::new(&header).left(&[1, 2, 3, 4, 7, 8]);
    let mut before = "";
    for line in all {
        // the experiment is named in its first line only
        let first = |text: &str| if before == line.experiment { String::new() } else { text.to_owned() };
        table.row(vec![
            first(line.experiment),
            first(line.place),
            line.gains.into(),
            line.quantity.into(),
            line.claim.words().into(),
            cell(line, line.ideal.as_ref()),
            cell(line, line.rig.as_ref()),
            line.mark().into(),
            reason(line).into(),
        ]);
        before = line.experiment;
    }
    table
}

/// An explanation, where there is something to explain.
fn reason(line: &ScorecardRow) -> &str {
    if line.mark() == "agrees" && line.rig.is_some() { "" } else { line.why }
}

fn cell(line: &ScorecardRow, figure: Option<&Measurement>) -> String {
    let Some(figure) = figure else { return String::new() };
    if !figure.value.is_finite() {
        return "never".into();
    }
    // three digits are enough, and those of an unstable flight mean little
    let decimals = if figure.value.abs() >= 99.995 { 0 } else { figure.decimals };
    let own = format!("{} {}", number(figure.value, decimals), figure.unit);
    match line.claim.deviation(figure) {
        Some(off) => format!("{own} ({})", signed_number(off, decimals)),
        None => own,
    }
}

/// A deviation with its sign; what prints as zero has none.
fn signed_number(off: f64, decimals: usize) -> String {
    let text = number(off, decimals);
    let zero = text.chars().all(|c| matches!(c, '0' | '.'));
    if zero || text.starts_with('-') { text } else { format!("+{text}") }
}

fn as_json(line: &ScorecardRow) -> Value {
    let figure = |f: &Option<Measurement>| {
        f.map(|f| {
            let value = f.value.is_finite().then_some(f.value);
            json!({"value": value, "unit": f.unit, "deviation": line.claim.deviation(&f), "agrees": line.claim.agrees(&f)})
        })
    };
    json!({"experiment": line.experiment, "thesis_place": line.place, "gains": line.gains, "quantity": line.quantity,
        "thesis": line.claim.words(), "ideal": figure(&line.ideal), "camera_rig": figure(&line.rig), "mark": line.mark(), "why": line.why})
}
