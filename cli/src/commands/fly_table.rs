//! Output of `crazyflie fly`.

use std::fmt::Display;
use std::io::Write;

use super::{Outcome, Table, number, or_dash};
use crazyflie_server::flight::{
    AXES, AxisFigures, AxisSpec, Figures, FlightEnd, PhaseFigures, TouchDown, Trace,
};

/// Writes the figures of one flight, or median and quartiles over several.
pub(super) fn write(all: &[Figures], trace: &Trace, out: &mut dyn Write) -> Outcome {
    if all.len() > 1 {
        writeln!(out, "{} flights: median (first to third quartile)", all.len())?;
    }
    for at in 0..all.iter().map(|f| f.phases.len()).max().unwrap_or(0) {
        // a flight that ended early has no later phases
        let phases: Vec<&PhaseFigures> = all.iter().filter_map(|f| f.phases.get(at)).collect();
        let PhaseFigures { name, from_s, to_s, .. } = phases[0];
        let name = if name.is_empty() { "in the air" } else { name };
        writeln!(out, "{name}, {from_s:.2} to {to_s:.2} s\n{}", axes(&phases, trace))?;
    }
    let losses: usize = all.iter().map(|f| f.marker_losses).sum();
    let lost_s: f64 = all.iter().map(|f| f.marker_lost_s).sum();
    let flights = if all.len() > 1 { " in all flights" } else { "" };
    writeln!(out, "marker lost: {losses} times{flights}, {lost_s:.2} s in all")?;
    writeln!(out, "reward: {} in all", spread(all.iter().map(|f| f.reward).collect(), 2, ""))?;
    match all {
        [figures] => writeln!(out, "end: {}", end_text(figures))?,
        _ => {
            let crashed = all.iter().filter(|f| f.crash.is_some()).count();
            writeln!(out, "crashed: {crashed} of {}", all.len())?;
        }
    }
    write_legend(trace, out)
}

fn axes(phases: &[&PhaseFigures], trace: &Trace) -> impl Display {
    let all = |i: usize, value: fn(&AxisFigures) -> f64, scale: f64, unit: &str| {
        spread(phases.iter().map(|phase| scale * value(&phase.axes[i])).collect(), 2, unit)
    };
    let error = |i: usize, value| all(i, value, AXES[i].per_si, AXES[i].unit);
    let command = |i: usize, value| all(i, value, 1.0, command_unit(&AXES[i], trace));
    let still = |i: usize| phases[0].axes[i].overshoot.is_some();
    Table::from_rows(0..AXES.len())
        .words("axis", |i| AXES[i].name)
        .values("settled (s)", |i| {
            or_dash(still(i).then(|| all(i, |f| f.settled_s.unwrap_or(f64::INFINITY), 1.0, "")))
        })
        .values("overshoot", |i| or_dash(still(i).then(|| error(i, |f| f.overshoot.unwrap_or(0.0)))))
        .values("RMSE", |i| error(i, |f| f.rmse))
        .values("final error", |i| error(i, |f| f.final_error))
        .values("effort RMS", |i| command(i, |f| f.effort))
        .values("travel/s", |i| command(i, |f| f.travel_per_s))
}

fn write_legend(trace: &Trace, out: &mut dyn Write) -> Outcome {
    let counted = "counted from the phase's start or lift-off; final error: mean of the last second;";
    writeln!(out, "settled: within 5 cm (5 deg) for good, {counted}")?;
    let level = trace.interface.level();
    let what = if level.is_default() {
        "command that serves the axis (x: pitch, y: roll, z: lift about hover)".into()
    } else {
        format!("axis's set-point of {}", level.name())
    };
    Ok(writeln!(out, "effort and travel: of the {what}")?)
}

/// Formats the one value with so many decimals and its unit, or the median and the quartiles of several. It writes
/// `never` for an infinite value.
pub(super) fn spread(values: Vec<f64>, decimals: usize, unit: &str) -> String {
    let several = values.len() > 1;
    let text = |value: f64| if value.is_finite() { number(value, decimals) } else { "never".into() };
    let [low, middle, high] = quartiles(values).map(text);
    let range = if several { format!(" ({low} to {high})") } else { String::new() };
    format!("{middle}{range} {unit}").trim_end().to_owned()
}

/// First quartile, median and third quartile, each a value that occurred.
fn quartiles(mut values: Vec<f64>) -> [f64; 3] {
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
    if let Some(crash) = &figures.crash {
        return format!("CRASH after {:.2} s: {crash}", figures.end_s);
    }
    let landed = match (figures.end, figures.not_landed_m, figures.touch_down) {
        (FlightEnd::Floor { impact_mps }, ..) => format!(", touched down at {impact_mps:.2} m/s"),
        (FlightEnd::Task, ..) => ", ended by the task".into(),
        (_, Some(m), _) => {
            format!(", NOT LANDED: still {:.1} cm up (the controller stops the motors at 5 cm)", 100.0 * m)
        }
        (_, _, Some(TouchDown { t_s, mps })) => format!(", last touch-down at {t_s:.2} s with {mps:.2} m/s"),
        _ => String::new(),
    };
    // the task may have ended it because something was hit
    let crash = if figures.end == FlightEnd::Task { "" } else { ", no crash" };
    format!("{:.2} s{crash}{landed}", figures.end_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_are_values_that_occurred() {
        assert_eq!(quartiles(vec![5.0, 1.0, 4.0, 2.0, 3.0]), [2.0, 3.0, 4.0]);
        assert_eq!(quartiles(vec![7.0]), [7.0; 3]);
        assert_eq!(spread(vec![1.0, f64::INFINITY, f64::INFINITY], 2, ""), "never (1.00 to never)");
        assert_eq!(spread(vec![2.5], 2, "cm"), "2.50 cm");
    }
}
