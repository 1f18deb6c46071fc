//! Folders of cases: which files are cases, and whether each is whole before an hour is spent on the others.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crazyflie_identify::case::{Case, CaseError};
use flate2::read::MultiGzDecoder;
use thiserror::Error;

use super::truth::{Truth, TruthError};

/// A case file with its name and the name of its folder.
#[derive(Debug, Clone)]
pub(crate) struct CaseFile {
    pub path: PathBuf,
    pub id: String,
    pub folder: String,
}

/// Reason that a case cannot be scored.
#[derive(Debug, Error)]
pub(crate) enum CaseFileError {
    #[error(transparent)]
    Case(#[from] CaseError),
    #[error(transparent)]
    Truth(#[from] TruthError),
    #[error("{file}: the flight of {case} cannot be read")]
    Flight {
        file: String,
        case: String,
        #[source]
        source: io::Error,
    },
    #[error("{file}: the flight of {case} is cut short: its gzip stream has no end")]
    Truncated { file: String, case: String },
}

impl CaseFile {
    fn new(path: PathBuf, folder: &str) -> Self {
        let id = path.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        CaseFile { path, id, folder: folder.to_owned() }
    }

    /// The truth of a case whose other files are there and whole.
    pub(crate) fn check(&self) -> Result<Truth, CaseFileError> {
        let case = Case::read(&self.path)?;
        let truth = Truth::beside(&self.path)?;
        for flight in [&case.identify_on, &case.held_out] {
            self.check_flight(flight)?;
        }
        Ok(truth)
    }

    fn check_flight(&self, path: &Path) -> Result<(), CaseFileError> {
        let name = || (path.display().to_string(), self.id.clone());
        let is_packed = path.extension().is_some_and(|extension| extension == "gz");
        let length = File::open(path).and_then(|file| {
            if is_packed { count_bytes(MultiGzDecoder::new(file)) } else { count_bytes(file) }
        });
        match length {
            Err(source) if source.kind() != io::ErrorKind::UnexpectedEof => {
                let (file, case) = name();
                Err(CaseFileError::Flight { file, case, source })
            }
            Ok(1..) => Ok(()),
            // a stream without an end, or a file without a byte
            _ => {
                let (file, case) = name();
                Err(CaseFileError::Truncated { file, case })
            }
        }
    }
}

fn count_bytes(mut source: impl Read) -> io::Result<u64> {
    io::copy(&mut source, &mut io::sink())
}

/// The cases of a folder, in the order of their names.
pub(crate) fn find_cases(folder: &Path) -> io::Result<Vec<CaseFile>> {
    let name = folder
        .canonicalize()?
        .file_name()
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let mut cases = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if is_case(&path) {
            cases.push(CaseFile::new(path, &name));
        }
    }
    cases.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(cases)
}

/// Whether a file is called like a case: `dNN.json`.
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
