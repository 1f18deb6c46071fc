//! Output of `crazyflie fly`.

use std::io::Write;

use serde_json::{Value, json};

use super::{Outcome, Table, number};
use crazyflie_server::flight::{AXES, AxisSpec, Figures, FlightEnd, PhaseFigures, Settling, Trace};

const HEADER: [&str; 7] =
    ["axis", "settled (s)", "overshoot", "RMSE", "final error", "effort RMS", "travel/s"];

/// Writes the figures of one flight.
pub(super) fn write_flight(figures: &Figures, trace: &Trace, out: &mut dyn Write) -> Outcome {
    for phase in &figures.phases {
        title(phase, out)?;
        let mut table = Table::new(&HEADER);
        for (axis, f) in AXES.iter().zip(&phase.axes) {
            let error = |value: f64| with_unit(value * axis.per_si, axis.unit);
            let command = |value: f64| with_unit(value, command_unit(axis, trace));
            let overshoot = f.overshoot.map_or("-".into(), error);
            table.row(vec![
                axis.name.into(),
                settling_text(f.settling),
                overshoot,
                error(f.rmse),
                error(f.final_error),
                command(f.effort),
                command(f.travel_per_s),
            ]);
        }
        writeln!(out, "{}", table.plain())?;
    }
    writeln!(out, "marker lost: {} times, {:.2} s in all", figures.marker_losses, figures.marker_lost_s)?;
    writeln!(out, "reward: {} in all", number(figures.reward, 2))?;
    writeln!(out, "end: {}", end_text(figures))?;
    write_legend(trace, out)
}

/// Writes median and quartiles over the runs.
pub(super) fn write_runs(all: &[Figures], trace: &Trace, out: &mut dyn Write) -> Outcome {
    writeln!(out, "{} flights: median (first to third quartile)", all.len())?;
    let phases = all.iter().map(|f| f.phases.len()).max().unwrap_or(0);
    for at in 0..phases {
        // a flight that ended early has no later phases
        let phase_of_runs: Vec<&PhaseFigures> = all.iter().filter_map(|f| f.phases.get(at)).collect();
        title(phase_of_runs[0], out)?;
        let mut table = Table::new(&HEADER);
        for (i, axis) in AXES.iter().enumerate() {
            let values_of = |value: &dyn Fn(&PhaseFigures) -> f64| {
                phase_of_runs.iter().map(|p| value(p)).collect::<Vec<f64>>()
            };
            let error = |value: &dyn Fn(&PhaseFigures) -> f64| {
                with_unit_spread(values_of(value), axis.per_si, axis.unit)
            };
            let command = |value: &dyn Fn(&PhaseFigures) -> f64| {
                with_unit_spread(values_of(value), 1.0, command_unit(axis, trace))
            };
            let moving = phase_of_runs[0].axes[i].overshoot.is_none();
            table.row(vec![
                axis.name.into(),
                if moving {
                    "-".into()
                } else {
                    settling_spread(values_of(&|p| seconds(p.axes[i].settling)))
                },
                if moving { "-".into() } else { error(&|p| p.axes[i].overshoot.unwrap_or(0.0)) },
                error(&|p| p.axes[i].rmse),
                error(&|p| p.axes[i].final_error),
                command(&|p| p.axes[i].effort),
                command(&|p| p.axes[i].travel_per_s),
            ]);
        }
        writeln!(out, "{}", table.plain())?;
    }
    let losses: usize = all.iter().map(|f| f.marker_losses).sum();
    let lost_s: f64 = all.iter().map(|f| f.marker_lost_s).sum();
    let crashed = all.iter().filter(|f| f.crash().is_some()).count();
    writeln!(out, "marker lost: {losses} times in all flights, {lost_s:.2} s in all")?;
    writeln!(out, "crashed: {crashed} of {}", all.len())?;
    let [low, middle, high] = quartiles(all.iter().map(|f| f.reward).collect()).map(|r| number(r, 2));
    writeln!(out, "reward: {middle} ({low} to {high}) in all")?;
    write_legend(trace, out)
}

fn title(phase: &PhaseFigures, out: &mut dyn Write) -> Outcome {
    let name = if phase.name.is_empty() { "in the air" } else { &phase.name };
    Ok(writeln!(out, "{name}, {:.2} to {:.2} s", phase.from_s, phase.to_s)?)
}

fn write_legend(trace: &Trace, out: &mut dyn Write) -> Outcome {
    writeln!(
        out,
        "settled: within 5 cm (5 deg) for good, counted from the phase's start or lift-off; final error: mean of the last second;"
    )?;
    let level = trace.interface.level();
    let what = if level.is_default() {
        "command that serves the axis (x: pitch, y: roll, z: lift about hover)".into()
    } else {
        format!("axis's set-point of {}", level.name())
    };
    Ok(writeln!(out, "effort and travel: of the {what}")?)
}

