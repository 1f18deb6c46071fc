//! The page: one HTML file that needs nothing besides itself.

use crazyflie_identify::explain::verdict::Leftover;
use crazyflie_picture::PictureError;
use minijinja::Environment;
use minijinja::value::Serde;
use serde::Serialize;
use thiserror::Error;

use super::figures::{Figure, free_run, residual, white};
use super::{Run, closed_loop_line, findings, foreign_line, sentence, verdict_name, view};
use crate::cli::{number, vertical_name};

const TEMPLATE: &str = include_str!("../../templates/report.html");

/// Why no page could be made.
#[derive(Debug, Error)]
pub(crate) enum ReportError {
    #[error("a picture of the report cannot be drawn")]
    Picture(#[from] PictureError),
    #[error("the report cannot be filled in")]
    Template(#[from] minijinja::Error),
}

/// All that the template places.
#[derive(Serialize)]
struct Page<'a> {
    model: &'a str,
    vertical: &'static str,
    version: &'static str,
    verdict: &'static str,
    sentence: String,
    effects: Vec<view::Effect>,
    left: Vec<&'a Leftover>,
    rounds: Vec<view::Round>,
    errors: Vec<view::ErrorTable>,
    closed_loop: Option<String>,
    residual: Option<Figure>,
    white: Option<Figure>,
    free: Option<Figure>,
    whiteness: Vec<view::WhiteRow>,
    /// The test flight in the pictures.
    shown: Option<&'a str>,
    disturbances: Vec<view::Random>,
    hidden: Vec<view::Hidden>,
    sloped_nowhere: String,
    logs: Vec<view::Recording>,
    seconds: String,
}

/// The page about a run.
pub(crate) fn report(run: &Run) -> Result<String, ReportError> {
    let found = &run.found;
    let shown = run.test.flights.first();
    let white = shown.map(|flight| white(found, flight)).transpose()?;
    let page = Page {
        model: &run.model.name,
        vertical: vertical_name(run.vertical()),
        version: env!("CARGO_PKG_VERSION"),
        verdict: verdict_name(found.verdict),
        sentence: foreign_line(run).into_iter().chain([sentence(found)]).collect::<Vec<_>>().join(" "),
        effects: view::effects(found),
        left: findings(found),
        rounds: view::rounds(&found.path),
        errors: view::errors(&found.errors),
        closed_loop: closed_loop_line(run),
        residual: shown.map_or(Ok(None), |flight| residual(found, flight))?,
        whiteness: white.as_ref().map(view::whiteness).unwrap_or_default(),
        white: white.and_then(|w| w.figure),
        free: shown.map_or(Ok(None), |flight| free_run(found, flight))?,
        shown: shown.map(|f| f.name.as_str()),
        disturbances: view::disturbances(found),
        hidden: view::hidden(found),
        sloped_nowhere: view::sloped_nowhere(found),
        logs: view::logs(run),
        seconds: number(found.seconds, 0),
    };
    let mut environment = Environment::new();
    environment.add_template("report.html", TEMPLATE)?;
    Ok(environment.get_template("report.html")?.render(Serde(page))?)
}
