//! Explanation of flights, from their files to the output: on the terminal, as JSON and as a page.

mod bars;
mod error_view;
mod figures;
mod foreign;
mod json;
mod multiples;
mod next;
mod report;
mod series;
mod signal_view;
mod view;
mod words;

use std::path::{Path, PathBuf};

use crazyflie_env::config::EffectTable;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::world::{Settings, World};
use crazyflie_identify::case::{Case, CaseError};
use crazyflie_identify::closed_loop::{Controller, Distances, Tracking, follow};
use crazyflie_identify::estimate::IdentifyError;
use crazyflie_identify::explain::recorded::{NamedLog, explain_recorded};
use crazyflie_identify::explain::verdict::Explanation;
use crazyflie_identify::explain::{declared_loss, explain};
use crazyflie_identify::fit::flight::Flight;
use crazyflie_identify::lift::read_pwm;
use crazyflie_identify::replay::ReplayError;
use crazyflie_identify::vehicle::NuisanceParameters;
use crazyflie_identify::{FlightLog, LogError};
use crazyflie_logs::{PositionSource, first_duplicate};
use thiserror::Error;

pub(crate) use error_view::{SHORT_HORIZONS, ahead, axis_units, flight_axis_errors, p_value, signed_percent};
pub(crate) use foreign::foreign_sentence;
pub(crate) use json::{as_json, verdict_name};
use next::LogContents;
pub(crate) use next::{NextStep, next_steps};
pub(crate) use report::report;
pub(crate) use signal_view::{SignalRow, signal_rows};
pub(crate) use words::{
    change_percent, closed_loop_line, confusable, sentence, significant, total_lines, totals, with_error,
};

/// Reason that flights could not be explained.
#[derive(Debug, Error)]
pub(crate) enum ExplainError {
    #[error("{file}: cannot be read")]
    Io {
        file: String,
        #[source]
        source: std::io::Error,
    },
    #[error(transparent)]
    Case(#[from] CaseError),
    #[error("{file}: neither a model file nor a case file (JSON with `declared_model`)")]
    Model {
        file: String,
        #[source]
        source: crazyflie_env::Error,
    },
    #[error(transparent)]
    Log(Box<LogError>),
    #[error("{file}: the model {model} cannot fly this log")]
    Flight {
        file: String,
        model: String,
        #[source]
        source: Box<ReplayError>,
    },
    #[error("{first} and {other} differ in their clock or in what they command; explain them one at a time")]
    Unlike { first: String, other: String },
    #[error(
        "{first} and {second} hold the same flight; name it once: errors are only honest on flights that the fit never saw"
    )]
    Same { first: String, second: String },
    #[error(transparent)]
    Trims(#[from] IdentifyError),
    #[error("the model {model} breaks down on these flights: the filter finds no likelihood")]
    Broken { model: String },
    #[error("the completed model cannot be flown")]
    Completed(#[source] crazyflie_env::Error),
}

impl From<LogError> for ExplainError {
    fn from(error: LogError) -> Self {
        ExplainError::Log(Box::new(error))
    }
}

/// The declared model, with the flights that a case file names.
pub(crate) struct DeclaredModel {
    pub model: Model,
    pub case: Option<Case>,
}

impl DeclaredModel {
    /// From a model file, a case file, or "thesis" for the built-in model.
    pub(crate) fn read(path: &Path) -> Result<Self, ExplainError> {
        if path == Path::new("thesis") && !path.exists() {
            return Ok(DeclaredModel { model: Model::thesis(), case: None });
        }
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|source| ExplainError::Io { file: file.clone(), source })?;
        if Case::is_case(&text) {
            let case = Case::read(path)?;
            return Ok(DeclaredModel { model: case.model()?, case: Some(case) });
        }
        let model = Model::parse(&text).map_err(|source| ExplainError::Model { file, source })?;
        Ok(DeclaredModel { model, case: None })
    }
}

/// The log of a flight and the file that it is from.
pub(crate) struct FlightSource {
    /// As it was given.
    pub file: String,
    /// The file's name, or its path where another flight has the same name.
    pub name: String,
    pub log: FlightLog,
}

