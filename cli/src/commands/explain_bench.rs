//! `crazyflie explain-bench`: explanations of flights with hidden effects, held against the truth.

use std::io::Write;
use std::path::{Path, PathBuf};

use crazyflie_identify::explain::threshold::{self, Threshold};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

use super::{Failure, Outcome, explain_bench_page, explain_bench_table, with_cause};
use crate::score::{
    CaseFile, CaseRecord, FACTORS, Provenance, Rates, Results, RowFile, Schedule, find_cases,
    measure_sensitivity, score_all,
};

const EXAMPLES: &str = "\
Examples:
  crazyflie explain-bench ../shared/data/hidden_effects
  crazyflie explain-bench ../shared/data/hidden_effects --only d05,d32 --oracle
  crazyflie explain-bench population/ --oracle --rows rows.jsonl --json results.json
  crazyflie explain-bench few/ --sensitivity --json sensitivity.json
  crazyflie explain-bench --from results.json --markdown docs/rates.md";

/// Standard output, as a file name.
const STDOUT: &str = "-";

/// Explain every case of some folders (dNN.json), then score what was named against the truth
/// (dNN.answer.json).
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Folders of case files, flights and answers
    #[arg(required_unless_present = "from", value_name = "FOLDER")]
    folders: Vec<PathBuf>,
    /// These cases only
    #[arg(long, value_delimiter = ',', value_name = "ID,...")]
    only: Vec<String>,
    /// Compare the errors on the held-out flight with those of a fit that is given the answer; takes time
    #[arg(long, visible_alias = "told")]
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
    /// For machines: every case's row and the rates, to a file or to standard output
    #[arg(long, num_args = 0..=1, default_missing_value = STDOUT, value_name = "FILE")]
    json: Option<PathBuf>,
    /// A page of rates for documents, to a file or to standard output
    #[arg(long, num_args = 0..=1, default_missing_value = STDOUT, value_name = "FILE")]
    markdown: Option<PathBuf>,
}

impl Args {
    /// Whether standard output belongs to a document.
    fn prints_document(&self) -> bool {
        [&self.json, &self.markdown].into_iter().flatten().any(|path| is_stdout(path))
    }
}

fn is_stdout(path: &Path) -> bool {
    path == Path::new(STDOUT)
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    if [&args.json, &args.markdown].into_iter().flatten().filter(|path| is_stdout(path)).count() > 1 {
        return Err(Failure::Usage(
            "--json and --markdown cannot both go to standard output: name a file".into(),
        ));
    }
    let runs = if args.from.is_empty() { vec![run_cases(args)?] } else { read_runs(&args.from)? };
    if let Some(path) = &args.json {
        let document: Vec<_> = runs.iter().map(as_json).collect();
        let document = if let [one] = &document[..] { one.clone() } else { json!(document) };
        write_document(path, &format!("{document:#}\n"), out)?;
    }
    if let Some(path) = &args.markdown {
        write_document(path, &explain_bench_page::page(&runs), out)?;
    }
    if !args.prints_document() {
        runs.iter().try_for_each(|results| write!(out, "{}", explain_bench_table::plain(results)))?;
    }
    let failures: Vec<String> = runs
        .iter()
        .flat_map(|run| &run.cases)
        .filter_map(|r| Some(format!("{}: {}", r.case, r.failed.as_ref()?)))
        .collect();
    if failures.is_empty() {
        return Ok(());
    }
    let count: usize = runs.iter().map(|run| run.cases.len()).sum();
    Err(Failure::Failed(format!(
        "{} of {count} cases could not be explained\n{}",
        failures.len(),
        failures.join("\n")
    )))
}

fn write_document(path: &Path, text: &str, out: &mut dyn Write) -> Outcome {
    if is_stdout(path) {
        return Ok(out.write_all(text.as_bytes())?);
    }
    std::fs::write(path, text).map_err(|e| Failure::about(path.display(), e))
}

fn read_runs(paths: &[PathBuf]) -> Outcome<Vec<Results>> {
    paths.iter().map(|path| Results::read(path).map_err(|e| Failure::Failed(with_cause(&e)))).collect()
}

/// The object that programs read; `totals` by group and criterion.
fn as_json(results: &Results) -> serde_json::Value {
    let rates = Rates::from_records(&results.cases);
    let totals = explain_bench_table::totals_json(&rates);
    let mut all = json!({"run": results.run, "cases": results.cases, "totals": totals, "rates": rates});
    if !results.sensitivity.is_empty() {
        all["sensitivity"] = json!(results.sensitivity);
    }
    all
}

