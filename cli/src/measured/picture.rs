//! Pictures of the page.

use crazyflie_identify::explain::errors::{HORIZONS_S, QUANTITIES};
use crazyflie_picture::{PALETTE, Panel, PictureError, Series, Style, chart};

use super::{RecordedReport, force};

/// So much of a flight shows every wave.
const SHOWN_S: [f64; 2] = [5.0, 17.0];

/// File names and SVG documents.
///
/// # Errors
/// Numbers that cannot be drawn.
pub(crate) fn pictures(report: &RecordedReport) -> Result<Vec<(&'static str, String)>, PictureError> {
    Ok(vec![
        ("errors.svg", errors(report)?),
        ("force.svg", specific_force(report)?),
        ("closed_loop.svg", closed_loop(report)?),
    ])
}

/// The first test flight as flown, and as the firmware's controller is predicted to fly it on two models.
fn closed_loop(report: &RecordedReport) -> Result<String, PictureError> {
    let [thesis, _, explained] = &report.closed_loop[1];
    let (Some((name, before)), Some((_, after))) = (thesis.flights.first(), explained.flights.first()) else {
        return chart(&[], 1, "no test flight holds set-points");
    };
    let axis = |points: &[[f64; 3]], i: usize| points.iter().map(|p| p[i]).collect::<Vec<f64>>();
    let curves: Vec<[Vec<f64>; 4]> = (0..3)
        .map(|i| {
            [
                axis(&before.setpoint_m, i),
                axis(&before.measured_m, i),
                axis(&before.predicted_m, i),
                axis(&after.predicted_m, i),
            ]
        })
        .collect();
    let looks = [
        ("set-point", PALETTE[3], Style::Dashed),
        ("measured", PALETTE[0], Style::Solid),
        ("thesis model", PALETTE[1], Style::Solid),
        ("explained", PALETTE[2], Style::Solid),
    ];
    let panels: Vec<Panel> = (0..3)
        .map(|i| Panel {
            title: ["x", "y", "z"][i],
            x_label: "time (s)",
            y_label: "position (m)",
            series: curves[i]
                .iter()
                .zip(looks)
                .map(|(y, (label, color, style))| Series { label, x: &before.t_s, y, style, color })
                .collect(),
            ..Panel::default()
        })
        .collect();
    chart(&panels, 1, &format!("{name}: the firmware's controller along the same set-points"))
}

/// Error over horizon, the decimal logarithm of both: three orders of magnitude lie between the ends.
fn errors(report: &RecordedReport) -> Result<String, PictureError> {
    let x: Vec<f64> = HORIZONS_S.iter().map(|s| s.log10()).collect();
    let log_errors =
        |table: &[[f64; 5]; 3], q: usize| table[q][..4].iter().map(|e| e.log10()).collect::<Vec<f64>>();
    let [a, b] = &report.errors;
    let curves: Vec<[Vec<f64>; 4]> = (0..QUANTITIES.len())
        .map(|q| {
            [
                log_errors(&a.before, q),
                log_errors(&a.after, q),
                log_errors(&b.after, q),
                log_errors(&a.naive, q),
            ]
        })
        .collect();
    let looks = [
        ("thesis model", PALETTE[1], Style::Solid),
        ("re-identified", PALETTE[0], Style::Solid),
        ("explained", PALETTE[2], Style::Solid),
        ("nothing moves on", PALETTE[3], Style::Dashed),
    ];
    let labels = ["log10 of the error (m)", "log10 of the error (m/s)", "log10 of the error (rad)"];
    let panels: Vec<Panel> = (0..QUANTITIES.len())
        .map(|q| Panel {
            title: QUANTITIES[q].0,
            x_label: "log10 of the horizon (s)",
            y_label: labels[q],
            series: curves[q]
                .iter()
                .zip(looks)
                .map(|(y, (label, color, style))| Series { label, x: &x, y, style, color })
                .collect(),
            ..Panel::default()
        })
        .collect();
    chart(&panels, 3, "Test flights, from the commands alone")
}

fn specific_force(report: &RecordedReport) -> Result<String, PictureError> {
    let recorded = &report.test.recorded[0];
    let forces: Vec<(&str, [u8; 3], force::SpecificForce)> = [
        ("re-identified", PALETTE[1], &report.again, &recorded.flight),
        ("explained", PALETTE[2], &report.explained, &report.judged_trim[0]),
    ]
    .into_iter()
    .filter_map(|(label, color, at, flight)| Some((label, color, cut(force::force(flight, at)?))))
    .collect();
    let mut panels = Vec::new();
    for (label, color, force) in &forces {
        let measured = Series {
            label: "measured",
            x: &force.t_s,
            y: &force.measured_mps2,
            style: Style::Solid,
            color: PALETTE[0],
        };
        let predicted =
            Series { label, x: &force.t_s, y: &force.predicted_mps2, style: Style::Solid, color: *color };
        panels.push(Panel {
            title: label,
            x_label: "time (s)",
            y_label: "vertical specific force (m/s^2)",
            series: vec![measured, predicted],
            ..Panel::default()
        });
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
