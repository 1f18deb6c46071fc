//! Picture of `crazyflie identify`: per signal the prediction, the autocorrelation of the residuals and their
//! correlation with the input.

use crazyflie_identify::estimate::{Comparison, ResidualTests};
use crazyflie_picture::{Band, PALETTE, Panel, PictureError, Series, Style, chart};

use super::identify_table::by_signal;

/// Label, x, y and looks.
type Curve = (&'static str, Vec<f64>, Vec<f64>, Style, [u8; 3]);

/// The curves of one panel, which borrows them.
struct PanelData {
    title: String,
    x_label: &'static str,
    y_label: String,
    curves: Vec<Curve>,
    bound: Option<f64>,
}

/// A row of three panels per signal and part; of several logs the first one's prediction, and the
/// correlations of all.
pub(super) fn draw(fit: &[Comparison], test: &[Comparison]) -> Result<String, PictureError> {
    let mut panel_data = Vec::new();
    for (part, all) in [("fit", fit), ("test", test)] {
        for (signal, group) in by_signal(all) {
            panel_data.extend(row(part, signal, &group));
        }
    }
    let panels: Vec<Panel> = panel_data.iter().map(PanelData::panel).collect();
    chart(&panels, 3, "measured and predicted, and what the residuals say")
}

fn row(part: &str, signal: &str, group: &[&Comparison]) -> Vec<PanelData> {
    let first = group[0];
    let (scale, unit) =
        if first.unit == "rad" { (180.0 / std::f64::consts::PI, "deg") } else { (1.0, first.unit) };
    let values = |signal: &[f64]| signal.iter().map(|v| v * scale).collect::<Vec<f64>>();
    let mut panel_data = vec![PanelData {
        title: format!("{part}: {}", first.log),
        x_label: "time (s)",
        y_label: format!("{signal} ({unit})"),
        curves: vec![
            ("measured", first.t_s.clone(), values(&first.measured), Style::Solid, PALETTE[4]),
            ("predicted", first.t_s.clone(), values(&first.predicted), Style::Solid, PALETTE[0]),
        ],
        bound: None,
    }];
    let tests = ResidualTests::new(group, 0);
    if let Ok(w) = &tests.whiteness {
        let lags: Vec<f64> = (1..=w.correlation.len()).map(|lag| lag as f64).collect();
        panel_data.push(correlation(
            "autocorrelation of the residuals",
            format!("{part}: {signal}"),
            lags,
            &w.correlation,
            w.bound,
        ));
    }
    if let Ok(i) = &tests.independence {
        let lags = i.lags.iter().map(|lag| *lag as f64).collect();
        panel_data.push(correlation(
            "correlation with the input before (+)",
            format!("{part}: {signal}"),
            lags,
            &i.correlation,
            i.bound,
        ));
    }
    // what cannot be tested leaves no hole in the grid
    while panel_data.len() < 3 {
        let flat = ("not tested", vec![0.0, 1.0], vec![0.0, 0.0], Style::Dashed, PALETTE[4]);
        panel_data.push(PanelData {
            title: String::new(),
            x_label: "lag (samples)",
            y_label: String::new(),
            curves: vec![flat],
            bound: None,
        });
    }
    panel_data
}

fn correlation(y_label: &str, title: String, lags: Vec<f64>, values: &[f64], bound: f64) -> PanelData {
    let curves = vec![("", lags, values.to_vec(), Style::Points, PALETTE[0])];
    PanelData { title, x_label: "lag (samples)", y_label: y_label.to_owned(), curves, bound: Some(bound) }
}

impl PanelData {
    fn panel(&self) -> Panel<'_> {
        let series = self.curves.iter().map(|(label, x, y, style, color)| Series {
            label,
            x,
            y,
            style: *style,
            color: *color,
        });
        let band =
            self.bound.map(|bound| Band { label: "99 %", low: -bound, high: bound, color: PALETTE[2] });
        Panel {
            title: &self.title,
            x_label: self.x_label,
            y_label: &self.y_label,
            series: series.collect(),
            bands: band.into_iter().collect(),
            ..Panel::default()
        }
    }
}
