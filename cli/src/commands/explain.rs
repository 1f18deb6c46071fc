//! `crazyflie explain`: what a model lacks, from flights.

use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

use crazyflie_env::model::VerticalInput;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};

use super::open::OpenArgs;
use super::{Failure, Outcome, explain_table, files, with_cause, write_json};
use crate::explanation::{DeclaredModel, Run, as_json, picture, report};

/// Find out which effects a model lacks: fitted to some flights, judged on others. Writes the completed model
/// and a page about it.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Vehicle by name (see `crazyflie vehicles`), its model file or data sheet, or a case file that declares a
    /// vehicle and names its flights
    model: PathBuf,
    /// Logs to fit, of any format that crazyflie inspect reads
    #[arg(long, num_args = 1.., value_name = "LOG")]
    fit: Vec<PathBuf>,
    /// Logs to judge with, which the fit does not see
    #[arg(long, num_args = 1.., value_name = "LOG")]
    test: Vec<PathBuf>,
    /// Vertical form of the model that is driven: height, pwm or thrust [default: of those that the logs
    /// command, the one that predicts the logs of --fit better]
    #[arg(long, value_parser = files::vertical, value_name = "FORM")]
    vertical: Option<VerticalInput>,
    #[command(flatten)]
    logs: OpenArgs,
    /// Folder for model.toml, report.html and report.json
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Draw the residual of a test flight before and after
    #[arg(long, value_parser = files::picture, value_name = "FILE.svg|png|pdf")]
    picture: Option<PathBuf>,
    /// Print one JSON object, also written to report.json
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let declared = DeclaredModel::read(&args.model).map_err(|e| failure_with_causes(&e))?;
    let own = |of: &dyn Fn(&crazyflie_identify::case::Case) -> PathBuf| {
        declared.case.iter().map(of).collect::<Vec<_>>()
    };
    let fit = if args.fit.is_empty() { own(&|c| c.identify_on.clone()) } else { args.fit.clone() };
    let test = if args.test.is_empty() { own(&|c| c.held_out.clone()) } else { args.test.clone() };
    if fit.is_empty() {
        return Err(Failure::Usage("name at least one flight to fit, with --fit".into()));
    }
    if test.is_empty() {
        return Err(Failure::Usage(
            "name at least one other flight with --test: errors are only honest on flights the fit never saw"
                .into(),
        ));
    }
    let bar = spinner(args.json);
    let model = declared.model.clone();
    let run =
        Run::explain_flights(declared.model, args.vertical, [&fit, &test], &args.logs.options(), &|what| {
            bar.set_message(what.to_owned())
        });
    let model_file = declared.case.is_none().then(|| args.model.display().to_string());
    let run = Run { model_file, ..run.map_err(|e| failure_with_causes(&e))? };
    for source in run.fit.sources.iter().chain(&run.test.sources) {
        args.logs.warn(&source.file, &source.log);
    }
    args.logs.warn_of_motors(&model, None, run.fit.sources.iter().map(|source| &source.log));
    bar.set_message("the report");
    let (object, written) = write_all(&run, args)?;
    files::picture_to(args.picture.as_ref(), || picture(&run))?;
    bar.finish_and_clear();
    if args.json {
        return write_json(&object, out);
    }
    explain_table::print(&run, &written, out)
}

pub(super) fn failure_with_causes(error: &dyn std::error::Error) -> Failure {
    Failure::Failed(with_cause(error))
}

/// Shows the present step, if somebody watches.
fn spinner(silent: bool) -> ProgressBar {
    if silent {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new_spinner();
    // the template is a constant that a test runs
    bar.set_style(
        ProgressStyle::with_template("{spinner} {elapsed} {wide_msg}")
            .unwrap_or_else(|_| ProgressStyle::default_spinner()),
    );
    bar.enable_steady_tick(Duration::from_millis(120));
    bar
}

/// Writes the files; returns the object for machines and their paths.
fn write_all(run: &Run, args: &Args) -> Outcome<(Value, Vec<PathBuf>)> {
    let paths = ["model.toml", "report.html", "report.json"].map(|name| args.out.join(name));
    let [model, page, object] = &paths;
    let (_, text) = run.completed_model().map_err(|e| failure_with_causes(&e))?;
    let html = report(run).map_err(|e| failure_with_causes(&e))?;
    let [m, p, o] = [model, page, object].map(|path| path.display().to_string());
    let value = args.logs.with_warnings(as_json(run, &json!({"model": m, "report": p, "json": o})));
    files::write(model, text.as_bytes())?;
    files::write(page, html.as_bytes())?;
    files::write(object, serde_json::to_string_pretty(&value)?.as_bytes())?;
    Ok((value, paths.to_vec()))
}
