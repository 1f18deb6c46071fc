//! The page: one HTML file that needs nothing besides itself.

use crazyflie_identify::explain::errors::LEAST_STRETCHES;
use crazyflie_picture::PictureError;
use minijinja::Environment;
use minijinja::value::Serde;
use serde::Serialize;
use thiserror::Error;

use super::error_view::{ErrorTable, tables};
use super::figures::{free_run, liveliest_flight, white};
use super::multiples::{FlightRow, flight_rows};
use super::{
    NextStep, Run, SHORT_HORIZONS, SignalRow, closed_loop_line, foreign_sentence, next_steps, sentence,
    shared_trim_lines, signal_rows, total_lines, view,
};
use crate::text::number;

const TEMPLATE: &str = include_str!("../../templates/report.html");

/// Reason that no page could be made.
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
    /// That the model is another vehicle's, and what to run instead.
    foreign: Option<(String, [String; 2])>,
    signals: Vec<SignalRow>,
    effects: Vec<view::Effect>,
    corrections: Vec<view::Effect>,
    confirmed: Vec<view::Effect>,
    needless: String,
    numbers: Vec<view::ModelNumber>,
    /// Effects that lower the errors and account for nothing.
    partial: Vec<view::Effect>,
    totals: Vec<String>,
    learned: bool,
    rounds: Vec<view::Round>,
    errors: Vec<ErrorTable>,
    /// The same at all horizons.
    all_errors: Vec<ErrorTable>,
    least_stretches: usize,
    closed_loop: Option<String>,
    flights: Vec<FlightRow>,
    /// Pictures as SVG, panel by panel.
    white: Option<Vec<String>>,
    free: Option<Vec<String>>,
    whiteness: Vec<view::WhiteRow>,
    /// The test flight in the larger pictures.
    shown: Option<&'a str>,
    disturbances: Vec<view::DisturbanceRow>,
    hidden: Vec<view::UndetectableEffect>,
    sloped_nowhere: String,
    logs: Vec<view::Recording>,
    next: Vec<NextStep>,
    seconds: String,
}

/// The page about a run.
pub(crate) fn report(run: &Run) -> Result<String, ReportError> {
    let found = &run.found;
    let errors = &found.errors;
    let shown = liveliest_flight(&run.test.flights);
    let white = shown.map(|flight| white(found, flight)).transpose()?;
    let page = Page {
        model: &run.model.name,
        vertical: run.vertical().name(),
        version: env!("CARGO_PKG_VERSION"),
        verdict: found.verdict.name(),
        sentence: sentence(found),
        foreign: run.foreign_model().map(|foreign| (foreign_sentence(run, &foreign), foreign.commands)),
        signals: signal_rows(run),
        effects: view::effects("effects", &found.effects),
        partial: view::effects("partial", &found.partial),
        corrections: view::effects("corrections", &found.corrections),
        confirmed: view::effects("confirmed", &found.confirmed),
        needless: found.needless.join(", "),
        numbers: view::numbers(&found.numbers),
        totals: [total_lines(run), shared_trim_lines(run)].concat(),
        learned: found.learned,
        rounds: view::rounds(&found.path),
        errors: tables(errors, &SHORT_HORIZONS),
        all_errors: tables(errors, &[0, 1, 2, 3, 4]),
        least_stretches: LEAST_STRETCHES,
        closed_loop: closed_loop_line(run),
        flights: flight_rows(run)?,
        whiteness: white.as_ref().map(view::whiteness).unwrap_or_default(),
        white: white.and_then(|w| w.figure),
        free: shown.map_or(Ok(None), |flight| free_run(found, flight))?,
        shown: shown.map(|f| f.name.as_str()),
        disturbances: view::disturbances(found),
        hidden: view::hidden(found),
        sloped_nowhere: view::sloped_nowhere(found),
        logs: view::logs(run),
        next: next_steps(run),
        seconds: number(found.seconds, 0),
    };
    let mut environment = Environment::new();
    environment.add_template("report.html", TEMPLATE)?;
    Ok(environment.get_template("report.html")?.render(Serde(page))?)
}
