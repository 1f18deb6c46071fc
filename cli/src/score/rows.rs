//! A file of rows: what a long run has found is kept as it comes, so that a run that was cut off goes on.
//!
//! A line of JSON for each run that wrote to it, then a line for each case that the run explained.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use super::folder::CaseFile;
use super::record::CaseRecord;
use super::results::{Provenance, ResultsError};
use super::{Schedule, score_all};
use crate::text::with_cause;

/// A line of the file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Line {
    Run { oracle: bool, provenance: Provenance },
    // boxed: a record is much larger than a run
    Case(Box<CaseRecord>),
}

/// Rows of this run and of earlier ones.
#[derive(Debug)]
pub(crate) struct RowFile {
    name: String,
    file: Mutex<File>,
    kept: Vec<CaseRecord>,
    machines: Vec<String>,
}

impl RowFile {
    /// Opens or begins a file for a run. Fails where an earlier run had another version or another
    /// `--oracle`, since its rows would not be comparable.
    pub(crate) fn open(path: &Path, run: &Provenance, oracle: bool) -> Result<Self, ResultsError> {
        let name = path.display().to_string();
        let io = |source| ResultsError::Io { file: name.clone(), source };
        let text = match std::fs::read_to_string(path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => String::new(),
            text => text.map_err(io)?,
        };
        // what follows the last line's end was being written when the run was cut off
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        let lines = parse_lines(&name, &text[..whole])?;
        let mut rows = RowFile {
            file: Mutex::new(OpenOptions::new().create(true).append(true).open(path).map_err(io)?),
            name: name.clone(),
            kept: Vec::new(),
            machines: Vec::new(),
        };
        for line in lines {
            match line {
                Line::Case(record) => rows.kept.push(*record),
                Line::Run { oracle: earlier, provenance } => {
                    if earlier != oracle || provenance.version != run.version {
                        return Err(ResultsError::OtherRun { file: name, command: provenance.command });
                    }
                    rows.add_machine(&provenance.machine);
                }
            }
        }
        rows.add_machine(&run.machine);
        let file = rows.file.get_mut().unwrap_or_else(PoisonError::into_inner);
        file.set_len(whole as u64).map_err(io)?;
        rows.write(&Line::Run { oracle, provenance: run.clone() })?;
        Ok(rows)
    }

    fn add_machine(&mut self, machine: &str) {
        if !self.machines.iter().any(|known| known == machine) {
            self.machines.push(machine.to_owned());
        }
    }

    /// The machines of all runs, in the order of their first rows.
    pub(crate) fn machines(&self) -> String {
        self.machines.join(" and ")
    }

    /// The row of a case that an earlier run explained.
    fn find(&self, case: &CaseFile) -> Option<&CaseRecord> {
        // what could not be explained is tried again
        let is_row = |record: &&CaseRecord| {
            record.folder == case.folder && record.case == case.id && record.failed.is_none()
        };
        self.kept.iter().find(is_row)
    }

    /// Rows of all cases, in their order: those that are kept, and the others by explaining them.
    /// `done` is told of each.
    pub(crate) fn complete(
        &self,
        cases: &[CaseFile],
        schedule: Schedule,
        progress: &(dyn Fn(&CaseFile, &str) + Sync),
        done: &(dyn Fn(&CaseRecord) -> Result<(), String> + Sync),
    ) -> Result<Vec<CaseRecord>, String> {
        let kept: Vec<Option<&CaseRecord>> = cases.iter().map(|case| self.find(case)).collect();
        kept.iter().flatten().try_for_each(|record| done(record))?;
        let left = cases.iter().zip(&kept).filter(|(_, row)| row.is_none()).map(|(case, _)| case.clone());
        let left: Vec<CaseFile> = left.collect();
        let keep = |record: &CaseRecord| {
            self.push(record).map_err(|e| with_cause(&e))?;
            done(record)
        };
        let mut fresh = score_all(&left, schedule, progress, &keep)?.into_iter();
        Ok(kept.into_iter().filter_map(|row| row.cloned().or_else(|| fresh.next())).collect())
    }

