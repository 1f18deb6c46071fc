//! Folders of cases: which files are cases, and whether each is whole before an hour is spent on the others.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use crazyflie_identify::case::Case;
use flate2::read::MultiGzDecoder;

use crate::truth::Truth;

/// A case file with its name and the name of its folder.
#[derive(Debug, Clone)]
pub struct CaseFile {
    pub path: PathBuf,
    pub id: String,
    pub folder: String,
}

impl CaseFile {
    fn new(path: PathBuf, folder: &str) -> Self {
        let id = path.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        CaseFile { path, id, folder: folder.to_owned() }
    }

    /// The truth of a case whose other files are there and whole.
    pub fn check(&self) -> Result<Truth> {
        let case = Case::read(&self.path)?;
        let truth = Truth::beside(&self.path)?;
        for flight in [&case.identify_on, &case.held_out] {
            let bytes = count_bytes(flight)
                .with_context(|| format!("{}: the flight of {} cannot be read", flight.display(), self.id))?;
            ensure!(bytes > 0, "{}: the flight of {} is empty", flight.display(), self.id);
        }
        Ok(truth)
    }
}

/// Length of a log, unpacked; a stream without an end is an error.
fn count_bytes(log: &Path) -> io::Result<u64> {
    let file = File::open(log)?;
    let mut source: Box<dyn Read> = if log.extension().is_some_and(|extension| extension == "gz") {
        Box::new(MultiGzDecoder::new(file))
    } else {
        Box::new(file)
    };
    io::copy(&mut source, &mut io::sink())
}

/// The cases of a folder, in the order of their names.
pub fn find_cases(folder: &Path) -> Result<Vec<CaseFile>> {
    let about = || folder.display().to_string();
    let whole = folder.canonicalize().with_context(about)?;
    let name = whole.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let mut cases = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(about)? {
        let path = entry?.path();
        if is_case(&path) {
            cases.push(CaseFile::new(path, &name));
        }
    }
    ensure!(!cases.is_empty(), "{}: holds no case files (d00.json, d01.json, ...)", folder.display());
    cases.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(cases)
}

/// Returns whether a file is named like a case: `dNN.json`.
fn is_case(path: &Path) -> bool {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let number = name.strip_prefix('d').and_then(|rest| rest.strip_suffix(".json"));
    number.is_some_and(|n| !n.is_empty() && n.chars().all(|c| c.is_ascii_digit()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_no_cases() {
        let is_case = |name: &str| is_case(Path::new(name));
        assert!(
            is_case("x/d05.json")
                && !is_case("x/d05.answer.json")
                && !is_case("d.json")
                && !is_case("d05_a.csv.gz")
        );
        assert_eq!(CaseFile::new("x/d05.json".into(), "x").id, "d05");
    }
}
