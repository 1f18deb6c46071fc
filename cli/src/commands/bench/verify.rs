//! `crazyflie bench verify`: stored attempts, checked and re-run.

use std::io::Write;

use indicatif::ProgressBar;
use serde_json::json;

use super::{Common, Failure, Outcome, Table, write_json};
use crazyflie_bench::{Bench, NewestRow, Verdict, Verification};

/// Check signatures and actions of stored attempts, fly them again and compare bit by bit.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// An attempt's id, or all
    #[arg(default_value = "all", value_name = "ID")]
    attempt: String,
    /// Row that must exist: its number and SHA-256, from "newest" of /api/v1/key or of this command's --json
    #[arg(long, value_name = "NUMBER:SHA256")]
    newest: Option<NewestRow>,
    #[command(flatten)]
    common: Common,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let bench = args.common.database.open_existing()?;
    let (found, missing) = match args.attempt.as_str() {
        "all" => all(&bench)?,
        id => (vec![bench.verify(id)?], Vec::new()),
    };
    let is_cut = match &args.newest {
        Some(noted) => !bench.has_row(noted)?,
        None => false,
    };
    if args.common.json {
        let newest = bench.newest()?;
        let told = json!({"attempts": found, "missing": missing, "public_key": bench.public_key(), "newest": newest});
        write_json(&told, out)?;
    } else {
        write!(out, "{}", table(&found))?;
        missing.iter().try_for_each(|number| writeln!(out, "attempt number {number} is missing"))?;
    }
    if let Some(NewestRow { number, .. }) = args.newest.as_ref().filter(|_| is_cut) {
        let problem = "is not here as it was noted: rows were cut off or changed";
        return Err(Failure::Failed(format!("attempt number {number} {problem}")));
    }
    let all = found.len() + missing.len();
    match found.iter().filter(|v| v.verdict == Verdict::Wrong).count() + missing.len() {
        0 => Ok(()),
        wrong => Err(Failure::Failed(format!("{wrong} of {all} attempts are wrong or missing"))),
    }
}

/// Verifies all attempts behind a bar; also the numbers that are missing.
pub(super) fn all(bench: &Bench) -> Outcome<(Vec<Verification>, Vec<i64>)> {
    let bar = ProgressBar::no_length();
    let verified = bench.verify_all(&|done, of| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    Ok(verified)
}

/// A row for each attempt.
pub(super) fn table(found: &[Verification]) -> Table<&Verification> {
    Table::from_rows(found)
        .words("attempt", |v| &v.id)
        .words("scenario", |v| &v.scenario)
        .words("controller", |v| &v.controller)
        .words("verdict", |v| words(v.verdict))
        .words("findings", |v| v.findings.join("; "))
}

fn words(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Confirmed => "confirmed",
        Verdict::OtherBuild => "intact, of another build",
        Verdict::Unfinished => "intact, not finished",
        Verdict::Wrong => "WRONG",
    }
}
