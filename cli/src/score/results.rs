//! Results of a run, as a file keeps them: pages are made of them without running again.

use std::path::Path;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::record::CaseRecord;
use super::sensitivity::SensitivityRow;

/// Provenance of a run.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Provenance {
    pub command: String,
    /// Day of the run.
    pub date: String,
    /// Processor and number of its threads.
    pub machine: String,
    /// Version of the program.
    pub version: String,
    pub jobs: usize,
    /// Threads of each job.
    pub threads: usize,
}

/// A run: how it was made, and a row a case.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Results {
    #[serde(default)]
    pub run: Provenance,
    pub cases: Vec<CaseRecord>,
    /// The same cases with other thresholds, where that was asked for.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensitivity: Vec<SensitivityRow>,
}

/// Reason that saved results cannot be used.
#[derive(Debug, Error)]
pub(crate) enum ResultsError {
    #[error("{file}: cannot be read")]
    Io {
        file: String,
        #[source]
        source: std::io::Error,
    },
    #[error("{file}, line {line}, column {column}: not the results of `crazyflie explain-bench`: {reason}")]
    Malformed { file: String, line: usize, column: usize, reason: String },
    #[error("{file}: holds no cases")]
    Empty { file: String },
    #[error(
        "{file}: its rows were made by `{command}`, with another version or another choice of --oracle; \
         name a new file"
    )]
    OtherRun { file: String, command: String },
}

impl Results {
    pub(crate) fn read(path: &Path) -> Result<Self, ResultsError> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|source| ResultsError::Io { file: file.clone(), source })?;
        Results::parse(file, &text)
    }

    fn parse(file: String, text: &str) -> Result<Self, ResultsError> {
        match serde_json::from_str::<Results>(text) {
            Ok(results) if results.cases.is_empty() => Err(ResultsError::Empty { file }),
            Ok(results) => Ok(results),
            Err(e) => Err(ResultsError::Malformed {
                file,
                line: e.line(),
                column: e.column(),
                reason: e.to_string(),
            }),
        }
    }

    /// Names of the folders, in the order of the cases.
    pub(crate) fn folders(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for record in &self.cases {
            if !names.contains(&record.folder.as_str()) {
                names.push(&record.folder);
            }
        }
        names
    }
}

impl Provenance {
    /// Of a run that begins now on this machine.
    pub(crate) fn now(command: String, jobs: usize, threads: usize) -> Self {
        let date = jiff::Timestamp::now().strftime("%Y-%m-%d").to_string();
        let version = env!("CARGO_PKG_VERSION").to_owned();
        Provenance { command, date, machine: describe_machine(), version, jobs, threads }
    }
}

/// The processor's name, where the system tells it, and the number of its threads.
fn describe_machine() -> String {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let listing = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = listing
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(':'))
        .map(|(_, name)| name.trim());
    format!("{}, {threads} threads", name.unwrap_or(std::env::consts::ARCH))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SAVED: &str = r#"{"run": {"command": "score x", "date": "2026-11-22", "machine": "m", "version": "0.1.0", "jobs": 2, "threads": 1},
        "cases": [{"case": "d0", "folder": "x", "verdict": "explained", "effects": [], "score": {"group": "null", "tier": "linear",
        "truth": [], "criteria": {"named": true, "15 %": null, "3 stderr": null, "held-out error": null}}, "seconds": 1.5}]}"#;

    #[test]
    fn results_are_read_back_as_they_were_written() {
        let results = Results::parse("r.json".into(), SAVED).unwrap();
        assert_eq!((results.folders(), results.run.jobs), (vec!["x"], 2));
        let again = serde_json::to_string(&results).unwrap();
        let again = Results::parse("r.json".into(), &again).unwrap();
        assert_eq!(serde_json::to_value(&again).unwrap(), serde_json::to_value(&results).unwrap());
    }

    #[test]
    fn bad_results_say_where() {
        let problem = |text: &str| Results::parse("r.json".into(), text).unwrap_err().to_string();
        assert!(
            problem("{\"cases\": [\n{}]}").contains("r.json, line 2, column 2"),
            "{}",
            problem("{\"cases\": [\n{}]}")
        );
        assert_eq!(problem("{\"cases\": []}"), "r.json: holds no cases");
    }

    proptest! {
        #[test]
        fn no_cut_and_no_text_panics(text in "\\PC{0,80}", cut in 0_usize..600) {
            let _ = Results::parse("f".into(), &text);
            let parsed = Results::parse("f".into(), &SAVED[..cut.min(SAVED.len())]);
            prop_assert_eq!(parsed.is_ok(), cut >= SAVED.len());
        }
    }
}
