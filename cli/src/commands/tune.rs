//! `crazyflie tune`: gains of the PID.

use std::io::Write;
use std::path::PathBuf;

use crazyflie_env::model::VerticalInput;
use crazyflie_picture::{BLACK, BLUE, Drawing, GREEN, Panel, PictureError, Style, VERMILION, chart};
use indicatif::ProgressBar;
use serde_json::json;

use super::files::ModelArg;
use super::{Failure, Outcome, Table, files, number, quantity, seconds, write_json};
use crazyflie_control::loop_analysis::{LoopAxis, Margins, dead_time_s};
use crazyflie_server::flight::{FlightScenario, sensor_rig};
use crazyflie_server::tune::{
    FormCheck, GainComparison, LoopEvaluation, LoopRequirements, Response, TuningSetup, check_forms, tune,
    warnings,
};

/// Search the PID's gains for a model: the fastest response without overshoot, with a margin and a calm command,
/// and compare them with the thesis's. Gains are written only if they have the margins, and take off, on every
/// vertical form of the model.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    model: ModelArg,
    /// Vertical form of the model that is commanded: height, pwm, thrust or motors [default: pwm, if the
    /// model has it]
    #[arg(long, value_parser = files::vertical, value_name = "FORM")]
    vertical: Option<VerticalInput>,
    /// Besides steps of 50 cm, 30 cm of height and 30 degrees, the error in this task or flight counts (see
    /// `crazyflie tasks`)
    #[arg(long, value_name = "NAME")]
    task: Option<String>,
    /// ideal, or lab: a 30 Hz camera with 50 ms latency and noise, whose dead time the margins contain
    #[arg(long, default_value = "lab", value_name = "NAME")]
    sensors: String,
    /// Required phase margin, in degrees
    #[arg(long, default_value_t = 30.0, value_name = "DEG")]
    phase_margin: f64,
    /// Required gain margin, in decibels
    #[arg(long, default_value_t = 6.0, value_name = "DB")]
    gain_margin: f64,
    /// Overshoot that is accepted, in percent of the step
    #[arg(long, default_value_t = 2.0, value_name = "PERCENT")]
    overshoot: f64,
    /// Write the gains, for `--controller pid:FILE`
    #[arg(long, value_name = "FILE.json")]
    out: Option<PathBuf>,
    /// Draw the responses
    #[arg(long, value_parser = files::picture, value_name = "FILE.svg|png|pdf")]
    picture: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Flights of one trial: one tile of the simulator.
const SEEDS: u64 = 16;

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let phase = ("--phase-margin", args.phase_margin);
    let requested = [phase, ("--gain-margin", args.gain_margin), ("--overshoot", args.overshoot)];
    if let Some((option, bad)) = requested.iter().find(|(_, v)| !(0.0..=90.0).contains(v)) {
        return Err(Failure::Usage(format!("{option} is {bad}, expected 0 to 90")));
    }
    let model = args.model.read()?;
    let (effects, latency_s) = sensor_rig(&args.sensors)?;
    let dead_time_s = dead_time_s(&model, latency_s);
    let task = args.task.as_deref().map(FlightScenario::find).transpose()?;
    let vertical = args.vertical.unwrap_or_else(|| files::default_vertical(&model));
    let (phase_deg, gain_db, overshoot) = (args.phase_margin, args.gain_margin, 0.01 * args.overshoot);
    let requirements = LoopRequirements { phase_deg, gain_db, overshoot, dead_time_s };
    let seeds = (0..SEEDS).collect();
    let tuning = TuningSetup { model: &model, vertical, effects, task, seeds, requirements };
    let bar = ProgressBar::new(LoopAxis::ALL.len() as u64);
    let (gains, comparisons) = tune(&tuning, &|_| bar.inc(1))?;
    bar.finish_and_clear();
    let (checks, warnings) = (check_forms(&tuning, &gains)?, warnings(&model));
    for warning in &warnings {
        writeln!(std::io::stderr(), "crazyflie: warning: {warning}")?;
    }
    let refused = refusal(&checks);
    if let (Some(file), None) = (&args.out, &refused) {
        files::write(file, &serde_json::to_vec_pretty(&gains)?)?;
    }
    let title = format!("{}: PID gains, {:.0} ms of dead time", model.name, 1e3 * dead_time_s);
    files::picture_to(args.picture.as_ref(), || picture(&comparisons, &title))?;
    if args.json {
        let told = json!({"dead_time_s": dead_time_s, "gains": gains, "loops": comparisons, "forms": checks, "warnings": warnings});
        write_json(&told, out)?;
        return refused.map_or(Ok(()), Err);
    }
    let (task, dead_time_ms) = (args.task.as_deref().unwrap_or("steps"), 1e3 * dead_time_s);
    writeln!(out, "{task} of {}, margins with {dead_time_ms:.0} ms of dead time\n", model.name)?;
    write!(out, "{}\n{}\n\n{}", table(&comparisons), words(&comparisons), form_table(&checks))?;
    refused.map_or(Ok(()), Err)
}

/// Reasons that these gains may not be written, if there are any.
fn refusal(checks: &[FormCheck]) -> Option<Failure> {
    let problems: Vec<String> = checks
        .iter()
        .flat_map(|check| {
            check.problems.iter().map(|p| format!("on the form {}, {p}", check.vertical.name()))
        })
        .collect();
    (!problems.is_empty()).then(|| {
        Failure::Failed(format!(
            "no gains are written, because none were found that meet the margins on every vertical form: {}",
            problems.join("; ")
        ))
    })
}

