//! Opening logs: the same for every command that reads them.

use std::path::{Path, PathBuf};

use crazyflie_env::model::Model;
use crazyflie_identify::motor::carried::other_motors;
use crazyflie_logs::inspect::Grade;
use crazyflie_logs::{FlightLog, ReadOptions};

use super::{Failure, Outcome, with_cause};

/// Options for opening logs.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct OpenArgs {
    /// Mapping file: which column of a log is which channel, or what to mend [default: the one beside the log]
    #[arg(long, value_name = "FILE.toml")]
    mapping: Option<PathBuf>,
    /// Which flight of a file that holds several [default: 1]
    #[arg(long, value_name = "N")]
    part: Option<usize>,
    /// Go on with a log whose signs, units or clocks are wrong
    #[arg(long)]
    anyway: bool,
}

impl OpenArgs {
    pub(crate) fn options(&self) -> ReadOptions {
        ReadOptions { mapping: self.mapping.clone(), part: self.part, anyway: self.anyway, limit_mib: None }
    }

    /// Opens the log of a file; refused if it has grave findings. Other findings are summarised.
    pub(crate) fn open(&self, path: &Path) -> Outcome<FlightLog> {
        let log = FlightLog::open(path, &self.options()).map_err(|e| Failure::Failed(with_cause(&e)))?;
        warn(&path.display().to_string(), &log);
        Ok(log)
    }
}

/// Warns of the problems of a log, beside the output.
pub(crate) fn warn(file: &str, log: &FlightLog) {
    for finding in log.findings().iter().filter(|finding| finding.grade != Grade::Remark) {
        let word = if finding.grade == Grade::Grave { "grave" } else { "warning" };
        eprintln!("{file}: {word}: {finding}");
    }
}

/// Warns, beside the output, if the motors that flew cannot be those of the model.
pub(crate) fn warn_of_motors<'a>(
    model: &Model,
    mass_kg: Option<f64>,
    logs: impl IntoIterator<Item = &'a FlightLog>,
) {
    if let Some(other) = other_motors(model, mass_kg, &logs.into_iter().collect::<Vec<_>>()) {
        eprintln!("warning: {other}");
    }
}
