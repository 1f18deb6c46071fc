//! `crazyflie plot`: the loops of the PID on paper.

use std::io::Write;
use std::path::PathBuf;

use crazyflie_control::loop_analysis::{LoopAxis, LoopReport};
use crazyflie_control::pid::Gains;
use crazyflie_env::model::VerticalInput;
use crazyflie_server::tune::hovering_gains;

use super::files::ModelArg;
use super::{Failure, Outcome, Table, files, quantity, seconds};
use crate::loop_plots::{loop_picture, loop_reports};

/// Draw Bode, Nyquist and root-locus plots and the step response of the PID's loops, and print their margins
/// and figures.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Loop: x, y, z or yaw [default: all]
    #[arg(long = "loop", value_name = "NAME")]
    axis: Option<String>,
    #[command(flatten)]
    model: ModelArg,
    /// Vertical form of the model that is commanded: height, pwm, thrust or motors [default: pwm, if the
    /// model has it]
    #[arg(long, value_parser = files::vertical, value_name = "FORM")]
    vertical: Option<VerticalInput>,
    /// Gains as `crazyflie tune` writes them [default: those of table 7.1]
    #[arg(long, value_name = "FILE.json")]
    gains: Option<PathBuf>,
    /// ideal, or lab: a 30 Hz camera with 50 ms latency, whose dead time the loops contain
    #[arg(long, default_value = "lab", value_name = "NAME")]
    sensors: String,
    /// Draw the plots
    #[arg(long, value_parser = files::picture, value_name = "FILE.svg|png|pdf")]
    picture: Option<PathBuf>,
    /// Print JSON, with all curves
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let model = args.model.read()?;
    let vertical = args.vertical.unwrap_or_else(|| files::default_vertical(&model));
    let axis = args.axis.as_deref().map(LoopAxis::find).transpose()?;
    let gains: Gains = match &args.gains {
        None => hovering_gains(&model, vertical, &Gains::THESIS)?,
        Some(file) => {
            let bytes = std::fs::read(file).map_err(|e| Failure::about(file.display(), e))?;
            serde_json::from_slice(&bytes).map_err(|e| Failure::about(file.display(), e))?
        }
    };
    gains.check().map_err(Failure::Failed)?;
    let reports = loop_reports(&model, vertical, axis, &gains, &args.sensors)?;
    let dead_time_ms = reports.first().map_or(0.0, |report| 1e3 * report.dead_time_s);
    let title =
        format!("{}, {} form: PID loops with {dead_time_ms:.0} ms of dead time", model.name, vertical.name());
    files::picture_to(args.picture.as_ref(), || loop_picture(&reports, &title))?;
    if args.json {
        serde_json::to_writer(&mut *out, &reports)?;
        return Ok(writeln!(out)?);
    }
    Ok(write!(out, "{}", table(&reports))?)
}

fn table(reports: &[LoopReport]) -> Table<&LoopReport> {
    Table::from_rows(reports)
        .words("loop", |r| r.name)
        .values("phase margin", |r| quantity(r.margins.phase_deg, 0, "deg"))
        .values("gain margin", |r| quantity(r.margins.gain_db, 1, "dB"))
        .values("delay margin", |r| quantity(r.margins.delay_ms, 0, "ms"))
        .values("crossover", |r| quantity(r.margins.crossover_radps, 2, "rad/s"))
        .values("rise", |r| seconds(r.step.figures.rise_s, 2))
        .values("overshoot", |r| quantity(100.0 * r.step.figures.overshoot, 1, "%"))
        .values("settled", |r| seconds(r.step.figures.settling_s, 2))
}
