//! Rows of a long run, appended as they finish: the same command continues a run that was interrupted.
//!
//! A line of JSON about the run, then a line for each case that it explained.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result, ensure};
use serde_json::json;

use crate::case_file::CaseFile;
use crate::record::CaseRecord;
use crate::results::Provenance;

/// Rows of this run, and of its beginning before it was cut off.
#[derive(Debug)]
pub struct RowFile {
    file: Mutex<File>,
    kept: Vec<CaseRecord>,
}

impl RowFile {
    /// Opens or begins a file for a run. Fails if its rows are of another machine, version or choice of `--oracle`,
    /// since they would not be comparable.
    pub fn open(path: &Path, run: &Provenance, oracle: bool) -> Result<Self> {
        let about = || path.display().to_string();
        let text = match std::fs::read_to_string(path) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => String::new(),
            text => text.with_context(about)?,
        };
        // text after the last line's end is a row that was cut off
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        let own = json!({"machine": run.machine, "version": run.version, "oracle": oracle}).to_string();
        let mut lines = text[..whole].lines();
        let first = lines.next();
        ensure!(
            first.is_none_or(|first| first == own),
            "{}: does not begin with {own}: no rows of this machine, version and choice of --oracle; \
             name a new file",
            path.display()
        );
        let rows = lines.map(serde_json::from_str).collect::<Result<Vec<CaseRecord>, _>>();
        let mut kept = rows.with_context(|| format!("{}: a line is no row", path.display()))?;
        // failed cases are tried again
        kept.retain(|record| record.failed.is_none());
        let mut file = OpenOptions::new().create(true).append(true).open(path).with_context(about)?;
        file.set_len(whole as u64)?;
        if first.is_none() {
            writeln!(file, "{own}")?;
        }
        Ok(RowFile { file: Mutex::new(file), kept })
    }

    /// The row of a case that was explained before.
    pub fn find(&self, case: &CaseFile) -> Option<&CaseRecord> {
        self.kept.iter().find(|record| record.folder == case.folder && record.case == case.id)
    }

    /// Keeps a row: it is in the file when this returns.
    pub fn push(&self, record: &CaseRecord) -> Result<()> {
        let row = serde_json::to_string(record)? + "\n";
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(file.write_all(row.as_bytes())?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::tests::record;

    fn run(machine: &str) -> Provenance {
        Provenance { machine: machine.into(), ..Provenance::now(1, 1) }
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
        let row = |id: &str| CaseRecord { case: id.into(), ..record("null", &[], true) };
        let first = RowFile::open(&path, &run("here"), true).unwrap();
        assert!(first.find(&case("d0")).is_none());
        first.push(&row("d0")).unwrap();
        first.push(&CaseRecord { failed: Some("no log".into()), ..row("d2") }).unwrap();
        // cut off in the middle of a line
        let mut file = OpenOptions::new().append(true).open(&path).unwrap();
        file.write_all(b"{\"case\": \"d").unwrap();
        let second = RowFile::open(&path, &run("here"), true).unwrap();
        assert_eq!(second.find(&case("d0")).unwrap().verdict, "explained");
        assert!(second.find(&case("d1")).is_none() && second.find(&case("d2")).is_none());
        second.push(&row("d1")).unwrap();
        let third = RowFile::open(&path, &run("here"), true).unwrap();
        assert!(third.find(&case("d0")).is_some() && third.find(&case("d1")).is_some());
    }

    #[test]
    fn rows_of_other_settings_and_other_files_are_refused() {
        let path = scratch_file("refused");
        RowFile::open(&path, &run("here"), true).unwrap();
        let problem = |path: &Path, machine, oracle| {
            RowFile::open(path, &run(machine), oracle).unwrap_err().to_string()
        };
        assert!(problem(&path, "here", false).contains("choice of --oracle"));
        assert!(problem(&path, "there", true).contains("this machine"));
        let other = scratch_file("not_rows");
        std::fs::write(&other, "{}\n").unwrap();
        assert!(problem(&other, "here", true).contains("not_rows: does not begin with"));
        assert_eq!(std::fs::read_to_string(&other).unwrap(), "{}\n", "a file that is not rows is left alone");
    }
}
