//! The rig that measures `explain`: it explains every case of some folders (dNN.json), then compares the answers with
//! the truth (dNN.answer.json).

#![forbid(unsafe_code)]

mod case_file;
mod oracle;
mod page;
mod rates;
mod record;
mod results;
mod row_file;
mod scoring;
mod sensitivity;
mod truth;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use crazyflie_env::error::unknown;
use crazyflie_identify::explain::threshold::{self, Threshold};

use case_file::{CaseFile, find_cases};
use results::{Provenance, Results, to_json};
use row_file::RowFile;
use scoring::{Schedule, score_all};
use sensitivity::measure_sensitivity;

const EXAMPLES: &str = "\
Examples, each after `cargo run --release -p crazyflie-lab --`:
  ../shared/data/hidden_effects
  ../shared/data/hidden_effects --only d05,d32 --oracle
  population/ --oracle --rows rows.jsonl --json results.json
  few/ --sensitivity --json sensitivity.json
  --from docs/rates/rates.json --markdown docs/rates.md";

/// Standard output, as a file name.
const STDOUT: &str = "-";

/// Explain every case of some folders (dNN.json), then score what was named against the truth
/// (dNN.answer.json).
#[derive(Debug, Parser)]
#[command(version, after_help = EXAMPLES, max_term_width = 100)]
struct Args {
    /// Folders of case files, flights and answers
    #[arg(required_unless_present = "from", value_name = "FOLDER")]
    folders: Vec<PathBuf>,
    /// These cases only
    #[arg(long, value_delimiter = ',', value_name = "ID,...")]
    only: Vec<String>,
    /// Compare the errors on the held-out flight with those of a fit that is given the answer; takes time
    #[arg(long)]
    oracle: bool,
    /// Cases side by side; as many as there are processors unless given. The seconds of a case are of its
    /// share of these
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Explain the cases again with each threshold of the search at 0.7 and 1.4 of its value, or with these
    /// (stage.NAME,...) only; takes fifty times as long
    #[arg(long, num_args = 0..=1, require_equals = true, value_delimiter = ',', value_name = "NAME,...")]
    sensitivity: Option<Vec<String>>,
    /// Keep each case's row in this file as it ends, and take the rows that it holds already: a long run
    /// that was cut off goes on with the same command. A program that answers otherwise needs a new file
    #[arg(long, value_name = "FILE")]
    rows: Option<PathBuf>,
    /// Take the results of earlier runs (made with --json) instead of running
    #[arg(long, num_args = 1.., value_name = "RESULTS", conflicts_with_all = ["folders", "only", "oracle", "jobs", "sensitivity", "rows"])]
    from: Vec<PathBuf>,
    /// For machines: the rates, and every case's row unless they are --from results
    #[arg(long, num_args = 0..=1, default_missing_value = STDOUT, value_name = "FILE")]
    json: Option<PathBuf>,
    /// A page of rates; to standard output unless --json is given
    #[arg(long, num_args = 0..=1, default_missing_value = STDOUT, value_name = "FILE")]
    markdown: Option<PathBuf>,
}

fn main() -> Result<()> {
    let args = Args::parse();
    let runs = if args.from.is_empty() { vec![run_cases(&args)?] } else { read_runs(&args.from)? };
    if let Some(path) = &args.json {
        write_document(path, &to_json(&runs)?)?;
    }
    let default = args.json.is_none().then(|| STDOUT.into());
    if let Some(path) = args.markdown.or(default) {
        write_document(&path, &page::page(&runs))?;
    }
    let failed = runs.iter().flat_map(|run| &run.cases).filter(|record| record.failed.is_some());
    let failed: Vec<String> = failed.map(ToString::to_string).collect();
    ensure!(failed.is_empty(), "{} cases could not be explained\n{}", failed.len(), failed.join("\n"));
    Ok(())
}

fn write_document(path: &Path, text: &str) -> Result<()> {
    if path == Path::new(STDOUT) {
        print!("{text}");
        return Ok(());
    }
    std::fs::write(path, text).with_context(|| path.display().to_string())
}

fn read_runs(files: &[PathBuf]) -> Result<Vec<Results>> {
    Ok(files.iter().map(|file| Results::read(file)).collect::<Result<Vec<_>>>()?.concat())
}

fn run_cases(args: &Args) -> Result<Results> {
    let (cases, thresholds) = (chosen_cases(args)?, chosen_thresholds(args)?);
    // missing files are reported before an hour of work
    for case in &cases {
        case.check()?;
    }
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let jobs = args.jobs.map_or(processors, usize::from).min(cases.len());
    let schedule = Schedule { jobs, threads: (processors / jobs).max(1), with_oracle: args.oracle };
    let run = Provenance::now(jobs, schedule.threads);
    let rows = args.rows.as_ref().map(|path| RowFile::open(path, &run, args.oracle)).transpose()?;
    let scored = score_all(&cases, schedule, rows.as_ref())?;
    let sensitivity = measure_sensitivity(&cases, schedule, &scored, &thresholds)?;
    Ok(Results::new(run, scored, sensitivity))
}

/// Returns the requested case files.
fn chosen_cases(args: &Args) -> Result<Vec<CaseFile>> {
    let mut all = args.folders.iter().map(|folder| find_cases(folder)).collect::<Result<Vec<_>>>()?.concat();
    if let Some(other) = args.only.iter().find(|name| !all.iter().any(|case| case.id == **name)) {
        return Err(unknown("case", other, all.iter().map(|case| case.id.as_str())).into());
    }
    all.retain(|case| args.only.is_empty() || args.only.contains(&case.id));
    Ok(all)
}

/// Returns the requested thresholds: none without `--sensitivity`, all of them without names.
fn chosen_thresholds(args: &Args) -> Result<Vec<&'static Threshold>> {
    let Some(names) = &args.sensitivity else { return Ok(Vec::new()) };
    let mut all: Vec<&'static Threshold> = threshold::all().collect();
    let paths: Vec<String> = all.iter().map(|threshold| threshold.path()).collect();
    if let Some(other) = names.iter().find(|name| !paths.contains(name)) {
        return Err(unknown("threshold", other, paths.iter().map(String::as_str)).into());
    }
    all.retain(|threshold| names.is_empty() || names.contains(&threshold.path()));
    Ok(all)
}
