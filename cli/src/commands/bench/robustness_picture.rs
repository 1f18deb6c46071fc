//! The picture of `crazyflie bench robustness`.

use crazyflie_picture::{PALETTE, Panel, PictureError, Scale, Series, Style, chart};

use crazyflie_bench::robustness::{CONDITIONS, RobustnessRow};

/// Per scenario: scores with their intervals, and the first nominal flight; a colour per controller.
///
/// # Errors
/// Those of drawing.
pub(super) fn picture(lines: &[RobustnessRow]) -> Result<String, PictureError> {
    let controllers = names(lines, |l| &l.controller);
    let conditions = CONDITIONS.each_ref().map(|condition| condition.name);
    let scenarios: Vec<(&str, Vec<ScoreCurve>)> = names(lines, |l| &l.scenario)
        .into_iter()
        .map(|scenario| {
            (
                scenario,
                controllers
                    .iter()
                    .enumerate()
                    .map(|(i, c)| curve(lines, scenario, c, i, controllers.len()))
                    .collect(),
            )
        })
        .collect();
    let panels: Vec<Panel> = scenarios
        .iter()
        .flat_map(|(scenario, curves)| {
            [scores(scenario, &conditions, &controllers, curves), flights(scenario, lines)]
        })
        .collect();
    chart(&panels, 2, "Score and 95 % interval under each condition; beside it the first nominal flight")
}

/// Distances over time.
fn flights<'a>(scenario: &'a str, lines: &'a [RobustnessRow]) -> Panel<'a> {
    let nominal = lines
        .iter()
        .filter(|l| l.scenario == scenario && l.condition == CONDITIONS[0].name && !l.first[0].is_empty());
    let series = nominal.enumerate().map(|(i, l)| Series {
        label: &l.controller,
        x: &l.first[0],
        y: &l.first[1],
        style: Style::Solid,
        color: PALETTE[i % PALETTE.len()],
    });
    Panel {
        title: scenario,
        x_label: "time (s)",
        y_label: "distance to the set-point (m)",
        series: series.collect(),
        ..Panel::default()
    }
}

/// Points of one controller, and its intervals from below to above.
struct ScoreCurve {
    x: Vec<f64>,
    y: Vec<f64>,
    intervals: Vec<([f64; 2], [f64; 2])>,
}

fn names<'a>(lines: &'a [RobustnessRow], name_of: impl Fn(&'a RobustnessRow) -> &'a String) -> Vec<&'a str> {
    let mut all: Vec<&str> = Vec::new();
    for name in lines.iter().map(name_of).map(String::as_str) {
        if !all.contains(&name) {
            all.push(name);
        }
    }
    all
}

fn curve(
    lines: &[RobustnessRow],
    scenario: &str,
    controller: &str,
    place: usize,
    controllers: usize,
) -> ScoreCurve {
    let own: Vec<&RobustnessRow> =
        lines.iter().filter(|l| l.scenario == scenario && l.controller == controller).collect();
    // side by side, so that intervals can be told apart
    let aside = 0.06 * (place as f64 - 0.5 * (controllers.saturating_sub(1)) as f64);
    let x: Vec<f64> = (0..own.len()).map(|i| i as f64 + aside).collect();
    let intervals = x.iter().zip(&own).map(|(x, l)| ([*x, *x], [l.low, l.high])).collect();
    ScoreCurve { y: own.iter().map(|l| l.score).collect(), x, intervals }
}

fn scores<'a>(
    scenario: &'a str,
    conditions: &'a [&'a str],
    controllers: &[&'a str],
    curves: &'a [ScoreCurve],
) -> Panel<'a> {
    let mut series = Vec::new();
    for (i, (label, curve)) in controllers.iter().zip(curves).enumerate() {
        let color = PALETTE[i % PALETTE.len()];
        let all = curve.intervals.iter().map(|(x, y)| Series { label: "", x, y, style: Style::Solid, color });
        series.extend(all);
        series.push(Series { label, x: &curve.x, y: &curve.y, style: Style::Points, color });
    }
    let x_scale = Scale::Categories(conditions);
    Panel { title: scenario, x_label: "condition", y_label: "score", series, x_scale, ..Panel::default() }
}
