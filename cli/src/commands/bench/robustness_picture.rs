//! The picture of `crazyflie bench robustness`.

use crazyflie_bench::conditions::CONDITIONS;
use crazyflie_bench::robustness::RobustnessRow;
use crazyflie_picture::{Drawing, PALETTE, Panel, PictureError, Style, chart};

/// Per scenario: scores with their intervals, and the first nominal flight; a colour per controller.
///
/// # Errors
/// Those of drawing.
pub(super) fn picture(lines: &[RobustnessRow]) -> Result<Drawing, PictureError> {
    let controllers = names(lines, |l| &l.controller);
    let mut panels = Vec::new();
    for scenario in names(lines, |l| &l.scenario) {
        let mut scores = Panel::new("condition", "score (1)")
            .title(scenario)
            .categories(CONDITIONS.each_ref().map(|condition| condition.name));
        let mut flights = Panel::new("time (s)", "distance to the set-point (m)").title(scenario);
        for ((i, controller), color) in controllers.iter().enumerate().zip(PALETTE.into_iter().cycle()) {
            let own = lines.iter().filter(|l| l.scenario == scenario && l.controller == *controller);
            // side by side, so that intervals can be told apart
            let aside = 0.06 * (i as f64 - 0.5 * (controllers.len() - 1) as f64);
            let (mut x, mut y) = (Vec::new(), Vec::new());
            for (condition, l) in own.enumerate() {
                x.push(condition as f64 + aside);
                y.push(l.score);
                scores = scores.curve(Style::Solid, color, "", [x[condition]; 2], [l.low, l.high]);
                if l.condition == CONDITIONS[0].name && !l.first[0].is_empty() {
                    flights = flights.curve(Style::Solid, color, *controller, &l.first[0], &l.first[1]);
                }
            }
            scores = scores.curve(Style::Points, color, *controller, x, y);
        }
        panels.extend([scores, flights]);
    }
    chart(&panels, 2, "Score and 95 % interval under each condition; beside it the first nominal flight")
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
