//! Output and pictures of `crazyflie replay`.

use crazyflie_statistics::median;
use std::io::Write;

use crazyflie_identify::replay::{Replay, SIGNALS, Signal, SignalComparison};
use crazyflie_picture::{BLACK, BLUE, Drawing, GREEN, GREY, Panel, PictureError, Style, VERMILION, chart};
use serde_json::{Value, json};

use super::files::stem;
use super::replay::LogReplay;
use super::{Outcome, Table, number};

/// Writes the table of one log.
pub(super) fn write_replay(log_replay: &LogReplay, model: &str, out: &mut dyn Write) -> Outcome {
    let Some((_, first)) = log_replay.runs.first() else { return Ok(()) };
    let form = first.input.name();
    writeln!(
        out,
        "{} on model {model}, vertical form {form}, {:.2} to {:.2} s",
        log_replay.file, first.start_s, first.end_s
    )?;
    for note in &log_replay.log.notes {
        writeln!(out, "  log: {note}")?;
    }
    for remark in &first.remarks {
        writeln!(out, "  {remark}")?;
    }
    let mut header = vec!["signal".to_owned()];
    for (horizon_s, _) in &log_replay.runs {
        let name = horizon_name(*horizon_s);
        header.extend([format!("{name}: fit"), "RMSE".to_owned()]);
    }
    let mut table = Table::new(&header.iter().map(String::as_str).collect::<Vec<_>>());
    for (at, signal) in SIGNALS.iter().enumerate() {
        let mut cells = vec![signal.name.to_owned()];
        for (_, run) in &log_replay.runs {
            let fit = run.signals[at].fit;
            cells.extend([percent(fit.fit_percent), rmse(signal, fit.rmse)]);
        }
        table.row(cells);
    }
    Ok(writeln!(out, "{}", table.plain())?)
}

/// Writes medians over several logs.
pub(super) fn write_summary(replays: &[LogReplay], out: &mut dyn Write) -> Outcome {
    writeln!(out, "median of {} flights", replays.len())?;
    let mut header = vec!["signal".to_owned()];
    for (horizon_s, _) in &replays[0].runs {
        let name = horizon_name(*horizon_s);
        header.extend([format!("{name}: fit"), "RMSE".to_owned()]);
    }
    let mut table = Table::new(&header.iter().map(String::as_str).collect::<Vec<_>>());
    for (at, signal) in SIGNALS.iter().enumerate() {
        let mut cells = vec![signal.name.to_owned()];
        for run in 0..replays[0].runs.len() {
            let values_of = |value: &dyn Fn(&SignalComparison) -> Option<f64>| {
                replays.iter().filter_map(|f| value(&f.runs[run].1.signals[at])).collect::<Vec<f64>>()
            };
            cells.push(percent(median(&values_of(&|c| c.fit.fit_percent))));
            cells.push(median(&values_of(&|c| Some(c.fit.rmse))).map_or("-".into(), |v| rmse(signal, v)));
        }
        table.row(cells);
    }
    writeln!(out, "{}", table.plain())?;
    Ok(writeln!(
        out,
        "fit: 100 (1 - |y - yhat| / |y - mean y|), as MATLAB's compare; 100 is perfect, 0 no better than the mean"
    )?)
}

/// The middle value; of two middle ones the mean.
fn horizon_name(horizon_s: Option<f64>) -> String {
    horizon_s.map_or("free run".into(), |s| format!("{s} s"))
}

fn percent(fit: Option<f64>) -> String {
    // a free run of an integrator leaves any frame
    fit.map_or(
        "-".into(),
        |fit| if fit < -9999.0 { "< -9999 %".into() } else { format!("{} %", number(fit, 1)) },
    )
}

fn rmse(signal: &Signal, si: f64) -> String {
    let value = signal.in_unit(si);
    format!("{} {}", number(value, if value.abs() < 10.0 { 3 } else { 1 }), signal.unit)
}

pub(super) fn as_json(log_replay: &LogReplay) -> Value {
    let notes: Vec<String> = log_replay.log.notes.iter().map(ToString::to_string).collect();
    let runs: Vec<Value> = log_replay.runs.iter().map(|(horizon_s, run)| run_json(*horizon_s, run)).collect();
    json!({"file": log_replay.file, "notes": notes, "runs": runs})
}

fn run_json(horizon_s: Option<f64>, run: &Replay) -> Value {
    let remarks: Vec<String> = run.remarks.iter().map(ToString::to_string).collect();
    let signals = SIGNALS.iter().zip(&run.signals).map(|(signal, compared)| {
        let fit = compared.fit;
        let value = json!({"unit": signal.unit, "fit_percent": fit.fit_percent, "rmse": signal.in_unit(fit.rmse),
            "max_error": signal.in_unit(fit.max_error), "samples": compared.t_s.len()});
        (signal.name.to_owned(), value)
    });
    json!({"horizon_s": horizon_s, "vertical": run.input.name(), "start_s": run.start_s, "end_s": run.end_s,
        "remarks": remarks, "signals": signals.collect::<serde_json::Map<_, _>>()})
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians() {
        assert_eq!(median(&[3.0, 1.0, 2.0, 4.0]), Some(2.5));
    }
}
