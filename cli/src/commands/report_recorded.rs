//! `crazyflie report recorded`: what recorded flights say of the model, as a page.

use std::io::Write;
use std::path::PathBuf;

use indicatif::{ProgressBar, ProgressStyle};

use super::{Failure, Outcome, files};
use crate::measured::{STAGES, as_json, page, pictures, study_recordings};

const EXAMPLES: &str = "\
Examples:
  crazyflie report recorded ../shared/data
  crazyflie report recorded ../shared/data --quick --json
  crazyflie report recorded ../shared/data --out pages/measured";

/// Fit the model to recorded flights, predict others from their commands alone, and write a page about both.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Folder that holds the recordings, one folder for each data set: nanobench, crazypad
    #[arg(value_name = "DATA")]
    data: PathBuf,
    /// The page's name without its ending; its pictures go into a folder of that name
    #[arg(long, default_value = "docs/measured", value_name = "PAGE")]
    out: PathBuf,
    /// The figures for machines, and no page
    #[arg(long)]
    json: bool,
    /// Two flights to fit, one to predict, and no more than that
    #[arg(long)]
    quick: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let bar = ProgressBar::new(STAGES);
    if let Ok(style) = ProgressStyle::with_template("{wide_bar} {msg} {elapsed}") {
        bar.set_style(style);
    }
    let progress = |what: &str| {
        bar.set_message(what.to_owned());
        bar.inc(1);
    };
    let report = study_recordings(&args.data, args.quick, &progress).map_err(Failure::Failed)?;
    bar.finish_and_clear();
    if args.json {
        serde_json::to_writer_pretty(&mut *out, &as_json(&report))?;
        return Ok(writeln!(out)?);
    }
    let folder = args.out.file_name().map_or_else(|| "measured".into(), |n| n.to_string_lossy().into_owned());
    for (name, svg) in pictures(&report)? {
        files::write_picture(&args.out.join(name), &svg)?;
    }
    let file = args.out.with_extension("md");
    files::write(&file, page(&report, &folder).as_bytes())?;
    Ok(writeln!(out, "{}", file.display())?)
}
