//! Reading and writing the files that are named on the command line.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use crazyflie_env::model::{self, Model, Vehicle, VerticalInput};
use crazyflie_identify::FlightLog;
use crazyflie_picture::{Drawing, FilmFormat, Format, PictureError};
use indicatif::ProgressBar;

use super::{Failure, Outcome, listed};

/// The model that a command takes.
#[derive(Debug, clap::Args, serde::Serialize)]
pub(crate) struct ModelArg {
    /// Vehicle by name (see `crazyflie vehicles`), or its model file or data sheet [default: cf2-thesis]
    #[arg(long, visible_alias = "vehicle", value_name = "NAME|FILE")]
    model: Option<PathBuf>,
}

impl ModelArg {
    pub(crate) fn read(&self) -> Outcome<Model> {
        model(self.model.as_deref())
    }

    pub(crate) fn is_given(&self) -> bool {
        self.model.is_some()
    }
}

/// The model of a vehicle's name or of a file; the thesis's unless given.
pub(crate) fn model(path: Option<&Path>) -> Outcome<Model> {
    let Some(path) = path else { return Ok(Model::thesis()) };
    match Vehicle::name_in(path) {
        Some(name) => {
            Model::parse(name).map_err(|e| Failure::about(path.display(), format!("no such file; {e}")))
        }
        None => {
            let text = fs::read_to_string(path)
                .map_err(|e| Failure::about(path.display(), format!("{e}; {}", model::EXPECTED)))?;
            Model::parse(&text).map_err(|e| Failure::about(path.display(), e))
        }
    }
}

/// A file as `parse` reads its text.
pub(crate) fn read<T>(path: &Path, parse: fn(&str) -> crazyflie_env::Result<T>) -> Outcome<T> {
    let text = fs::read_to_string(path).map_err(|e| Failure::about(path.display(), e))?;
    parse(&text).map_err(|e| Failure::about(path.display(), e))
}

/// Writes a file, and the folder it is in if there is none yet.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Outcome {
    let failed = |e| Failure::about(path.display(), e);
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        fs::create_dir_all(folder).map_err(failed)?;
    }
    fs::write(path, bytes).map_err(failed)
}

/// File of a picture, for clap: its ending names a format.
pub(crate) fn picture(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    Format::from_path(&path).map(|_| path).map_err(|e| e.to_string())
}

/// File of a film, for clap: its ending names a format.
pub(crate) fn film(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    FilmFormat::from_path(&path).map(|_| path).map_err(|e| e.to_string())
}

/// Target of several pictures, for clap: a file whose ending names a format, or a folder.
pub(crate) fn picture_or_folder(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let is_folder = text.ends_with(std::path::is_separator) || path.is_dir() || path.extension().is_none();
    if is_folder { Ok(path) } else { picture(text) }
}

/// Returns whether a path names one picture.
fn is_picture(path: &Path) -> bool {
    Format::from_path(path).is_ok()
}

/// Refuses a single file for the pictures of several logs.
pub(crate) fn check_target(target: Option<&Path>, logs: usize) -> Outcome {
    Failure::unless(logs < 2 || !target.is_some_and(is_picture), || {
        format!("--picture names one file, but there are {logs} logs: name a folder")
    })
}

/// Writes a log's picture to the file that a target names, or under the log's name to the folder.
pub(crate) fn write_log_picture(
    target: Option<&Path>,
    log: &str,
    draw: impl FnOnce() -> Result<Drawing, PictureError>,
) -> Outcome {
    let in_folder = |target: &Path| target.join(format!("{}.svg", stem(log)));
    let file = target.map(|path| if is_picture(path) { path.to_owned() } else { in_folder(path) });
    picture_to(file.as_ref(), draw)
}

/// Returns the results of `read` for each file, and the errors of the others. The error of a single file is the
/// command's failure.
pub(crate) fn each<T>(
    paths: &[PathBuf],
    read: impl Fn(&Path) -> Outcome<T>,
) -> Outcome<(Vec<T>, Vec<String>)> {
    let bar = if paths.len() > 3 { ProgressBar::new(paths.len() as u64) } else { ProgressBar::hidden() };
    let (mut done, mut failed) = (Vec::new(), Vec::new());
    for path in paths {
        match read(path) {
            Ok(one) => done.push(one),
            Err(failure) if paths.len() == 1 => return Err(failure),
            Err(failure) => failed.push(failure.to_string()),
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok((done, failed))
}

/// A failure if some of so many logs failed.
pub(crate) fn refuse_failed(failed: &[String], of: usize, what: &str) -> Outcome {
    if failed.is_empty() {
        return Ok(());
    }
    Err(Failure::Failed(format!("{} of {of} logs {what}:{}", failed.len(), listed(failed))))
}

/// The name of a file without folder and endings.
pub(crate) fn stem(file: &str) -> String {
    let name = Path::new(file).file_name().map_or(file.into(), |n| n.to_string_lossy());
    name.split('.').next().unwrap_or(file).to_owned()
}

/// Writes a chart in the format of the file's ending.
pub(crate) fn write_picture(path: &Path, drawing: &Drawing) -> Outcome {
    write(path, &Format::from_path(path)?.encode(drawing)?)
}

/// Draws and writes a chart, if a file is named for it.
pub(crate) fn picture_to(
    path: Option<&PathBuf>,
    draw: impl FnOnce() -> Result<Drawing, PictureError>,
) -> Outcome {
    path.map_or(Ok(()), |path| write_picture(path, &draw()?))
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
    first_vertical(model, &[VerticalInput::Pwm, VerticalInput::Thrust])
}

/// The form that the model names. Without a name: the first of these that it has.
pub(crate) fn first_vertical(model: &Model, wanted: &[VerticalInput]) -> VerticalInput {
    let input = wanted.iter().copied().find(|input| model.inputs().contains(input));
    model.vertical.default.or(input).unwrap_or(VerticalInput::Height)
}

/// A number between bounds, for clap.
pub(crate) fn number(text: &str, low: f64, high: f64) -> Result<f64, String> {
    // NaN is in no range
    let value = text.parse::<f64>().ok().filter(|value| (low..=high).contains(value));
    value.ok_or_else(|| format!("expected {low} to {high}"))
}

/// So many seconds between bounds, for clap.
pub(crate) fn seconds(text: &str, low: f64, high: f64) -> Result<f64, String> {
    number(text, low, high).map_err(|expected| format!("{expected} seconds"))
}
