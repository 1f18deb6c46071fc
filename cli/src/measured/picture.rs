//! Pictures of the page.

use crazyflie_identify::explain::errors::{HORIZONS_S, QUANTITIES};
use crazyflie_picture::{BLUE, Drawing, GREEN, PURPLE, Panel, PictureError, Style, VERMILION, chart};

use super::{RecordedReport, force};

/// So much of a flight shows every wave.
const SHOWN_S: [f64; 2] = [5.0, 17.0];

/// File names and drawings.
///
/// # Errors
/// Numbers that cannot be drawn.
pub(crate) fn pictures(report: &RecordedReport) -> Result<Vec<(&'static str, Drawing)>, PictureError> {
    Ok(vec![
        ("errors.svg", errors(report)?),
        ("force.svg", specific_force(report)?),
        ("closed_loop.svg", closed_loop(report)?),
    ])
}

/// The first test flight as flown, and as the firmware's controller is predicted to fly it on two models.
fn closed_loop(report: &RecordedReport) -> Result<Drawing, PictureError> {
    let [thesis, _, explained] = &report.closed_loop[1];
    let (Some((name, before)), Some((_, after))) = (thesis.flights.first(), explained.flights.first()) else {
        return chart(&[], 1, "no test flight holds set-points");
    };
    let curves = [
        ("set-point", PURPLE, Style::Dashed, &before.setpoint_m),
        ("measured", BLUE, Style::Solid, &before.measured_m),
        ("thesis model", VERMILION, Style::Solid, &before.predicted_m),
        ("explained", GREEN, Style::Solid, &after.predicted_m),
    ];
    let panels = [0, 1, 2].map(|i| {
        let panel = Panel::new("time (s)", "position (m)").title(["x", "y", "z"][i]);
        curves.iter().fold(panel, |panel, (label, color, style, points)| {
            panel.curve(*style, *color, *label, &before.t_s, points.iter().map(|p| p[i]))
        })
    });
    chart(&panels, 1, &format!("{name}: the firmware's controller along the same set-points"))
}

/// Error over horizon, the decimal logarithm of both: three orders of magnitude lie between the ends.
fn errors(report: &RecordedReport) -> Result<Drawing, PictureError> {
    let [a, b] = &report.errors;
    let curves = [
        ("thesis model", VERMILION, Style::Solid, &a.before),
        ("re-identified", BLUE, Style::Solid, &a.after),
        ("explained", GREEN, Style::Solid, &b.after),
        ("nothing moves on", PURPLE, Style::Dashed, &a.naive),
    ];
    let labels = ["log10 of the error (m)", "log10 of the error (m/s)", "log10 of the error (rad)"];
    let panel = |q: usize| {
        let panel = Panel::new("log10 of the horizon (s)", labels[q]).title(QUANTITIES[q].0);
        curves.iter().fold(panel, |panel, (label, color, style, table)| {
            let (x, y) = (HORIZONS_S.iter().map(|s| s.log10()), table[q][..4].iter().map(|e| e.log10()));
            panel.curve(*style, *color, *label, x.take(4), y)
        })
    };
    chart(&(0..QUANTITIES.len()).map(panel).collect::<Vec<_>>(), 3, "Test flights, from the commands alone")
}

fn specific_force(report: &RecordedReport) -> Result<Drawing, PictureError> {
    let recorded = &report.test.recorded[0];
    let mut panels = Vec::new();
    for (label, color, at, flight) in [
        ("re-identified", VERMILION, &report.again, &recorded.flight),
        ("explained", GREEN, &report.explained, &report.judged_trim[0]),
    ] {
        let Some(force) = force::force(flight, at).map(cut) else { continue };
        let panel = Panel::new("time (s)", "vertical specific force (m/s^2)").title(label);
        let measured = panel.curve(Style::Solid, BLUE, "measured", &force.t_s, force.measured_mps2);
        panels.push(measured.curve(Style::Solid, color, label, &force.t_s, force.predicted_mps2));
    }
    chart(&panels, 1, &format!("{}, a test flight", recorded.flight.name))
}

fn cut(force: force::SpecificForce) -> force::SpecificForce {
    let kept: Vec<usize> =
        (0..force.t_s.len()).filter(|i| (SHOWN_S[0]..SHOWN_S[1]).contains(&force.t_s[*i])).collect();
    let select = |v: &[f64]| kept.iter().map(|i| v[*i]).collect();
    force::SpecificForce {
        t_s: select(&force.t_s),
        measured_mps2: select(&force.measured_mps2),
        predicted_mps2: select(&force.predicted_mps2),
    }
}
