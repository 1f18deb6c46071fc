//! The pictures of the page: panels of one size, which the page sets in as many columns as its reader has
//! room for.

use crazyflie_identify::explain::verdict::Explanation;
use crazyflie_identify::fit::flight::Flight;
use crazyflie_identify::fit::hypothesis::Hypothesis;
use crazyflie_picture::{BLUE, Drawing, GREEN, GREY, Panel, PictureError, Style, VERMILION, tiles};

use super::series::{SHOWN, Whiteness, channel, liveliest, predict, whiteness, without_disturbances};

/// Length of the free run that is shown: longer ones leave any frame.
const FREE_S: f64 = 6.0;

/// Width of a panel and height of its plot.
const TILE_PX: [f64; 2] = [400.0, 200.0];

/// A panel each as SVG; no panels make no figure.
pub(super) fn figure(panels: &[Panel], size_px: [f64; 2]) -> Result<Option<Vec<String>>, PictureError> {
    let drawn = (!panels.is_empty()).then(|| tiles(panels, size_px)).transpose()?;
    Ok(drawn.map(|tiles| tiles.iter().map(Drawing::inline_svg).collect()))
}

/// The test flight whose liveliest stretch is the liveliest.
pub(super) fn liveliest_flight(flights: &[Flight]) -> Option<&Flight> {
    flights.iter().max_by(|a, b| liveliest(a, FREE_S).0.total_cmp(&liveliest(b, FREE_S).0))
}

/// A free run from the start of a lively stretch, beside what was measured.
pub(super) fn free_run(found: &Explanation, flight: &Flight) -> Result<Option<Vec<String>>, PictureError> {
    let (_, stretch) = liveliest(flight, FREE_S);
    let prediction = |h: &Hypothesis| predict(&without_disturbances(h), flight, stretch.clone());
    let (Some(before), Some(after)) = (prediction(&found.declared), prediction(&found.completed)) else {
        return Ok(None);
    };
    let shown = SHOWN.into_iter().filter(|at| !before[*at][0].x.is_empty());
    let panels = shown.map(|at| {
        let ([measured, first], [_, second], (name, unit, _)) = (&before[at], &after[at], channel(at));
        Panel::new("time (s)", format!("{name} ({unit})"))
            .curve(Style::Solid, GREY, "measured", &measured.x, &measured.y)
            // the measured span to each side, and at least a little
            .cut_around(1.0, if at < 3 { 2.0 } else { 0.1 })
            .curve(Style::Solid, VERMILION, "declared", &first.x, &first.y)
            .curve(Style::Solid, BLUE, "completed", &second.x, &second.y)
    });
    figure(&panels.collect::<Vec<_>>(), TILE_PX)
}

/// Autocorrelation of the innovations, with the numbers behind it.
pub(super) struct WhitenessFigure {
    pub figure: Option<Vec<String>>,
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
    let panels = shown.iter().map(|at| {
        let (first, second) = (&before[*at], &after[*at]);
        Panel::new("lag (s)", format!("correlation of {} (1)", channel(*at).0))
            .curve(Style::Solid, VERMILION, "declared", &first.correlation.x, &first.correlation.y)
            .curve(Style::Solid, BLUE, "completed", &second.correlation.x, &second.correlation.y)
            .band(GREEN, "99 % of an independent series", [-second.bound, second.bound])
    });
    let figure = figure(&panels.collect::<Vec<_>>(), TILE_PX)?;
    let rows = shown.into_iter().map(|at| (at, before[at].clone(), after[at].clone())).collect();
    Ok(WhitenessFigure { figure, rows })
}
