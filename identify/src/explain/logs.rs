//! Explanation of flights from the files of their logs: the form of the model that flew them, and the search that
//! fits them.

use std::path::{Path, PathBuf};

use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_logs::{PositionSource, ReadOptions, first_duplicate};

use super::recorded::explain_recorded;
use super::verdict::Explanation;
use super::{declared_loss, explain};
use crate::fit::flight::Flight;
use crate::lift::read_pwm;
use crate::vehicle::NuisanceParameters;
use crate::{Error, FlightLog, NamedLog, Result};

/// The log of a flight and the file that it is from.
pub struct FlightSource {
    /// The path as the user gave it.
    pub file: String,
    /// The file's name, or its path where another flight has the same name.
    pub name: String,
    /// The log in the file.
    pub log: FlightLog,
}

impl FlightSource {
    /// The error that a model cannot fly this log.
    pub fn unflyable(&self, model: &Model, why: Error) -> Error {
        Error::about(&self.file, format!("the model {} cannot fly this log: {why}", model.name))
    }
}

/// Reads the logs of the fit and of the test.
fn read(paths: [&[PathBuf]; 2], options: &ReadOptions) -> Result<[Vec<FlightSource>; 2]> {
    let short = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let name = |path: &PathBuf| {
        let alone = paths.concat().iter().filter(|other| short(other) == short(path)).count() == 1;
        short(path).filter(|_| alone).unwrap_or_else(|| path.display().to_string())
    };
    let source = |path: &PathBuf| {
        let log = FlightLog::open(path, options).map_err(|why| Error::Log(Box::new(why)))?;
        Ok(FlightSource { file: path.display().to_string(), name: name(path), log })
    };
    let [fit, test] = paths.map(|part| part.iter().map(source).collect::<Result<Vec<_>>>());
    Ok([fit?, test?])
}

fn flights(sources: &[FlightSource], model: &Model, vertical: Option<VerticalInput>) -> Result<Vec<Flight>> {
    let flight = |source: &FlightSource| {
        Flight::from_log(&source.name, &source.log, model, vertical)
            .map_err(|why| source.unflyable(model, why))
    };
    sources.iter().map(flight).collect()
}

/// Chooses between two forms of the model that a thrust command could have flown: the one that predicts the flights
/// better as it is. A declared one goes before.
fn likelier_vertical_form(model: &Model, fit: &[FlightSource]) -> Result<Option<VerticalInput>> {
    if model.default_input().is_some() {
        return Ok(model.default_input());
    }
    let forms: Vec<VerticalInput> = model.inputs().into_iter().filter(|input| input.is_pwm()).collect();
    if forms.len() < 2 || fit.iter().any(|source| read_pwm(&source.log, model).is_err()) {
        return Ok(None);
    }
    let mut losses = Vec::new();
    for form in forms {
        losses.extend(declared_loss(model, &flights(fit, model, Some(form))?).map(|loss| (form, loss)));
    }
    Ok(losses.into_iter().min_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(form, _)| form))
}

/// Logs, and the flights of a model made from them.
pub struct Flights {
    /// Logs with their files.
    pub sources: Vec<FlightSource>,
    /// A flight for each log.
    pub flights: Vec<Flight>,
}

impl Flights {
    /// Returns whether a vehicle flew them: a simulated flight has its position from a camera.
    fn are_recorded(&self) -> bool {
        self.sources.iter().all(|source| source.log.provenance.position != PositionSource::Camera)
    }

    fn named_logs(&self) -> Vec<NamedLog> {
        self.with_sources().map(|(source, flight)| (flight.name.clone(), source.log.clone())).collect()
    }

    /// Each flight with its log.
    pub fn with_sources(&self) -> impl Iterator<Item = (&FlightSource, &Flight)> {
        self.sources.iter().zip(&self.flights)
    }
}

/// The flights of the fit and of the test, and their explanation.
pub struct ExplainedLogs {
    /// Flights of the fit.
    pub fit: Flights,
    /// Flights of the test.
    pub test: Flights,
    /// Trims of each flight, which were taken out of it; empty where trims are what one looks for.
    pub trims: Vec<NuisanceParameters>,
    /// Their explanation.
    pub found: Explanation,
}

/// Reads the logs of the fit and of the test and explains what the model lacks, by this vertical form of the model or
/// the one that predicts the flights better. `progress` gets each step.
///
/// # Errors
/// [`Error`]: logs that cannot be read or flown, do not go together or contain one flight twice.
pub fn explain_logs(
    model: &Model,
    vertical: Option<VerticalInput>,
    paths: [&[PathBuf]; 2],
    options: &ReadOptions,
    progress: &dyn Fn(&str),
) -> Result<ExplainedLogs> {
    progress("reading the flights");
    let [fit, test] = read(paths, options)?;
    progress("the vertical form");
    let vertical = vertical.map_or_else(|| likelier_vertical_form(model, &fit), |given| Ok(Some(given)))?;
    let prepared = |sources: Vec<FlightSource>| -> Result<Flights> {
        Ok(Flights { flights: flights(&sources, model, vertical)?, sources })
    };
    let (fit, test) = (prepared(fit)?, prepared(test)?);
    check_alike(&fit, &test)?;
    let (found, trims) = if fit.are_recorded() {
        let input = fit.flights.first().map_or(VerticalInput::Thrust, |f| f.input);
        explain_recorded(model, &fit.named_logs(), &test.named_logs(), input, progress)?
    } else {
        let found = explain(model, &fit.flights, &test.flights, progress);
        let broken = "breaks down on these flights: the filter finds no likelihood";
        (found.ok_or_else(|| Error::Logs(format!("the model {} {broken}", model.name)))?, Vec::new())
    };
    Ok(ExplainedLogs { fit, test, trims, found })
}

/// The flights share an input and, of a camera's logs, a clock; none is in both lists, under whatever name.
fn check_alike(fit: &Flights, test: &Flights) -> Result<()> {
    let Some((first, like)) = fit.with_sources().next() else { return Ok(()) };
    for (source, flight) in fit.with_sources().chain(test.with_sources()) {
        let on_one_clock = fit.are_recorded() || flight.shares_clock(like);
        if !on_one_clock || flight.input != like.input {
            let differ = "differ in their clock or in what they command; explain them one at a time";
            return Error::logs(format!("{} and {} {differ}", first.file, source.file));
        }
    }
    let all: Vec<&FlightSource> = fit.sources.iter().chain(&test.sources).collect();
    let logs: Vec<&FlightLog> = all.iter().map(|source| &source.log).collect();
    first_duplicate(&logs).map_or(Ok(()), |pair| {
        let [first, second] = pair.map(|i| &all[i].file);
        let why = "name it once: errors are only honest on flights that the fit never saw";
        Error::logs(format!("{first} and {second} hold the same flight; {why}"))
    })
}
