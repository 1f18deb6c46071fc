//! `crazyflie tune`: gains of the PID.

use std::io::Write;
use std::path::PathBuf;

use crazyflie_env::config::EffectTable;
use crazyflie_env::model::VerticalInput;
use indicatif::ProgressBar;
use serde_json::{Value, json};

use super::{Failure, Outcome, Table, files, number};
use crate::tune::{
    AXES, GainComparison, LoopEvaluation, LoopRequirements, TuningSetup, dead_time_s, picture, tune,
};
use crazyflie_server::flight::{FlightScenario, LAB_LATENCY_S, lab_rig};

const EXAMPLES: &str = "\
Examples:
  crazyflie tune --out gains.json --picture steps.svg
  crazyflie fly --task fly-80cm --sensors lab --controller pid:gains.json
  crazyflie tune --model my.toml --phase-margin 45
  crazyflie tune --task track --json";

/// Search the PID's gains for a model: the fastest response without overshoot, with a margin, and compare
/// them with the thesis's.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Model file; the thesis's model unless given
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Which vertical form of the model is commanded: height, pwm or thrust [default: pwm, if the model has
    /// it]
    #[arg(long, value_parser = files::vertical, value_name = "FORM")]
    vertical: Option<VerticalInput>,
    /// Besides steps of 50 cm, 30 cm of height and 30 degrees, the error in this task or flight counts (see
    /// `crazyflie tasks`)
    #[arg(long, value_name = "NAME")]
    task: Option<String>,
    /// ideal, or lab: a 30 Hz camera with 50 ms latency and noise, whose dead time the margins contain
    #[arg(long, default_value = "lab", value_name = "NAME")]
    sensors: String,
    /// Phase margin that is asked for, in degrees
    #[arg(long, default_value_t = 30.0, value_name = "DEG")]
    phase_margin: f64,
    /// Gain margin that is asked for, in decibels
    #[arg(long, default_value_t = 6.0, value_name = "DB")]
    gain_margin: f64,
    /// Overshoot that is accepted, in percent of the step
    #[arg(long, default_value_t = 2.0, value_name = "PERCENT")]
    overshoot: f64,
    /// Write the gains, for `--controller pid:FILE`
    #[arg(long, value_name = "FILE.json")]
    out: Option<PathBuf>,
    /// Draw the responses
    #[arg(long, value_parser = files::picture, value_name = "FILE.svg")]
    picture: Option<PathBuf>,
    /// For machines
    #[arg(long)]
    json: bool,
}

/// Flights of one trial: one tile of the simulator.
const SEEDS: u64 = 16;

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let requested = [args.phase_margin, args.gain_margin, args.overshoot];
    if let Some(bad) = requested.iter().find(|v| !(0.0..=90.0).contains(*v)) {
        return Err(Failure::Usage(format!("a margin or overshoot is {bad}, expected 0 to 90")));
    }
    let model = files::model(args.model.as_deref())?;
    let (effects, latency_s) = match &args.sensors[..] {
        "ideal" => (EffectTable::new(), None),
        "lab" => (lab_rig(), Some(LAB_LATENCY_S)),
        other => return Err(crazyflie_env::error::unknown("rig", other, ["ideal", "lab"]).into()),
    };
    // without a camera a command is held for a tick, half of which is its mean age
    let dead_time_s =
        latency_s.map_or(0.5 / model.rig.control.value, |latency_s| dead_time_s(&model, latency_s));
    let requirements = LoopRequirements {
        phase_deg: args.phase_margin,
        gain_db: args.gain_margin,
        overshoot: 0.01 * args.overshoot,
        dead_time_s,
    };
    let task = args.task.as_deref().map(FlightScenario::find).transpose()?;
    let vertical = args.vertical.unwrap_or_else(|| files::default_vertical(&model));
    let tuning = TuningSetup { model: &model, vertical, effects, task, seeds: (0..SEEDS).collect() };
    let bar = ProgressBar::new(AXES.len() as u64);
    let (gains, comparisons) = tune(&tuning, &requirements, &|_| bar.inc(1))?;
    bar.finish_and_clear();
    if let Some(file) = &args.out {
        files::write(file, &serde_json::to_vec_pretty(&gains)?)?;
    }
    if let Some(file) = &args.picture {
        let title = format!("{}: PID gains, {:.0} ms of dead time", model.name, 1e3 * dead_time_s);
        files::write(file, picture(&comparisons, &title)?.as_bytes())?;
    }
    if args.json {
        let loops: Vec<Value> = comparisons.iter().map(as_json).collect();
        serde_json::to_writer_pretty(
            &mut *out,
            &json!({"dead_time_s": dead_time_s, "gains": gains, "loops": loops}),
        )?;
        return Ok(writeln!(out)?);
    }
    writeln!(
        out,
        "{} of {}, margins with {:.0} ms of dead time\n",
        args.task.as_deref().unwrap_or("steps"),
        model.name,
        1e3 * dead_time_s
    )?;
    write!(out, "{}", table(&comparisons).plain())?;
    Ok(writeln!(out, "\n{}", words(&comparisons))?)
}

