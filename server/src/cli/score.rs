//! `crazyflie score`: explanations of flights with hidden effects, held against the truth.

use std::io::Write;
use std::path::PathBuf;

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

use super::{Failure, Outcome, score_table};
use crate::score::{Scored, cases, id, score};

const EXAMPLES: &str = "\
Examples:
  crazyflie score ../shared/data/hidden_effects
  crazyflie score ../shared/data/hidden_effects --only d05,d32 --told
  crazyflie score ../shared/data/hidden_effects --json
  crazyflie score ../shared/data/hidden_effects --markdown";

/// Explain every case of a folder (dNN.json), then score what was named against the truth (dNN.answer.json, where there is one).
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Folder of case files, flights and answers
    folder: PathBuf,
    /// These cases only
    #[arg(long, value_delimiter = ',', value_name = "ID,...")]
    only: Vec<String>,
    /// Compare the errors on the held-out flight with those of a fit that is told the answer; takes time
    #[arg(long)]
    told: bool,
    /// For machines
    #[arg(long, conflicts_with = "markdown")]
    json: bool,
    /// For documents
    #[arg(long)]
    markdown: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let chosen = chosen(args)?;
    let bar = if args.json { ProgressBar::hidden() } else { ProgressBar::new(chosen.len() as u64) };
    let style = ProgressStyle::with_template("{bar:24} {pos}/{len} {elapsed} {msg}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let mut all: Vec<Scored> = Vec::new();
    for path in &chosen {
        let name = id(path);
        let scored = score(path, args.told, &|what| bar.set_message(format!("{name}: {what}")));
        // a long run that is cut off has said what it found
        bar.suspend(|| eprintln!("{}", score_table::line(&scored)));
        all.push(scored);
        bar.inc(1);
    }
    bar.finish_and_clear();
    if args.json {
        let cases: Vec<_> = all.iter().map(score_table::as_json).collect();
        serde_json::to_writer_pretty(&mut *out, &json!({"cases": cases, "totals": score_table::totals_json(&all)}))?;
        return Ok(writeln!(out)?);
    }
    score_table::print(&all, args.markdown, out)
}

/// The case files that were asked for.
fn chosen(args: &Args) -> Outcome<Vec<PathBuf>> {
    let all = cases(&args.folder).map_err(|e| Failure::about(args.folder.display(), e))?;
    if all.is_empty() {
        return Err(Failure::about(args.folder.display(), "holds no case files (d00.json, d01.json, ...)"));
    }
    let ids: Vec<String> = all.iter().map(|path| id(path)).collect();
    if let Some(other) = args.only.iter().find(|name| !ids.contains(name)) {
        return Err(crazyflie_env::error::unknown("case", other, ids.iter().map(String::as_str)).into());
    }
    Ok(all.into_iter().filter(|path| args.only.is_empty() || args.only.contains(&id(path))).collect())
}
