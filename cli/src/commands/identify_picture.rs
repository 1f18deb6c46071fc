//! Picture of `crazyflie identify`: per signal the prediction, the autocorrelation of the residuals and their
//! correlation with the input.

use crazyflie_identify::estimate::{Comparison, ResidualTests};
use crazyflie_picture::{BLACK, BLUE, Drawing, GREEN, Panel, PictureError, Style, chart};

use super::identify_table::by_signal;

/// A row of three panels per signal and part; of several logs the first one's prediction, and the
/// correlations of all.
pub(super) fn draw(fit: &[Comparison], test: &[Comparison]) -> Result<Drawing, PictureError> {
    let mut panels = Vec::new();
    for (part, all) in [("fit", fit), ("test", test)] {
        for (signal, group) in by_signal(all) {
            panels.extend(row(part, signal, &group));
        }
    }
    chart(&panels, 3, "measured and predicted, and what the residuals say")
}

fn row(part: &str, signal: &str, group: &[&Comparison]) -> [Panel; 3] {
    let first = group[0];
    let (scale, unit) = if first.unit == "rad" { (1.0_f64.to_degrees(), "deg") } else { (1.0, first.unit) };
    let prediction = Panel::new("time (s)", format!("{signal} ({unit})"))
        .title(format!("{part}: {}", first.log))
        .curve(Style::Solid, BLACK, "measured", &first.t_s, first.measured.iter().map(|v| v * scale))
        .curve(Style::Solid, BLUE, "predicted", &first.t_s, first.predicted.iter().map(|v| v * scale));
    let correlation = |labels: [&str; 2], tested: Option<(Vec<f64>, &[f64], f64)>| {
        let [x_label, y_label] = labels;
        let panel = Panel::new(x_label, y_label).title(format!("{part}: {signal}, residuals"));
        match tested {
            // no hole in the grid
            None => panel.curve(Style::Dashed, BLACK, "not tested", [0.0, 1.0], [0.0, 0.0]),
            Some((lags, values, bound)) => {
                panel.curve(Style::Points, BLUE, "", lags, values).band(GREEN, "99 %", [-bound, bound])
            }
        }
    };
    let tests = ResidualTests::new(group, 0);
    let whiteness = tests.whiteness.as_ref().ok().map(|w| {
        let lags = (1..=w.correlation.len()).map(|lag| lag as f64).collect();
        (lags, &w.correlation[..], w.bound)
    });
    let independence = tests.independence.as_ref().ok().map(|i| {
        let lags = i.lags.iter().map(|lag| *lag as f64).collect();
        (lags, &i.correlation[..], i.bound)
    });
    [
        prediction,
        correlation(["lag (samples)", "autocorrelation (1)"], whiteness),
        correlation(["lag (samples), + of the input before", "correlation with the input (1)"], independence),
    ]
}
