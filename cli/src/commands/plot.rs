//! `crazyflie plot`: the loops of the PID on paper.

use std::io::Write;
use std::path::PathBuf;

use crazyflie_control::loop_analysis::{LoopAxis, LoopReport};
use crazyflie_control::pid::Gains;
use crazyflie_env::action::Interface;
use crazyflie_env::model::VerticalInput;

use super::{Failure, Outcome, Table, files, number};
use crate::loop_plots::{loop_picture, loop_reports};

const EXAMPLES: &str = "\
Examples:
  crazyflie plot --picture loops.pdf
  crazyflie plot --loop z --vertical thrust --gains gains.json --picture z.png
  crazyflie plot --loop x --json";

/// Draw Bode, Nyquist and root-locus plots and the step response of the PID's loops, and print their margins
/// and figures.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// x, y, z or yaw; all unless given
    #[arg(long = "loop", value_name = "NAME")]
    axis: Option<String>,
    /// Model file; the thesis's model unless given
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Which vertical form of the model is commanded: height, pwm, thrust or motors [default: pwm, if
    /// the model has it]
    #[arg(long, value_parser = files::vertical, value_name = "FORM")]
    vertical: Option<VerticalInput>,
    /// Gains as `crazyflie tune` writes them; table 7.1's unless given
    #[arg(long, value_name = "FILE.json")]
    gains: Option<PathBuf>,
    /// ideal, or lab: a 30 Hz camera with 50 ms latency, whose dead time the loops contain
    #[arg(long, default_value = "lab", value_name = "NAME")]
    sensors: String,
    /// Draw the plots
    #[arg(long, value_parser = files::picture, value_name = "FILE.svg|png|pdf")]
    picture: Option<PathBuf>,
    /// For machines, with all curves
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let model = files::model(args.model.as_deref())?;
    let vertical = args.vertical.unwrap_or_else(|| files::default_vertical(&model));
    let axis = args.axis.as_deref().map(LoopAxis::find).transpose()?;
    let gains: Gains = match &args.gains {
        None => {
            let hover = Interface::from_model(&model, vertical)?.hover_lift;
            if hover > 0.0 { Gains::THESIS.for_hover(hover) } else { Gains::THESIS }
        }
        Some(file) => {
            let bytes = std::fs::read(file).map_err(|e| Failure::about(file.display(), e))?;
            serde_json::from_slice(&bytes).map_err(|e| Failure::about(file.display(), e))?
        }
    };
    gains.check().map_err(Failure::Failed)?;
    let reports = loop_reports(&model, vertical, axis, &gains, &args.sensors)?;
    if let Some(file) = &args.picture {
        let dead_time_ms = reports.first().map_or(0.0, |report| 1e3 * report.dead_time_s);
        let title = format!(
            "{}, {} form: PID loops with {dead_time_ms:.0} ms of dead time",
            model.name,
            vertical.name()
        );
        files::write_picture(file, &loop_picture(&reports, &title)?)?;
    }
    if args.json {
        serde_json::to_writer(&mut *out, &reports)?;
        return Ok(writeln!(out)?);
    }
    Ok(write!(out, "{}", table(&reports).plain())?)
}

fn table(reports: &[LoopReport]) -> Table {
    let header =
        ["loop", "phase margin", "gain margin", "delay margin", "crossover", "rise", "overshoot", "settled"];
    let mut table = Table::new(&header);
    let finite = |value: f64, decimals: usize, unit: &str| {
        if value.is_finite() { format!("{} {unit}", number(value, decimals)) } else { "-".into() }
    };
    let seconds = |value: Option<f64>| value.map_or("never".into(), |s| format!("{} s", number(s, 2)));
    for report in reports {
        let (m, f) = (&report.margins, &report.step.figures);
        table.row(vec![
            report.name.into(),
            finite(m.phase_deg, 0, "deg"),
            finite(m.gain_db, 1, "dB"),
            finite(m.delay_ms, 0, "ms"),
            finite(m.crossover_radps, 2, "rad/s"),
            seconds(f.rise_s),
            format!("{} %", number(100.0 * f.overshoot, 1)),
            seconds(f.settling_s),
        ]);
    }
    table
}