fn as_json(t: &GainComparison) -> Value {
    let evaluation = |d: &LoopEvaluation| json!({"gains": d.gains, "margins": d.margins, "response": d.figures, "task_error_s": d.task_error_s});
    json!({"loop": t.axis.name(), "tried": t.tried, "crazyflie_ros": evaluation(&t.stock), "table_7_1": evaluation(&t.thesis), "tuned": evaluation(&t.found)})
}

fn table(comparisons: &[GainComparison]) -> Table {
    let header = [
        "loop",
        "gains",
        "Kp",
        "Ki",
        "Kd",
        "phase margin",
        "gain margin",
        "delay margin",
        "overshoot",
        "settled",
        "error",
        "in the task",
    ];
    let mut table = Table::new(&header).left(&[1]);
    let or_none = |value: f64, decimals: usize, unit: &str| {
        if value.is_finite() { format!("{} {unit}", number(value, decimals)) } else { "-".into() }
    };
    for t in comparisons {
        for (label, d) in [("crazyflie_ros", &t.stock), ("table 7.1", &t.thesis), ("tuned", &t.found)] {
            table.row(vec![
                t.axis.name().into(),
                label.into(),
                number(d.gains.kp, 2),
                number(d.gains.ki, 3),
                number(d.gains.kd, 2),
                or_none(d.margins.phase_deg, 0, "deg"),
                or_none(d.margins.gain_db, 1, "dB"),
                or_none(d.margins.delay_ms, 0, "ms"),
                format!("{} %", number(100.0 * d.figures.overshoot, 1)),
                d.figures.settling_s.map_or("never".into(), |s| format!("{} s", number(s, 2))),
                format!("{} s", number(d.figures.error_s, 2)),
                d.task_error_s.map_or("-".into(), |s| format!("{} s", number(s, 2))),
            ]);
        }
    }
    table
}

/// Reason that the thesis's gains beat the package's.
fn words(comparisons: &[GainComparison]) -> String {
    let Some(x) = comparisons.iter().find(|t| t.axis.name() == "x") else { return String::new() };
    let [stock, thesis, found] = [&x.stock, &x.thesis, &x.found].map(|d| d.margins.phase_deg);
    format!(
        "Sideways the package's gains have {stock:.0} degrees of phase margin, table 7.1's {thesis:.0}, because the ratio Kd/Kp, which leads the phase, is {:.2} s instead \
         of {:.2} s;\nthe gains found have {found:.0} degrees with a ratio of {:.2} s.",
        x.thesis.gains.kd / x.thesis.gains.kp,
        x.stock.gains.kd / x.stock.gains.kp,
        x.found.gains.kd / x.found.gains.kp
    )
}