    /// Keeps a row: it is in the file when this returns.
    fn push(&self, record: &CaseRecord) -> Result<(), ResultsError> {
        self.write(&Line::Case(Box::new(record.clone())))
    }

    fn write(&self, line: &Line) -> Result<(), ResultsError> {
        let io = |source| ResultsError::Io { file: self.name.clone(), source };
        let mut text = serde_json::to_string(line).map_err(|e| io(e.into()))?;
        text.push('\n');
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.write_all(text.as_bytes()).map_err(io)
    }
}

fn parse_lines(file: &str, text: &str) -> Result<Vec<Line>, ResultsError> {
    let parse = |(at, line): (usize, &str)| {
        serde_json::from_str(line).map_err(|e| ResultsError::Malformed {
            file: file.to_owned(),
            line: at + 1,
            column: e.column(),
            reason: e.to_string(),
        })
    };
    text.lines().enumerate().map(parse).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const RECORD: &str = r#"{"case": "d0", "folder": "x", "verdict": "explained", "effects": [], "score": {"group": "null",
        "tier": "linear", "truth": [], "criteria": {"named": true, "15 %": null, "3 stderr": null, "held-out error": null}}}"#;

    fn run(machine: &str) -> Provenance {
        Provenance {
            machine: machine.into(),
            version: "1".into(),
            command: "bench".into(),
            ..Default::default()
        }
    }

    /// A path at which no file is.
    fn scratch_file(name: &str) -> std::path::PathBuf {
        let folder = std::env::temp_dir().join(format!("crazyflie-rows-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join(name);
        let _ = std::fs::remove_file(&path);
        path
    }

    fn case(id: &str) -> CaseFile {
        CaseFile { path: "x".into(), id: id.into(), folder: "x".into() }
    }

    #[test]
    fn a_run_that_was_cut_off_goes_on() {
        let path = scratch_file("cut_off");
        let record: CaseRecord = serde_json::from_str(RECORD).unwrap();
        let first = RowFile::open(&path, &run("here"), true).unwrap();
        assert!(first.find(&case("d0")).is_none());
        first.push(&record).unwrap();
        // cut off in the middle of a line
        let mut file = OpenOptions::new().append(true).open(&path).unwrap();
        file.write_all(b"{\"case\": {\"ca").unwrap();
        let second = RowFile::open(&path, &run("there"), true).unwrap();
        assert_eq!(second.find(&case("d0")).unwrap().verdict, "explained");
        assert!(second.find(&case("d1")).is_none());
        assert_eq!(second.machines(), "here and there");
        second.push(&CaseRecord { case: "d1".into(), ..record }).unwrap();
        let third = RowFile::open(&path, &run("here"), true).unwrap();
        assert!(third.find(&case("d0")).is_some() && third.find(&case("d1")).is_some());
        assert_eq!(third.machines(), "here and there");
    }

    #[test]
    fn rows_of_other_settings_and_other_files_are_refused() {
        let path = scratch_file("refused");
        RowFile::open(&path, &run("here"), true).unwrap();
        let problem =
            |path: &Path, oracle| RowFile::open(path, &run("here"), oracle).unwrap_err().to_string();
        assert!(problem(&path, false).contains("`bench`"), "{}", problem(&path, false));
        let other = scratch_file("not_rows");
        std::fs::write(&other, "{}\n").unwrap();
        assert!(
            problem(&other, true).contains("not_rows, line 1, column 2: not the results of"),
            "{}",
            problem(&other, true)
        );
        assert_eq!(std::fs::read_to_string(&other).unwrap(), "{}\n", "a file that is not rows is left alone");
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "\\PC{0,80}") {
            let _ = parse_lines("f", &text);
        }
    }
}