fn settling_text(settling: Settling) -> String {
    match settling {
        Settling::Moving => "-".into(),
        Settling::Never => "never".into(),
        Settling::At(s) => number(s, 2),
    }
}

/// Seconds until settled; infinite for never.
fn seconds(settling: Settling) -> f64 {
    match settling {
        Settling::At(s) => s,
        Settling::Moving | Settling::Never => f64::INFINITY,
    }
}

fn settling_spread(values: Vec<f64>) -> String {
    let [low, middle, high] =
        quartiles(values).map(|s| if s.is_finite() { number(s, 2) } else { "never".into() });
    format!("{middle} ({low} to {high})")
}

fn with_unit(value: f64, unit: &str) -> String {
    format!("{} {unit}", number(value, 2))
}

fn with_unit_spread(values: Vec<f64>, per_si: f64, unit: &str) -> String {
    let [low, middle, high] = quartiles(values).map(|v| number(v * per_si, 2));
    format!("{middle} ({low} to {high}) {unit}")
}

/// First quartile, median and third quartile, each a value that occurred.
pub(super) fn quartiles(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [1, 2, 3].map(|q| values[q * (values.len() - 1) / 4])
}

fn command_unit(axis: &AxisSpec, trace: &Trace) -> &'static str {
    let level = trace.interface.level();
    if !level.is_default() {
        // set-points are in the order of the axes
        return AXES.iter().position(|known| known == axis).map_or("", |i| level.entry().channels[i].unit);
    }
    match axis.name {
        "x" | "y" => "deg",
        "z" if trace.interface.hover_lift > 0.0 => "%",
        "z" => "cm",
        _ => "deg/s",
    }
}

fn end_text(figures: &Figures) -> String {
    if let Some(crash) = figures.crash() {
        return format!("CRASH after {:.2} s: {crash}", figures.end_s);
    }
    let landed = match (figures.end, figures.not_landed_m, figures.touch_down) {
        (FlightEnd::Floor { impact_mps }, ..) => format!(", touched down at {impact_mps:.2} m/s"),
        (FlightEnd::Task, ..) => ", ended by the task".into(),
        (_, Some(m), _) => {
            format!(", NOT LANDED: still {:.1} cm up (the controller stops the motors at 5 cm)", 100.0 * m)
        }
        (_, _, Some((t_s, mps))) => format!(", last touch-down at {t_s:.2} s with {mps:.2} m/s"),
        _ => String::new(),
    };
    // the task may have ended it because something was hit
    let crash = if figures.end == FlightEnd::Task { "" } else { ", no crash" };
    format!("{:.2} s{crash}{landed}", figures.end_s)
}

pub(super) fn as_json(figures: &Figures) -> Value {
    let phases: Vec<Value> = figures
        .phases
        .iter()
        .map(|phase| {
            let axes = AXES.iter().zip(&phase.axes).map(|(axis, f)| {
                let settling_s = match f.settling {
                    Settling::At(s) => Some(s),
                    Settling::Moving | Settling::Never => None,
                };
                let value = json!({"unit": axis.unit, "settled_s": settling_s, "overshoot": f.overshoot.map(|o| o * axis.per_si),
                    "rmse": f.rmse * axis.per_si, "final_error": f.final_error * axis.per_si,
                    "effort_rms": f.effort, "travel_per_s": f.travel_per_s});
                (axis.name.to_owned(), value)
            });
            json!({"name": phase.name, "from_s": phase.from_s, "to_s": phase.to_s, "axes": axes.collect::<serde_json::Map<_, _>>()})
        })
        .collect();
    let touch_down = figures.touch_down.map(|(t_s, mps)| json!({"t_s": t_s, "mps": mps}));
    json!({"phases": phases, "end_s": figures.end_s, "reward": figures.reward, "crash": figures.crash(), "touch_down": touch_down,
        "not_landed_m": figures.not_landed_m,
        "marker_losses": figures.marker_losses, "marker_lost_s": figures.marker_lost_s})
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_are_values_that_occurred() {
        assert_eq!(quartiles(vec![5.0, 1.0, 4.0, 2.0, 3.0]), [2.0, 3.0, 4.0]);
        assert_eq!(quartiles(vec![7.0]), [7.0; 3]);
        assert_eq!(settling_spread(vec![1.0, f64::INFINITY, f64::INFINITY]), "never (1.00 to never)");
    }
}
