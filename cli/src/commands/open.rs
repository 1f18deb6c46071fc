//! Opening logs: the same for every command that reads them.

use std::cell::RefCell;
use std::io::Write;
use std::path::{Path, PathBuf};

use crazyflie_env::model::Model;
use crazyflie_identify::motor::carried::other_motors;
use crazyflie_logs::inspect::Grade;
use crazyflie_logs::{FlightLog, ReadOptions};
use serde_json::{Value, json};

use super::{Failure, Outcome, with_cause, write_json};

/// Options for opening logs.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct OpenArgs {
    /// Mapping file: channels of a log's columns, or corrections of them [default: the one beside the log]
    #[arg(long, value_name = "FILE.toml")]
    mapping: Option<PathBuf>,
    /// Number of the flight in a file of several [default: 1]
    #[arg(long, value_name = "N")]
    part: Option<usize>,
    /// Go on with a log whose signs, units or clocks are wrong
    #[arg(long)]
    anyway: bool,
    /// Warnings of the logs so far, for machines.
    #[arg(skip)]
    warnings: RefCell<Vec<String>>,
}

impl OpenArgs {
    pub(crate) fn options(&self) -> ReadOptions {
        ReadOptions { mapping: self.mapping.clone(), part: self.part, anyway: self.anyway, limit_mib: None }
    }

    /// Opens the log of a file; refused if it has grave findings. Other findings are summarised.
    pub(crate) fn open(&self, path: &Path) -> Outcome<FlightLog> {
        let log = FlightLog::open(path, &self.options()).map_err(|e| Failure::Failed(with_cause(&e)))?;
        self.warn(&path.display().to_string(), &log);
        Ok(log)
    }

    fn tell(&self, warning: String) {
        eprintln!("{warning}");
        self.warnings.borrow_mut().push(warning);
    }

    /// Warns of the problems of a log.
    pub(crate) fn warn(&self, file: &str, log: &FlightLog) {
        for finding in log.findings().iter().filter(|finding| finding.grade != Grade::Remark) {
            let word = if finding.grade == Grade::Grave { "grave" } else { "warning" };
            self.tell(format!("{file}: {word}: {finding}"));
        }
    }

    /// Warns if the motors that flew cannot be those of the model.
    pub(crate) fn warn_of_motors<'a>(
        &self,
        model: &Model,
        mass_kg: Option<f64>,
        logs: impl IntoIterator<Item = &'a FlightLog>,
    ) {
        if let Some(other) = other_motors(model, mass_kg, &logs.into_iter().collect::<Vec<_>>()) {
            self.tell(format!("warning: {other}"));
        }
    }

    /// Adds the warnings so far to an object for machines.
    pub(crate) fn with_warnings(&self, mut object: Value) -> Value {
        object["warnings"] = json!(*self.warnings.borrow());
        object
    }

    /// Writes an object for machines, with the warnings so far.
    pub(crate) fn write_json(&self, object: Value, out: &mut dyn Write) -> Outcome {
        write_json(&self.with_warnings(object), out)
    }
}
