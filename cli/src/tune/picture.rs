//! Step responses of the loops, one panel each.

use crazyflie_picture::{PALETTE, Panel, PictureError, Series, Style, chart};

use super::{GainComparison, LoopAxis};

/// # Errors
/// Those of drawing.
pub(crate) fn picture(comparisons: &[GainComparison], title: &str) -> Result<String, PictureError> {
    let titles: Vec<String> = comparisons.iter().map(heading).collect();
    let scaled: Vec<Vec<Vec<f64>>> = comparisons.iter().map(curves).collect();
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
                .map(|((label, style, color), y)| Series {
                    label,
                    x: &t.found.response.t_s,
                    y,
                    style: *style,
                    color: PALETTE[*color],
                })
                .collect(),
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

/// Set-point and responses; one that leaves the picture is cut off at twice the set-point's range, so that
/// the others can be seen.
fn curves(t: &GainComparison) -> Vec<Vec<f64>> {
    let unit = if t.axis == LoopAxis::Yaw { 1.0_f64.to_degrees() } else { 1.0 };
    let target = &t.found.response.target;
    let low = target.iter().copied().fold(f64::INFINITY, f64::min);
    let high = target.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let room = (high - low).max(0.1);
    let length = t.found.response.t_s.len();
    let cut = |values: &[f64]| -> Vec<f64> {
        let last = values.last().copied().unwrap_or(0.0);
        (0..length)
            .map(|i| unit * values.get(i).copied().unwrap_or(last).clamp(low - room, high + room))
            .collect()
    };
    vec![
        cut(target),
        cut(&t.stock.response.value),
        cut(&t.thesis.response.value),
        cut(&t.found.response.value),
    ]
}
