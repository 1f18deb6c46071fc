//! Results of runs: how each was made, its rates, and its rows.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::rates::Rates;
use crate::record::CaseRecord;
use crate::sensitivity::SensitivityRow;

/// Provenance of a run.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Provenance {
    pub command: String,
    /// Day of the run.
    pub date: String,
    /// Processor and number of its threads.
    pub machine: String,
    /// Version of the library.
    pub version: String,
    pub jobs: usize,
    /// Threads of each job.
    pub threads: usize,
}

/// A run. A page is made from all of it but its rows, so these are not read back.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Results {
    /// Names of the folders.
    pub folders: Vec<String>,
    pub run: Provenance,
    pub rates: Rates,
    /// The same cases with other thresholds, if requested.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensitivity: Vec<SensitivityRow>,
    #[serde(skip_deserializing, skip_serializing_if = "Vec::is_empty")]
    pub cases: Vec<CaseRecord>,
}

impl Results {
    /// The results of a run over these cases.
    pub fn new(run: Provenance, cases: Vec<CaseRecord>, sensitivity: Vec<SensitivityRow>) -> Self {
        let mut folders: Vec<String> = cases.iter().map(|record| record.folder.clone()).collect();
        folders.dedup();
        Results { folders, run, rates: Rates::from_records(&cases), sensitivity, cases }
    }

    /// The runs of a file that [`to_json`] made.
    pub fn read(path: &Path) -> Result<Vec<Self>> {
        let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
        Results::parse(&text).with_context(|| format!("{}: not the results of this program", path.display()))
    }

    fn parse(text: &str) -> Result<Vec<Self>> {
        let runs = match serde_json::from_str(text)? {
            Value::Array(runs) => runs,
            run => vec![run],
        };
        ensure!(!runs.is_empty(), "no run");
        Ok(runs.into_iter().map(serde_json::from_value).collect::<Result<_, _>>()?)
    }
}

/// Runs for programs: one as an object, several as an array with a line for each.
pub fn to_json(runs: &[Results]) -> Result<String> {
    let lines = runs.iter().map(serde_json::to_string).collect::<Result<Vec<_>, _>>()?;
    Ok(if let [one] = &lines[..] { format!("{one}\n") } else { format!("[\n{}\n]\n", lines.join(",\n")) })
}

impl Provenance {
    /// Creates the provenance of a run that begins now on this machine.
    pub fn now(jobs: usize, threads: usize) -> Self {
        let words: Vec<String> = std::env::args().skip(1).collect();
        Provenance {
            command: format!("cargo run --release -p {} -- {}", env!("CARGO_PKG_NAME"), words.join(" ")),
            date: jiff::Timestamp::now().strftime("%Y-%m-%d").to_string(),
            machine: describe_machine(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            jobs,
            threads,
        }
    }
}

/// Returns the processor's name, if the system reports it, and the number of its threads.
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
    use proptest::prelude::*;

    use super::*;
    use crate::record::tests::record;

    fn saved() -> String {
        let cases = vec![record("single", &["wind"], true), record("null", &[], false)];
        to_json(&[Results::new(Provenance::now(2, 1), cases, Vec::new())]).unwrap()
    }

    #[test]
    fn results_are_read_back_without_their_rows() {
        let runs = Results::parse(&saved()).unwrap();
        let [run] = &runs[..] else { panic!("{runs:?}") };
        assert_eq!((&run.folders[..], run.run.jobs, run.rates.cases), (&["x".to_owned()][..], 2, 2));
        assert!(saved().contains("\"cases\":[{") && run.cases.is_empty());
        let both = to_json(&[run.clone(), run.clone()]).unwrap();
        assert_eq!(to_json(&Results::parse(&both).unwrap()).unwrap(), both);
    }

    proptest! {
        #[test]
        fn no_cut_and_no_text_panics(text in "\\PC{0,80}", cut in 0_usize..600) {
            let _ = Results::parse(&text);
            prop_assert!(Results::parse(&saved()[..cut]).is_err());
        }
    }
}
