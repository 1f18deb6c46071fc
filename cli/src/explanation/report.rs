//! The page: one HTML file that needs nothing besides itself.

use crazyflie_identify::explain::errors::LEAST_STRETCHES;
use crazyflie_picture::PictureError;
use minijinja::value::Serde;
use minijinja::{Environment, UndefinedBehavior, context};
use thiserror::Error;

use super::error_view::tables;
use super::figures::{free_run, liveliest_flight, white};
use super::multiples::flight_rows;
use super::{
    Run, SHORT_HORIZONS, closed_loop_line, foreign_sentence, next_steps, sentence, shared_trim_lines,
    signal_rows, total_lines, view,
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

/// The page about a run.
pub(crate) fn report(run: &Run) -> Result<String, ReportError> {
    let explanation = &run.found;
    let errors = &explanation.errors;
    let shown = liveliest_flight(&run.test.flights);
    let white = shown.map(|flight| white(explanation, flight)).transpose()?;
    let page = context! {
        model => run.model.name.as_str(),
        vertical => run.vertical().name(),
        version => env!("CARGO_PKG_VERSION"),
        verdict => explanation.verdict.name(),
        sentence => sentence(explanation),
        foreign => run.foreign_model().map(|foreign| (foreign_sentence(run, &foreign), foreign.commands)),
        signals => Serde(signal_rows(run)),
        effects => view::effects("effects", &explanation.effects),
        partial => view::effects("partial", &explanation.partial),
        corrections => view::effects("corrections", &explanation.corrections),
        confirmed => view::effects("confirmed", &explanation.confirmed),
        needless => explanation.needless.join(", "),
        numbers => view::numbers(&explanation.numbers),
        totals => [total_lines(run), shared_trim_lines(run)].concat(),
        learned => explanation.learned,
        rounds => view::rounds(&explanation.path),
        errors => tables(errors, &SHORT_HORIZONS),
        all_errors => tables(errors, &[0, 1, 2, 3, 4]),
        least_stretches => LEAST_STRETCHES,
        closed_loop => closed_loop_line(run),
        flights => flight_rows(run)?,
        whiteness => white.as_ref().map(view::whiteness).unwrap_or_default(),
        white => white.and_then(|w| w.figure),
        free => shown.map_or(Ok(None), |flight| free_run(explanation, flight))?,
        shown => shown.map(|f| f.name.as_str()),
        disturbances => view::disturbances(explanation),
        hidden => view::hidden(explanation),
        sloped_nowhere => view::sloped_nowhere(explanation),
        logs => view::logs(run),
        next => Serde(next_steps(run)),
        seconds => number(explanation.seconds, 0),
    };
    let mut environment = Environment::new();
    // a name that the template misspells is an error, not a gap
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    environment.add_template("report.html", TEMPLATE)?;
    Ok(environment.get_template("report.html")?.render(page)?)
}
