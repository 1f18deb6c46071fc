//! Reading and writing the files that are named on the command line.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_identify::FlightLog;

use super::{Failure, Outcome};

/// The model of a file, or the thesis's.
pub(crate) fn model(path: Option<&Path>) -> Outcome<Model> {
    let Some(path) = path else { return Ok(Model::thesis()) };
    let text = fs::read_to_string(path).map_err(|e| Failure::about(path.display(), e))?;
    Model::parse(&text).map_err(|e| Failure::about(path.display(), e))
}

/// Writes a file, and the folder it is in if there is none yet.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Outcome {
    let failed = |e| Failure::about(path.display(), e);
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        fs::create_dir_all(folder).map_err(failed)?;
    }
    fs::write(path, bytes).map_err(failed)
}

/// Target of pictures, for clap: a file that ends in .svg, or a folder.
pub(crate) fn picture(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let is_folder = text.ends_with(std::path::is_separator) || path.is_dir();
    if is_folder || path.extension().is_none() || is_svg(&path) {
        return Ok(path);
    }
    Err("pictures are drawn as SVG; name a file that ends in .svg".into())
}

/// Whether a path names one picture.
pub(crate) fn is_svg(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("svg"))
}

/// Writes a flight as CSV, or as MCAP if the file's name ends in that.
pub(crate) fn write_log(path: &Path, log: &FlightLog) -> Outcome {
    let mut bytes = Cursor::new(Vec::new());
    let is_mcap = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("mcap"));
    let written = if is_mcap { log.write_mcap(&mut bytes) } else { log.write_csv(&mut bytes) };
    written.map_err(|e| Failure::about(path.display(), e))?;
    write(path, bytes.get_ref())
}

/// The vertical input of that name.
pub(crate) fn vertical(name: &str) -> Result<VerticalInput, String> {
    VerticalInput::named(name).map_err(|error| error.to_string())
}

/// The form that the model names. Without a name: the controllers command a PWM, so that form, if the model
/// has one.
pub(crate) fn default_vertical(model: &Model) -> VerticalInput {
    if let Some(default) = model.vertical.default {
        return default;
    }
    let inputs = model.inputs();
    let wanted = [VerticalInput::Pwm, VerticalInput::Thrust].into_iter().find(|v| inputs.contains(v));
    wanted.unwrap_or(VerticalInput::Height)
}

/// A finite number of seconds between bounds, for clap.
pub(crate) fn seconds(text: &str, low: f64, high: f64) -> Result<f64, String> {
    let value: f64 =
        text.parse().map_err(|_| format!("expected a number of seconds from {low} to {high}"))?;
    // NaN is in no range
    if (low..=high).contains(&value) { Ok(value) } else { Err(format!("expected {low} to {high} seconds")) }
}
