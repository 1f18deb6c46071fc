//! Step responses of the loops, one panel each.

use crazyflie_control::loop_analysis::LoopAxis;
use crazyflie_picture::{BLACK, BLUE, Drawing, GREEN, Panel, PictureError, Style, VERMILION, chart};

use crazyflie_server::tune::{GainComparison, Response};

/// # Errors
/// Those of drawing.
pub(crate) fn picture(comparisons: &[GainComparison], title: &str) -> Result<Drawing, PictureError> {
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
