//! Output and pictures of `crazyflie replay`.

use std::fmt::Display;
use std::io::Write;

use crazyflie_identify::metrics::Fit;
use crazyflie_identify::replay::{Replay, SIGNALS, Signal};
use crazyflie_picture::{BLACK, BLUE, Drawing, GREEN, GREY, Panel, PictureError, Style, VERMILION, chart};
use crazyflie_statistics::median;
use serde_json::{Value, json};

use super::files::stem;
use super::replay::LogReplay;
use super::{Outcome, Table, number, or_dash, percent};

/// Writes the table of each log, and medians over several.
pub(super) fn write(replays: &[LogReplay], model: &str, out: &mut dyn Write) -> Outcome {
    for LogReplay { file, log, runs } in replays {
        let Some((_, Replay { input, start_s, end_s, remarks, .. })) = runs.first() else { continue };
        let form = input.name();
        writeln!(out, "{file} on model {model}, vertical form {form}, {start_s:.2} to {end_s:.2} s")?;
        log.notes.iter().try_for_each(|note| writeln!(out, "  log: {note}"))?;
        remarks.iter().try_for_each(|remark| writeln!(out, "  {remark}"))?;
        writeln!(out, "{}", table(&[runs]))?;
    }
    if replays.len() > 1 {
        let runs: Vec<_> = replays.iter().map(|replay| &replay.runs).collect();
        writeln!(out, "median of {} flights\n{}", replays.len(), table(&runs))?;
        let fit = "100 (1 - |y - yhat| / |y - mean y|), as MATLAB's compare";
        writeln!(out, "fit: {fit}; 100 is perfect, 0 no better than the mean")?;
    }
    Ok(())
}

/// Fits and errors of every signal by horizon, medians where there are several flights.
fn table(flights: &[&Vec<(Option<f64>, Replay)>]) -> impl Display {
    let mut table = Table::from_rows(SIGNALS.iter().enumerate()).words("signal", |(_, signal)| signal.name);
    for (run, (horizon_s, _)) in flights[0].iter().enumerate() {
        let name = horizon_s.map_or("free run".into(), |s| format!("{s} s"));
        let median_of = |at: usize, value: fn(&Fit) -> Option<f64>| {
            let values = flights.iter().filter_map(|runs| value(&runs[run].1.signals[at].fit));
            median(&values.collect::<Vec<_>>())
        };
        table = table
            .values(format!("{name}: fit"), |(at, _)| percent(median_of(at, |fit| fit.fit_percent), 1))
            .values("RMSE", |(at, of)| or_dash(median_of(at, |fit| Some(fit.rmse)).map(|v| rmse(of, v))));
    }
    table
}

fn rmse(signal: &Signal, si: f64) -> String {
    let value = signal.in_unit(si);
    format!("{} {}", number(value, if value.abs() < 10.0 { 3 } else { 1 }), signal.unit)
}

pub(super) fn as_json(log_replay: &LogReplay) -> Value {
    let notes: Vec<String> = log_replay.log.notes.iter().map(ToString::to_string).collect();
    let runs: Vec<Value> = log_replay.runs.iter().map(|(horizon_s, run)| run.summary(*horizon_s)).collect();
    json!({"file": log_replay.file, "notes": notes, "runs": runs})
}

/// One panel per signal: measured, each prediction, and for roll and pitch the command. A prediction that
/// leaves the frame is cut there.
pub(super) fn picture(log_replay: &LogReplay) -> Result<Drawing, PictureError> {
    let panels: Vec<Panel> =
        SIGNALS.iter().enumerate().map(|(at, signal)| panel(log_replay, at, signal)).collect();
    chart(&panels, 2, &format!("{}: measured and predicted", stem(&log_replay.file)))
}

fn panel(LogReplay { log, runs, .. }: &LogReplay, at: usize, signal: &Signal) -> Panel {
    let mut panel = Panel::new("time (s)", format!("{} ({})", signal.name, signal.unit));
    let in_unit = |values: &[f64]| values.iter().map(|v| signal.in_unit(*v)).collect::<Vec<f64>>();
    let command = [&log.cmd_roll_rad, &log.cmd_pitch_rad].get(at).copied().and_then(Option::as_ref);
    if let (Some(command), Some((_, first))) = (command, runs.first()) {
        let rows = (0..log.len()).filter(|&i| (first.start_s..=first.end_s).contains(&log.t_s[i]));
        let (x, y): (Vec<f64>, Vec<f64>) = rows.map(|i| (log.t_s[i], signal.in_unit(command[i]))).unzip();
        panel = panel.curve(Style::Step, GREY, "command", x, y);
    }
    for (i, ((horizon_s, run), color)) in runs.iter().zip([VERMILION, BLUE, GREEN]).enumerate() {
        let compared = &run.signals[at];
        if i == 0 {
            // a quarter of the measured span around it, and at least a little
            panel = panel
                .curve(Style::Solid, BLACK, "measured", &compared.t_s, in_unit(&compared.measured))
                .cut_around(0.25, if signal.is_angle { 2.0 } else { 0.1 });
        }
        // three predictions hide each other: the shortest horizon is in the table
        if runs.len() == 3 && *horizon_s == Some(0.5) {
            continue;
        }
        let label = horizon_s.map_or("predicted, free run".into(), |s| format!("predicted, {s} s"));
        panel = panel.curve(Style::Solid, color, label, &compared.t_s, in_unit(&compared.predicted));
    }
    panel
}
