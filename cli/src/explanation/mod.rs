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
use crazyflie_env::model::{Model, Vehicle, VerticalInput};
use crazyflie_env::world::{Settings, World};
use crazyflie_identify::case::Case;
use crazyflie_identify::closed_loop::{Controller, Distances, Tracking};
use crazyflie_identify::explain::logs::{ExplainedLogs, FlightSource, Flights, explain_logs};
use crazyflie_identify::explain::verdict::Explanation;
use crazyflie_identify::vehicle::NuisanceParameters;
use crazyflie_logs::ReadOptions;
use thiserror::Error;

pub(crate) use error_view::{SHORT_HORIZONS, ahead, axis_units, flight_axis_errors, p_value, signed_percent};
pub(crate) use foreign::foreign_sentence;
pub(crate) use json::as_json;
pub(crate) use multiples::picture;
use next::channels;
pub(crate) use next::{NextStep, next_steps};
pub(crate) use report::report;
pub(crate) use signal_view::signal_rows;
pub(crate) use words::{
    change_percent, closed_loop_line, confusable, sentence, shared_trim_lines, significant, total_lines,
    totals, with_error,
};

/// Reason that flights could not be explained.
#[derive(Debug, Error)]
pub(crate) enum ExplainError {
    #[error("{file}: cannot be read, expected a vehicle's name, a model file or a case file")]
    Io { file: String, source: std::io::Error },
    #[error("{file}: neither a model file nor a case file (JSON with `declared_model`)")]
    Model { file: String, source: crazyflie_env::Error },
    #[error(transparent)]
    Logs(#[from] crazyflie_identify::Error),
    #[error("the completed model cannot be flown")]
    Completed(#[source] crazyflie_env::Error),
}

/// The declared model, with the flights that a case file names.
pub(crate) struct DeclaredModel {
    pub model: Model,
    pub case: Option<Case>,
}

impl DeclaredModel {
    /// From the name of a vehicle, a model file or a case file.
    pub(crate) fn read(path: &Path) -> Result<Self, ExplainError> {
        let file = path.display().to_string();
        if let Some(name) = Vehicle::name_in(path) {
            let model = Model::parse(name).map_err(|source| ExplainError::Model { file, source })?;
            return Ok(DeclaredModel { model, case: None });
        }
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

/// A model, the flights of the fit and of the test, and their explanation.
pub(crate) struct Run {
    pub model: Model,
    /// The file of the model, where it has one that other commands read too.
    pub model_file: Option<String>,
    pub fit: Flights,
    pub test: Flights,
    /// Channels of the logs of all flights.
    pub channels: Vec<&'static str>,
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
        paths: [&[PathBuf]; 2],
        options: &ReadOptions,
        progress: &dyn Fn(&str),
    ) -> Result<Self, ExplainError> {
        let ExplainedLogs { fit, test, trims, found } =
            explain_logs(&model, vertical, paths, options, progress)?;
        let channels = channels(fit.sources.iter().chain(&test.sources).map(|source| &source.log));
        let run = Run { model, model_file: None, fit, test, channels, trims, found, closed_loop: None };
        Ok(Run { closed_loop: run.fly_closed_loop()?, ..run })
    }

    fn fly_closed_loop(&self) -> Result<Option<(Controller, [Distances; 2])>, ExplainError> {
        let (completed, _) = self.completed_model()?;
        let recognised = self.test.with_sources().map(|(source, flight)| {
            Controller::recognise(&self.model, &source.log, flight)
                .map_err(|why| source.unflyable(&self.model, why))
        });
        let recognised = recognised.collect::<Result<Vec<Option<Controller>>, _>>()?;
        let first = recognised.first().copied().flatten();
        let Some(controller) = first.filter(|first| recognised.iter().all(|c| c == &Some(*first))) else {
            return Ok(None);
        };
        let tracked = |model: &Model| -> crazyflie_identify::Result<Vec<Tracking>> {
            let tracks = self.test.with_sources().map(|(source, flight)| {
                controller.follow(model, &source.log, flight).map_err(|why| source.unflyable(model, why))
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