/// The gains that were found, on every vertical form.
fn form_table(checks: &[FormCheck]) -> Table<&FormCheck> {
    let of_z = |check: &FormCheck, value: fn(&Margins) -> f64| {
        check.margins.get(&LoopAxis::Z).map_or(f64::NAN, value)
    };
    Table::from_rows(checks)
        .words("vertical form", |check| check.vertical.name())
        .values("phase margin of z", |check| quantity(of_z(check, |m| m.phase_deg), 0, "deg"))
        .values("gain margin of z", |check| quantity(of_z(check, |m| m.gain_db), 1, "dB"))
        .values("take-off settled", |check| seconds(check.takeoff.settling_s, 1))
        .values("overshoot", |check| quantity(100.0 * check.takeoff.overshoot_m, 1, "cm"))
        .words("verdict", |check| if check.problems.is_empty() { "as asked for" } else { "refused" })
}

fn table(comparisons: &[GainComparison]) -> Table<(&GainComparison, &str, &LoopEvaluation)> {
    let rows = comparisons.iter().flat_map(|t| {
        [(t, "crazyflie_ros", &t.crazyflie_ros), (t, "table 7.1", &t.table_7_1), (t, "tuned", &t.tuned)]
    });
    Table::from_rows(rows)
        .words("loop", |(t, ..)| t.axis.name())
        .words("gains", |(_, label, _)| label)
        .values("Kp", |(.., d)| number(d.gains.kp, 2))
        .values("Ki", |(.., d)| number(d.gains.ki, 3))
        .values("Kd", |(.., d)| number(d.gains.kd, 2))
        .values("phase margin", |(.., d)| quantity(d.margins.phase_deg, 0, "deg"))
        .values("gain margin", |(.., d)| quantity(d.margins.gain_db, 1, "dB"))
        .values("delay margin", |(.., d)| quantity(d.margins.delay_ms, 0, "ms"))
        .values("overshoot", |(.., d)| quantity(100.0 * d.figures.overshoot, 1, "%"))
        .values("settled", |(.., d)| seconds(d.figures.settling_s, 2))
        .values("error", |(.., d)| quantity(d.figures.error_s, 2, "s"))
        .values("travel", |(.., d)| quantity(100.0 * d.figures.travel_per_s, 0, "%/s"))
        .values("in the task", |(.., d)| quantity(d.task_error_s.unwrap_or(f64::NAN), 2, "s"))
}

/// Reason that the thesis's gains beat the package's.
fn words(comparisons: &[GainComparison]) -> String {
    let Some(x) = comparisons.iter().find(|t| t.axis.name() == "x") else { return String::new() };
    let [stock, thesis, found] = [&x.crazyflie_ros, &x.table_7_1, &x.tuned].map(|d| d.margins.phase_deg);
    format!(
        "Sideways the package's gains have {stock:.0} degrees of phase margin, table 7.1's {thesis:.0}, because the ratio Kd/Kp, which leads the phase, is {:.2} s instead \
         of {:.2} s;\nthe gains found have {found:.0} degrees with a ratio of {:.2} s.",
        x.table_7_1.gains.kd / x.table_7_1.gains.kp,
        x.crazyflie_ros.gains.kd / x.crazyflie_ros.gains.kp,
        x.tuned.gains.kd / x.tuned.gains.kp
    )
}

/// Step responses of the loops, one panel each.
fn picture(comparisons: &[GainComparison], title: &str) -> Result<Drawing, PictureError> {
    chart(&comparisons.iter().map(panel).collect::<Vec<_>>(), 2, title)
}

/// Set-point and responses as far as they were flown. An unstable response leaves the frame, and the others can
/// be seen.
fn panel(t: &GainComparison) -> Panel {
    let phase = |deg: f64| if deg.is_finite() { format!("{deg:.0}") } else { "-".into() };
    let [stock, thesis, found] =
        [&t.crazyflie_ros, &t.table_7_1, &t.tuned].map(|d| phase(d.margins.phase_deg));
    let title = format!("{}: phase margin {stock}, {thesis}, {found} deg", t.axis.name());
    let (label, unit) = match t.axis {
        LoopAxis::X => ("x (m)", 1.0),
        LoopAxis::Y => ("y (m)", 1.0),
        LoopAxis::Z => ("z (m)", 1.0),
        LoopAxis::Yaw => ("yaw (deg)", 1.0_f64.to_degrees()),
    };
    let add = |panel: Panel, style, color, label, response: &Response, values: &[f64]| {
        panel.curve(style, color, label, &response.t_s[..values.len()], values.iter().map(|v| unit * v))
    };
    let (panel, r) = (Panel::new("time (s)", label).title(title), &t.tuned.response);
    let target = add(panel, Style::Dashed, BLACK, "set-point", r, &r.target).cut_around(1.0, 0.1 * unit);
    let responses = [
        ("crazyflie_ros", VERMILION, &t.crazyflie_ros),
        ("table 7.1", BLUE, &t.table_7_1),
        ("tuned", GREEN, &t.tuned),
    ];
    responses.into_iter().fold(target, |panel, (label, color, flown)| {
        add(panel, Style::Solid, color, label, &flown.response, &flown.response.value)
    })
}
