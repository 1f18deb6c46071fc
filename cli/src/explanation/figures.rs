//! The pictures of the page: panels of one size, which the page sets in as many columns as its reader has
//! room for.

use crazyflie_identify::explain::verdict::Explanation;
use crazyflie_identify::fit::flight::Flight;
use crazyflie_identify::fit::hypothesis::Hypothesis;
use crazyflie_picture::{Band, PALETTE, Panel, PictureError, Series, Style, chart};
use serde::Serialize;

use super::series::{Curve, SHOWN, Whiteness, channel, liveliest, predict, whiteness, without_disturbances};

/// Length of the free run that is shown: longer ones leave any frame.
const FREE_S: f64 = 6.0;
const COLUMNS: usize = 3;
const BEFORE: [u8; 3] = PALETTE[1];
const AFTER: [u8; 3] = PALETTE[0];
const MEASURED: [u8; 3] = [90, 96, 104];

/// A sheet of panels, drawn once, and the parts of it that are the panels.
#[derive(Debug, Serialize)]
pub(super) struct Figure {
    pub id: &'static str,
    pub svg: String,
    pub tiles: Vec<String>,
    /// Width over height of a tile.
    pub aspect: String,
}

/// A curve that is ready to be drawn.
struct StyledCurve {
    label: &'static str,
    curve: Curve,
    color: [u8; 3],
}

/// One pair of axes: its label, its curves, and the half width of a band around zero.
type Axes = (String, Vec<StyledCurve>, Option<f64>);

fn figure(id: &'static str, x_label: &str, axes: &[Axes]) -> Result<Figure, PictureError> {
    let band =
        |b: &f64| Band { label: "99 % of an independent series", low: -b, high: *b, color: PALETTE[2] };
    let mut panels = Vec::new();
    for (y_label, lines, bound) in axes {
        let (series, bands) = (lines.iter().map(series).collect(), bound.iter().map(band).collect());
        panels.push(Panel { x_label, y_label, series, bands, ..Panel::default() });
    }
    let svg = chart(&panels, COLUMNS, "")?;
    let [width, height] = size(&svg);
    let rows = panels.len().div_ceil(COLUMNS);
    let (wide, high) = (width / COLUMNS as f64, height / rows as f64);
    let tile =
        |i: usize| format!("{} {} {wide} {high}", (i % COLUMNS) as f64 * wide, (i / COLUMNS) as f64 * high);
    let tiles = (0..panels.len()).map(tile).collect();
    // within a page the name space goes without saying
    let svg = svg.replacen(" xmlns=\"http://www.w3.org/2000/svg\"", "", 1).replacen(
        "<svg ",
        &format!("<svg id=\"{id}\" "),
        1,
    );
    let svg = svg.trim_start_matches(|c| c != '<').to_owned();
    Ok(Figure { id, svg, tiles, aspect: format!("{wide} / {high}") })
}

fn series(line: &StyledCurve) -> Series<'_> {
    Series { label: line.label, x: &line.curve.x, y: &line.curve.y, style: Style::Solid, color: line.color }
}

/// Width and height that a document gives itself.
fn size(svg: &str) -> [f64; 2] {
    ["width", "height"].map(|name| {
        let after = svg.split_once(&format!("{name}=\"")).map_or("", |(_, rest)| rest);
        after.split_once('"').and_then(|(number, _)| number.parse().ok()).unwrap_or(1.0)
    })
}

/// The pieces of curves that lie within a frame.
fn pieces(label: &'static str, color: [u8; 3], curves: &[Curve], [low, high]: [f64; 2]) -> Vec<StyledCurve> {
    let mut all: Vec<StyledCurve> = Vec::new();
    for curve in curves {
        let mut inside = false;
        for (x, y) in curve.x.iter().zip(&curve.y) {
            let now = (low..=high).contains(y);
            if now && !inside {
                let label = if all.is_empty() { label } else { "" };
                all.push(StyledCurve { label, curve: Curve::default(), color });
            }
            if let Some(line) = all.last_mut().filter(|_| now) {
                line.curve.x.push(*x);
                line.curve.y.push(*y);
            }
            inside = now;
        }
    }
    all
}

fn label(at: usize) -> String {
    let (name, unit, _) = channel(at);
    format!("{name} ({unit})")
}

/// The test flight whose liveliest stretch is the liveliest.
pub(super) fn liveliest_flight(flights: &[Flight]) -> Option<&Flight> {
    flights.iter().max_by(|a, b| liveliest(a, FREE_S).0.total_cmp(&liveliest(b, FREE_S).0))
}

/// A free run from the start of a lively stretch, beside what was measured.
pub(super) fn free_run(found: &Explanation, flight: &Flight) -> Result<Option<Figure>, PictureError> {
    let (_, stretch) = liveliest(flight, FREE_S);
    let prediction = |h: &Hypothesis| predict(&without_disturbances(h), flight, stretch.clone());
    let (Some(before), Some(after)) = (prediction(&found.declared), prediction(&found.completed)) else {
        return Ok(None);
    };
    let panel = |at: usize| {
        let ([measured, first], [_, second]) = (&before[at], &after[at]);
        let (low, high) =
            measured.y.iter().fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(*v), high.max(*v)));
        // the measured span to each side, and at least a little
        let room = (high - low).max(if at < 3 { 2.0 } else { 0.1 });
        let mut lines = vec![StyledCurve { label: "measured", curve: measured.clone(), color: MEASURED }];
        lines.extend(pieces("declared", BEFORE, std::slice::from_ref(first), [low - room, high + room]));
        lines.extend(pieces("completed", AFTER, std::slice::from_ref(second), [low - room, high + room]));
        (label(at), lines, None)
    };
    let panels: Vec<_> = SHOWN.into_iter().filter(|at| !before[*at][0].x.is_empty()).map(panel).collect();
    if panels.is_empty() { Ok(None) } else { figure("freerun", "time (s)", &panels).map(Some) }
}

/// Autocorrelation of the innovations, with the numbers behind it.
pub(super) struct WhitenessFigure {
    pub figure: Option<Figure>,
    /// Channel, before and after.
    pub rows: Vec<(usize, Whiteness, Whiteness)>,
}

pub(super) fn white(found: &Explanation, flight: &Flight) -> Result<WhitenessFigure, PictureError> {
    let [first, second] = &found.disturbances;
    let (before, after) = rayon::join(
        || whiteness(&without_disturbances(&found.declared), first, flight),
        || whiteness(&without_disturbances(&found.completed), second, flight),
    );
    let (Some(before), Some(after)) = (before, after) else {
        return Ok(WhitenessFigure { figure: None, rows: Vec::new() });
    };
    let shown: Vec<usize> = SHOWN.into_iter().filter(|at| !before[*at].correlation.x.is_empty()).collect();
    let panel = |at: &usize| {
        let line = |label, w: &Whiteness, color| StyledCurve { label, curve: w.correlation.clone(), color };
        let lines = vec![line("declared", &before[*at], BEFORE), line("completed", &after[*at], AFTER)];
        (format!("correlation of {} (1)", channel(*at).0), lines, Some(after[*at].bound))
    };
    let panels: Vec<_> = shown.iter().map(panel).collect();
    let figure = if panels.is_empty() { None } else { Some(figure("white", "lag (s)", &panels)?) };
    let rows = shown.into_iter().map(|at| (at, before[at].clone(), after[at].clone())).collect();
    Ok(WhitenessFigure { figure, rows })
}