fn run_cases(args: &Args) -> Outcome<Results> {
    let (cases, thresholds) = (chosen_cases(args)?, chosen_thresholds(args)?);
    // whatever is missing is said before an hour is spent on the rest
    for case in &cases {
        case.check().map_err(|e| Failure::Failed(with_cause(&e)))?;
    }
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let jobs = args.jobs.map_or(processors, usize::from).min(cases.len());
    let schedule = Schedule { jobs, threads: (processors / jobs).max(1), with_oracle: args.oracle };
    let mut run = Provenance::now(command_line(args), jobs, schedule.threads);
    let bar = ProgressBar::new((cases.len() * (1 + FACTORS.len() * thresholds.len())) as u64);
    let style = ProgressStyle::with_template("{bar:24} {pos}/{len} {elapsed} {msg}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let progress = |case: &CaseFile, stage: &str| bar.set_message(format!("{}: {stage}", case.id));
    let done = |record: &CaseRecord| {
        // a long run that is cut off has said what it found
        bar.suspend(|| eprintln!("{}", explain_bench_table::line(record)));
        bar.inc(1);
        Ok(())
    };
    let scored = if let Some(path) = &args.rows {
        let rows = RowFile::open(path, &run, args.oracle).map_err(|e| Failure::Failed(with_cause(&e)))?;
        run.machine = rows.machines();
        rows.complete(&cases, schedule, &progress, &done)
    } else {
        score_all(&cases, schedule, &progress, &done)
    };
    let scored = scored.map_err(Failure::Failed)?;
    let sensitivity = measure_sensitivity(&cases, schedule, &scored, &thresholds, &progress, &done);
    bar.finish_and_clear();
    Ok(Results { run, cases: scored, sensitivity: sensitivity.map_err(Failure::Failed)? })
}

/// The command, as a page tells how to run it again; paths as given.
fn command_line(args: &Args) -> String {
    let mut words = vec!["crazyflie explain-bench".to_owned()];
    words.extend(args.folders.iter().map(|folder| folder.display().to_string()));
    words.extend((!args.only.is_empty()).then(|| format!("--only {}", args.only.join(","))));
    words.extend(args.oracle.then(|| "--oracle".to_owned()));
    words.extend(args.sensitivity.as_ref().map(|names| match &names[..] {
        [] => "--sensitivity".to_owned(),
        names => format!("--sensitivity={}", names.join(",")),
    }));
    words.extend(args.jobs.map(|jobs| format!("--jobs {jobs}")));
    words.join(" ")
}

/// The case files that were asked for.
fn chosen_cases(args: &Args) -> Outcome<Vec<CaseFile>> {
    let mut all = Vec::new();
    for folder in &args.folders {
        let cases = find_cases(folder).map_err(|e| Failure::about(folder.display(), e))?;
        if cases.is_empty() {
            return Err(Failure::about(folder.display(), "holds no case files (d00.json, d01.json, ...)"));
        }
        all.extend(cases);
    }
    let ids: Vec<&str> = all.iter().map(|case| case.id.as_str()).collect();
    if let Some(other) = args.only.iter().find(|name| !ids.contains(&name.as_str())) {
        return Err(crazyflie_env::error::unknown("case", other, ids.iter().copied()).into());
    }
    Ok(all.into_iter().filter(|case| args.only.is_empty() || args.only.contains(&case.id)).collect())
}

/// The thresholds that were asked for: none without `--sensitivity`, all of them without names.
fn chosen_thresholds(args: &Args) -> Outcome<Vec<&'static Threshold>> {
    let Some(names) = &args.sensitivity else { return Ok(Vec::new()) };
    let all: Vec<&'static Threshold> = threshold::all().collect();
    if names.is_empty() {
        return Ok(all);
    }
    let paths: Vec<String> = all.iter().map(|threshold| threshold.path()).collect();
    let find = |name: &String| {
        let at = paths.iter().position(|path| path == name);
        at.map(|at| all[at]).ok_or_else(|| {
            crazyflie_env::error::unknown("threshold", name, paths.iter().map(String::as_str)).into()
        })
    };
    names.iter().map(find).collect()
}
