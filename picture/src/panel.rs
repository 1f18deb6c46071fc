//! Panels of a chart, and their checks.

use crate::PictureError;
use crate::legend::{Entry, Sample};
use crate::scale::Scale;
use crate::sheet::Style;

/// Values whose size exceeds this cannot be laid out without overflowing.
const LARGEST: f64 = 1e300;

/// One curve.
#[derive(Debug, Clone, Copy)]
pub struct Series<'a> {
    /// Name in the legend; an empty one has no entry.
    pub label: &'a str,
    /// Horizontal values, in the unit that the panel's `x_label` names.
    pub x: &'a [f64],
    /// Vertical values, as many as `x`, in the unit that the panel's `y_label` names.
    pub y: &'a [f64],
    /// How the points are joined.
    pub style: Style,
    /// RGB, preferably from [`PALETTE`](crate::PALETTE).
    pub color: [u8; 3],
}

/// A shaded range of y over the whole width, such as a tolerance.
#[derive(Debug, Clone, Copy)]
pub struct Band<'a> {
    /// Name in the legend; an empty one has no entry.
    pub label: &'a str,
    /// One edge, in the unit of y.
    pub low: f64,
    /// The other edge.
    pub high: f64,
    /// RGB; drawn translucent.
    pub color: [u8; 3],
}

/// A thin dashed line at one y over the whole width, such as a limit.
#[derive(Debug, Clone, Copy)]
pub struct HLine<'a> {
    /// Name in the legend; an empty one has no entry.
    pub label: &'a str,
    /// Height, in the unit of y.
    pub y: f64,
    /// RGB.
    pub color: [u8; 3],
}

/// One pair of axes with its curves.
#[derive(Debug, Clone, Default)]
pub struct Panel<'a> {
    /// Heading of the panel; may be empty.
    pub title: &'a str,
    /// Quantity and unit of x, for example `time (s)`.
    pub x_label: &'a str,
    /// Quantity and unit of y, for example `height (m)`.
    pub y_label: &'a str,
    /// The curves, at least one; later ones are drawn over earlier ones.
    pub series: Vec<Series<'a>>,
    /// Shaded ranges behind the curves.
    pub bands: Vec<Band<'a>>,
    /// Horizontal lines behind the curves.
    pub hlines: Vec<HLine<'a>>,
    /// What the x axis counts.
    pub x_scale: Scale<'a>,
    /// Lowest and highest x that is shown, in place of that of the curves, which are cut there.
    pub x_limits: Option<[f64; 2]>,
    /// Lowest and highest y that is shown, likewise.
    pub y_limits: Option<[f64; 2]>,
}

/// The entries of the legend.
pub(crate) fn entries<'p>(panel: &'p Panel) -> Vec<Entry<'p>> {
    let series = panel.series.iter().map(|s| (s.label, s.color, Sample::Line(s.style)));
    let levels = panel.hlines.iter().map(|h| (h.label, h.color, Sample::Level));
    let bands = panel.bands.iter().map(|b| (b.label, b.color, Sample::Band));
    let all = series.chain(levels).chain(bands).filter(|(label, _, _)| !label.is_empty());
    all.map(|(label, color, sample)| Entry { label, color, sample }).collect()
}

/// Refuses panels without curves, curves without points, and numbers that cannot be placed.
pub(crate) fn check(panel: &Panel) -> Result<(), PictureError> {
    if panel.series.is_empty() {
        return Err(PictureError::Empty { what: format!("the panel \"{}\"", panel.title) });
    }
    for series in &panel.series {
        let (label, x, y) = (series.label.to_owned(), series.x.len(), series.y.len());
        if x != y {
            return Err(PictureError::LengthMismatch { label, x, y });
        }
        if x == 0 {
            return Err(PictureError::Empty { what: format!("series \"{label}\"") });
        }
        finite(&format!("series \"{label}\": x"), series.x, LARGEST)?;
        panel.x_scale.check(&format!("series \"{label}\": x"), series.x)?;
        finite(&format!("series \"{label}\": y"), series.y, LARGEST)?;
    }
    for (axis, limits) in [("x", panel.x_limits), ("y", panel.y_limits)] {
        let Some([low, high]) = limits else { continue };
        let what = format!("the {axis} limits of \"{}\"", panel.title);
        finite(&what, &[low, high], LARGEST)?;
        if low >= high {
            return Err(PictureError::OutOfRange { what, index: 1, value: high, low, high: LARGEST });
        }
    }
    if let Some(limits) = panel.x_limits {
        panel.x_scale.check(&format!("the x limits of \"{}\"", panel.title), &limits)?;
    }
    for band in &panel.bands {
        finite(&format!("band \"{}\"", band.label), &[band.low, band.high], LARGEST)?;
    }
    panel.hlines.iter().try_for_each(|line| finite(&format!("line \"{}\"", line.label), &[line.y], LARGEST))
}

/// Refuses what cannot be laid out; the error names `what` and the index within `values`.
pub(crate) fn finite(what: &str, values: &[f64], largest: f64) -> Result<(), PictureError> {
    let accepted = |value: &f64| value.abs() <= largest;
    let Some(index) = values.iter().position(|value| !accepted(value)) else {
        return Ok(());
    };
    let (what, value) = (what.to_owned(), values[index]);
    if !value.is_finite() {
        return Err(PictureError::NonFinite { what, index });
    }
    Err(PictureError::OutOfRange { what, index, value, low: -largest, high: largest })
}
