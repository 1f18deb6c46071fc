//! `crazyflie inspect`: the contents of a log, and the uses that it suffices for.

use std::io::Write;
use std::path::{Path, PathBuf};

use crazyflie_logs::draft::Draft;
use crazyflie_logs::inspect::{Finding, Grade, Inspection};
use crazyflie_logs::{FlightLog, LogError, variables_markdown};
use serde_json::json;

use super::open::OpenArgs;
use super::{Failure, Outcome, files, inspect_table, with_cause, write_json};

/// Report the content of flight logs: channels, gaps, clocks, signs, excitation, and the commands they suffice
/// for.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Logs of any format, a.csv+b.csv for several files of one flight; a log of unknown columns is read by a
    /// mapping that is drafted on the spot
    #[arg(required_unless_present = "variables", value_name = "LOG")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    logs: OpenArgs,
    /// Write a draft of a mapping file
    #[arg(long, value_name = "FILE.toml")]
    mapping_out: Option<PathBuf>,
    /// List the variables of the firmware that are understood
    #[arg(long, exclusive = true)]
    variables: bool,
    /// Draw position, attitude and commands; a folder if there are several logs
    #[arg(long, value_parser = files::picture_or_folder, value_name = "FILE.svg|png|pdf")]
    picture: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A log and what was found in it.
pub(super) struct InspectedLog {
    pub file: String,
    pub log: FlightLog,
    pub inspection: Inspection,
    /// True if it was read by a mapping that nobody has checked yet.
    pub by_draft: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    if args.variables {
        return Ok(write!(out, "{}", variables_markdown())?);
    }
    files::check_target(args.picture.as_deref(), args.files.len())?;
    if let Some(target) = &args.mapping_out {
        let [file] = &args.files[..] else {
            return Err(Failure::Usage("--mapping-out drafts a mapping for one file: name one".into()));
        };
        let draft = draft(file)?;
        files::write(target, draft.text.as_bytes())?;
    }
    let (inspected, failed) = files::each(&args.files, |path| inspect(args, path))?;
    if args.json {
        let log =
            |i: &InspectedLog| json!({"file": i.file, "by_draft": i.by_draft, "inspection": i.inspection});
        let logs: Vec<_> = inspected.iter().map(log).collect();
        write_json(&json!({"logs": logs, "failed": failed}), out)?;
    } else {
        inspected.iter().try_for_each(|found| inspect_table::write(found, out))?;
    }
    for found in &inspected {
        files::write_log_picture(args.picture.as_deref(), &found.file, || inspect_table::picture(found))?;
    }
    files::refuse_failed(&failed, args.files.len(), "cannot be read")
}

/// Reads a log; one of unknown columns, or with some of a format's, by a draft, if that suffices.
fn inspect(args: &Args, path: &Path) -> Outcome<InspectedLog> {
    let file = path.display().to_string();
    match FlightLog::read_with(path, &args.logs.options()) {
        Ok(log) => Ok(InspectedLog { file, inspection: Inspection::from_log(&log), log, by_draft: false }),
        Err(error @ (LogError::UnknownFormat { .. } | LogError::MissingColumns { .. })) => {
            by_draft(path, &error)
        }
        Err(error) => Err(Failure::Failed(with_cause(&error))),
    }
}

/// Reads a log by the draft of a mapping, after this error.
fn by_draft(path: &Path, error: &LogError) -> Outcome<InspectedLog> {
    let refused = |reason: String| {
        let hint = "crazyflie inspect --mapping-out FILE.toml writes what could be guessed";
        Failure::Failed(format!("{error}\n  the draft of a mapping does not suffice ({reason}); {hint}"))
    };
    let draft = Draft::of_log(path).map_err(|error| refused(with_cause(&error)))?;
    let log = draft.log.map_err(refused)?;
    let mut inspection = Inspection::from_log(&log);
    for need in &mut inspection.needs {
        need.missing.push("a mapping file, which --mapping-out drafts");
    }
    if !draft.guesses.is_empty() {
        let text = format!("units that are guesses that nothing checks: {}", draft.guesses.join(", "));
        inspection.findings.push(Finding { grade: Grade::Warning, text, cure: None });
    }
    Ok(InspectedLog { file: path.display().to_string(), log, inspection, by_draft: true })
}

fn draft(path: &Path) -> Outcome<Draft> {
    Draft::of_log(path).map_err(|error| Failure::Failed(with_cause(&error)))
}
