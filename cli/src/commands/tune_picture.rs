//! Step responses of the loops, one panel each.

use crazyflie_control::loop_analysis::LoopAxis;
use crazyflie_picture::{PALETTE, Panel, PictureError, Series, Style, chart};

use crazyflie_server::tune::{GainComparison, Response};

/// # Errors
/// Those of drawing.
pub(super) fn picture(comparisons: &[GainComparison], title: &str) -> Result<String, PictureError> {
    let titles: Vec<String> = comparisons.iter().map(heading).collect();
    let scaled: Vec<Vec<[Vec<f64>; 2]>> = comparisons.iter().map(curves).collect();
    let panels: Vec<Panel> = comparisons
        .iter()
        .zip(&titles)
        .zip(&scaled)
        .map(|((t, title), y)| Panel {
            title,
            x_label: "time (s)",
            y_label: label(t.axis),
            series: LOOKS
                .iter()
                .zip(y)
                .map(|((label, style, color), [x, y])| Series {
                    label,
                    x,
                    y,
                    style: *style,
                    color: PALETTE[*color],
                })
                .collect(),
            y_limits: Some(limits(t)),
            ..Panel::default()
        })
        .collect();
    chart(&panels, 2, title)
}

const LOOKS: [(&str, Style, usize); 4] = [
    ("set-point", Style::Dashed, 4),
    ("crazyflie_ros", Style::Solid, 1),
    ("table 7.1", Style::Solid, 0),
    ("tuned", Style::Solid, 2),
];

fn heading(t: &GainComparison) -> String {
    let phase = |deg: f64| if deg.is_finite() { format!("{deg:.0}") } else { "-".into() };
    let [stock, thesis, found] = [&t.stock, &t.thesis, &t.found].map(|d| phase(d.margins.phase_deg));
    format!("{}: phase margin {stock}, {thesis}, {found} deg", t.axis.name())
}

fn label(axis: LoopAxis) -> &'static str {
    match axis {
        LoopAxis::X => "x (m)",
        LoopAxis::Y => "y (m)",
        LoopAxis::Z => "z (m)",
        LoopAxis::Yaw => "yaw (deg)",
    }
}

/// Set-point and responses as far as they were flown, in the unit of the axis.
fn curves(t: &GainComparison) -> Vec<[Vec<f64>; 2]> {
    let unit = unit(t.axis);
    let in_unit = |r: &Response, values: &[f64]| {
        [r.t_s[..values.len()].to_vec(), values.iter().map(|v| unit * v).collect()]
    };
    let flown = [&t.stock, &t.thesis, &t.found].map(|e| in_unit(&e.response, &e.response.value));
    [in_unit(&t.found.response, &t.found.response.target)].into_iter().chain(flown).collect()
}

/// Twice the set-point's range: an unstable response leaves the picture there, and the others can be seen.
fn limits(t: &GainComparison) -> [f64; 2] {
    let target = &t.found.response.target;
    let low = target.iter().copied().fold(f64::INFINITY, f64::min);
    let high = target.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let room = (high - low).max(0.1);
    [low - room, high + room].map(|value| unit(t.axis) * value)
}

fn unit(axis: LoopAxis) -> f64 {
    if axis == LoopAxis::Yaw { 1.0_f64.to_degrees() } else { 1.0 }
}
