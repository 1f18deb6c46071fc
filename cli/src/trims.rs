//! Hover trims of all logs in files and folders.

use std::path::{Path, PathBuf};

use crazyflie_identify::FlightLog;
use crazyflie_identify::diagnose::trim::FlightTrim;

use crate::commands::open::OpenArgs;
use crate::failure::{Failure, Outcome};

/// All logs and their trims. A log that is named must have one; a file found in a folder may be something else.
pub(crate) fn read_trims(
    paths: &[PathBuf],
    logs: &OpenArgs,
    left_out: &mut Vec<String>,
) -> Outcome<(Vec<FlightLog>, Vec<FlightTrim>)> {
    let mut trims = Vec::new();
    for path in paths {
        for file in if path.is_dir() { files_below(path)? } else { vec![path.clone()] } {
            match read_trim(&file, logs) {
                Ok(trim) => trims.push(trim),
                Err(why) if file.exists() => left_out.push(why),
                Err(why) => return Err(Failure::Failed(why)),
            }
        }
    }
    Ok(trims.into_iter().unzip())
}

fn read_trim(path: &Path, logs: &OpenArgs) -> Result<(FlightLog, FlightTrim), String> {
    let log = logs.open(path).map_err(|failure| failure.to_string())?;
    let folder = path.parent().map_or(String::new(), |p| p.display().to_string());
    let file = path.file_name().map_or(String::new(), |n| n.to_string_lossy().into_owned());
    let trim = FlightTrim::from_log(&folder, &file, &log).map_err(|e| e.to_string())?;
    Ok((log, trim))
}

/// All files below a folder, in order of their names.
fn files_below(folder: &Path) -> Outcome<Vec<PathBuf>> {
    let failed = |e| Failure::about(folder.display(), e);
    let entries: Result<Vec<_>, _> = std::fs::read_dir(folder).map_err(failed)?.collect();
    let mut paths: Vec<PathBuf> = entries.map_err(failed)?.into_iter().map(|e| e.path()).collect();
    paths.sort();
    let mut files = Vec::new();
    for path in paths {
        if path.is_dir() { files.extend(files_below(&path)?) } else { files.push(path) }
    }
    Ok(files)
}