/// Reads the logs of the fit and of the test.
fn read(paths: [&[PathBuf]; 2]) -> Result<[Vec<FlightSource>; 2], ExplainError> {
    let short = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let name = |path: &PathBuf| {
        let alone = paths.concat().iter().filter(|other| short(other) == short(path)).count() == 1;
        short(path).filter(|_| alone).unwrap_or_else(|| path.display().to_string())
    };
    let source = |path: &PathBuf| {
        Ok(FlightSource { file: path.display().to_string(), name: name(path), log: FlightLog::read(path)? })
    };
    let [fit, test] = paths.map(|part| part.iter().map(source).collect::<Result<Vec<_>, ExplainError>>());
    Ok([fit?, test?])
}

fn flights(
    sources: &[FlightSource],
    model: &Model,
    vertical: Option<VerticalInput>,
) -> Result<Vec<Flight>, ExplainError> {
    let flight = |FlightSource { file, name, log }: &FlightSource| {
        let problem = |why| ExplainError::Flight {
            file: file.clone(),
            model: model.name.clone(),
            source: Box::new(why),
        };
        Flight::from_log(name, log, model, vertical).map_err(problem)
    };
    sources.iter().map(flight).collect()
}

/// A thrust command does not say which of two forms of the model flew it: of these, the one that predicts the
/// flights better as it is.
fn likelier_vertical_form(
    model: &Model,
    fit: &[FlightSource],
) -> Result<Option<VerticalInput>, ExplainError> {
    if model.vertical.default.is_some() {
        return Ok(model.vertical.default);
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
pub(crate) struct Flights {
    pub sources: Vec<FlightSource>,
    pub flights: Vec<Flight>,
}

impl Flights {
    fn from_sources(
        sources: Vec<FlightSource>,
        model: &Model,
        vertical: Option<VerticalInput>,
    ) -> Result<Self, ExplainError> {
        Ok(Flights { flights: flights(&sources, model, vertical)?, sources })
    }

    /// Whether a vehicle flew them: of a simulated flight the position is a camera's.
    fn are_recorded(&self) -> bool {
        self.sources.iter().all(|source| source.log.provenance.position != PositionSource::Camera)
    }

    fn named_logs(&self) -> Vec<NamedLog> {
        self.with_sources().map(|(source, flight)| (flight.name.clone(), source.log.clone())).collect()
    }

    fn with_sources(&self) -> impl Iterator<Item = (&FlightSource, &Flight)> {
        self.sources.iter().zip(&self.flights)
    }
}

/// A model, the flights of the fit and of the test, and their explanation.
pub(crate) struct Run {
    pub model: Model,
    /// The file of the model, where it has one that other commands read too.
    pub model_file: Option<String>,
    pub fit: Flights,
    pub test: Flights,
    /// Of the logs of all flights.
    pub contents: LogContents,
    /// Trims of each flight, which were taken out of it; empty where trims are what one looks for.
    pub trims: Vec<NuisanceParameters>,
    pub found: Explanation,
    /// The controller that flew, along the set-points of the test flights, on the declared and on the
    /// completed model; `None` where it is not known.
    pub closed_loop: Option<(Controller, [Distances; 2])>,
}

impl Run {
    /// Reads the flights and explains them, by this vertical form of the model or the one that predicts them
    /// better.
    pub(crate) fn explain_flights(
        model: Model,
        vertical: Option<VerticalInput>,
        [fit, test]: [&[PathBuf]; 2],
        progress: &dyn Fn(&str),
    ) -> Result<Self, ExplainError> {
        progress("reading the flights");
        let [fit, test] = read([fit, test])?;
        progress("the vertical form");
        let vertical =
            vertical.map_or_else(|| likelier_vertical_form(&model, &fit), |given| Ok(Some(given)))?;
        let (fit, test) =
            (Flights::from_sources(fit, &model, vertical)?, Flights::from_sources(test, &model, vertical)?);
        check_alike(&fit, &test)?;
        let (found, trims) = if fit.are_recorded() {
            let input = fit.flights.first().map_or(VerticalInput::Thrust, |f| f.input);
            explain_recorded(&model, &fit.named_logs(), &test.named_logs(), input, progress)?
        } else {
            let found = explain(&model, &fit.flights, &test.flights, progress);
            (found.ok_or_else(|| ExplainError::Broken { model: model.name.clone() })?, Vec::new())
        };
        let contents =
            LogContents::from_logs(fit.sources.iter().chain(&test.sources).map(|source| &source.log));
        let run = Run { model, model_file: None, fit, test, contents, trims, found, closed_loop: None };
        Ok(Run { closed_loop: run.fly_closed_loop()?, ..run })
    }

    fn fly_closed_loop(&self) -> Result<Option<(Controller, [Distances; 2])>, ExplainError> {
        let (completed, _) = self.completed_model()?;
        let problem = |source: &FlightSource, model: &Model| {
            let (file, model) = (source.file.clone(), model.name.clone());
            move |why| ExplainError::Flight { file, model, source: Box::new(why) }
        };
        let recognised = self.test.with_sources().map(|(source, flight)| {
            Controller::recognise(&self.model, &source.log, flight).map_err(problem(source, &self.model))
        });
        let recognised: Vec<Option<Controller>> = recognised.collect::<Result<_, _>>()?;
        let Some(controller) = recognised
            .first()
            .copied()
            .flatten()
            .filter(|first| recognised.iter().all(|c| c == &Some(*first)))
        else {
            return Ok(None);
        };
        let tracked = |model: &Model| -> Result<Vec<Tracking>, ExplainError> {
            let tracks = self.test.with_sources().map(|(source, flight)| {
                follow(model, &source.log, flight, controller).map_err(problem(source, model))
            });
            tracks.filter_map(Result::transpose).collect()
        };
        let (before, after) = (tracked(&self.model)?, tracked(&completed)?);
        Ok((!before.is_empty()).then(|| (controller, [Distances::new(&before), Distances::new(&after)])))
    }

    /// The form of the model that the flights were taken to obey.
    pub(crate) fn vertical(&self) -> VerticalInput {
        self.fit.flights.first().map_or(VerticalInput::Thrust, |f| f.input)
    }

    /// The completed model, proven to fly: written, read and put into a world again.
    pub(crate) fn completed_model(&self) -> Result<(Model, String), ExplainError> {
        let names: Vec<&str> = self.fit.flights.iter().map(|f| f.name.as_str()).collect();
        let mut model = self.found.completed.to_model(&format!("estimated on {}", names.join(", ")));
        model.name = format!("{}-completed", self.model.name.trim_end_matches("-declared"));
        model.description = format!("{}, with what its flights showed to be missing", self.model.name);
        let text = model.to_toml().map_err(ExplainError::Completed)?;
        let model = Model::parse(&text).map_err(ExplainError::Completed)?;
        let settings = Settings { input: self.vertical(), physics_hz: None };
        World::<f64>::new(&model, &EffectTable::new(), settings, 1).map_err(ExplainError::Completed)?;
        Ok((model, text))
    }
}

/// The flights share a clock and an input, and none is in both lists, under whatever name.
fn check_alike(fit: &Flights, test: &Flights) -> Result<(), ExplainError> {
    let Some((first, like)) = fit.with_sources().next() else { return Ok(()) };
    for (source, flight) in fit.with_sources().chain(test.with_sources()) {
        if !flight.shares_clock(like) || flight.input != like.input {
            return Err(ExplainError::Unlike { first: first.file.clone(), other: source.file.clone() });
        }
    }
    let all: Vec<&FlightSource> = fit.sources.iter().chain(&test.sources).collect();
    let logs: Vec<&FlightLog> = all.iter().map(|source| &source.log).collect();
    if let Some([first, second]) = first_duplicate(&logs).map(|pair| pair.map(|i| all[i].file.clone())) {
        return Err(ExplainError::Same { first, second });
    }
    Ok(())
}
