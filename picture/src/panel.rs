//! Panels of a chart as a caller states them, and their checks.

use std::borrow::Borrow;
use std::ops::Range;

use crate::PictureError;
use crate::axis::{Axis, bounds, opened};
use crate::color::Color;
use crate::error::within;

/// Values whose size exceeds this cannot be laid out without overflowing.
const LARGEST: f64 = 1e300;
/// Room that a number takes on the x axis and on the y axis.
const NUMBER_PX: [f64; 2] = [52.0, 25.0];
/// Numbers on the axes of a small plot, about.
const LEAST_NUMBERS: f64 = 5.0;

/// Style of a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Style {
    /// A shaded range between the lowest and the highest y, over the whole width, such as a tolerance.
    Band,
    /// A thin dashed line at each y, over the whole width, such as a limit.
    Level,
    /// A continuous line.
    #[default]
    Solid,
    /// A dashed line.
    Dashed,
    /// Each value constant until the next one, like a command.
    Step,
    /// Dots, not joined.
    Points,
}

impl Style {
    /// Returns whether the series spans the whole width, behind the curves.
    pub(crate) fn is_behind(self) -> bool {
        matches!(self, Style::Band | Style::Level)
    }
}

#[derive(Debug, Clone)]
pub(crate) struct Series {
    pub(crate) style: Style,
    pub(crate) color: Color,
    pub(crate) label: String,
    pub(crate) x: Vec<f64>,
    pub(crate) y: Vec<f64>,
}

#[derive(Debug, Clone, Default)]
enum Scale {
    #[default]
    Linear,
    Log,
    Categories(Vec<String>),
}

/// One pair of axes with its curves.
#[derive(Debug, Clone, Default)]
pub struct Panel {
    pub(crate) title: String,
    pub(crate) labels: [String; 2],
    pub(crate) series: Vec<Series>,
    scale: Scale,
    limits: [Option<[f64; 2]>; 2],
    cut: Option<[f64; 2]>,
}

impl Panel {
    /// Axes without curves. A label is a quantity and its unit, for example `time (s)` and `height (m)`.
    pub fn new(x_label: impl Into<String>, y_label: impl Into<String>) -> Self {
        Panel { labels: [x_label.into(), y_label.into()], ..Panel::default() }
    }

    /// Sets the heading.
    #[must_use]
    pub fn title(mut self, title: impl Into<String>) -> Self {
        self.title = title.into();
        self
    }

    /// Adds a curve before those that are there. With an empty label it has no entry in the legend.
    #[must_use]
    pub fn curve(
        mut self,
        style: Style,
        color: Color,
        label: impl Into<String>,
        x: impl IntoIterator<Item: Borrow<f64>>,
        y: impl IntoIterator<Item: Borrow<f64>>,
    ) -> Self {
        let x = x.into_iter().map(|x| *x.borrow()).collect();
        let y = y.into_iter().map(|y| *y.borrow()).collect();
        self.series.push(Series { style, color, label: label.into(), x, y });
        self
    }

    /// Shades the range between two values behind the curves.
    #[must_use]
    pub fn band(self, color: Color, label: &str, edges: [f64; 2]) -> Self {
        self.curve(Style::Band, color, label, [0.0; 0], edges)
    }

    /// Draws a thin dashed line at a value behind the curves.
    #[must_use]
    pub fn level(self, color: Color, label: &str, y: f64) -> Self {
        self.curve(Style::Level, color, label, [0.0; 0], [y])
    }

    /// Makes x logarithmic, as the frequencies of a Bode plot.
    #[must_use]
    pub fn log_x(mut self) -> Self {
        self.scale = Scale::Log;
        self
    }

    /// Puts names side by side along x: the first at 0, the next at 1.
    #[must_use]
    pub fn categories<T: Into<String>>(mut self, names: impl IntoIterator<Item = T>) -> Self {
        self.scale = Scale::Categories(names.into_iter().map(Into::into).collect());
        self
    }

    /// Shows exactly this range of x; curves are cut at its ends.
    #[must_use]
    pub fn x_limits(mut self, limits: [f64; 2]) -> Self {
        self.limits[0] = Some(limits);
        self
    }

    /// Shows exactly this range of y, likewise.
    #[must_use]
    pub fn y_limits(mut self, limits: [f64; 2]) -> Self {
        self.limits[1] = Some(limits);
        self
    }

    /// Cuts curves that leave the span of those that are there already by more than a share of it, or of `least`
    /// where it is smaller.
    #[must_use]
    pub fn cut_around(self, share: f64, least: f64) -> Self {
        let own = self.values();
        let room = share * (own.end - own.start).max(least);
        self.cut_beyond([own.start - room, own.end + room])
    }

    /// Cuts curves beyond these values of y. The axis spans what is left.
    #[must_use]
    pub fn cut_beyond(mut self, edges: [f64; 2]) -> Self {
        self.cut = Some(edges);
        self
    }

    /// Returns whether there is no curve yet, except bands and levels.
    pub fn is_empty(&self) -> bool {
        self.series.iter().all(|series| series.style.is_behind())
    }

    /// Refuses panels without curves, curves without points, and numbers that cannot be placed.
    pub(crate) fn check(&self) -> Result<(), PictureError> {
        if self.is_empty() {
            return Err(PictureError::Empty { what: format!("the panel \"{}\"", self.title) });
        }
        let check = |what: String, values: &[f64], low: f64, high: f64| {
            values.iter().enumerate().try_for_each(|(i, value)| within(&what, i, &[*value], low, high))
        };
        let (low, high) = match &self.scale {
            Scale::Linear => (-LARGEST, LARGEST),
            Scale::Log => (f64::MIN_POSITIVE, LARGEST),
            Scale::Categories(names) => (-0.5, names.len() as f64 - 0.5),
        };
        for Series { style, label, x, y, .. } in &self.series {
            if x.len() != y.len() && !style.is_behind() {
                return Err(PictureError::LengthMismatch { label: label.clone(), x: x.len(), y: y.len() });
            }
            if y.is_empty() {
                return Err(PictureError::Empty { what: format!("series \"{label}\"") });
            }
            check(format!("series \"{label}\": x"), x, low, high)?;
            check(format!("series \"{label}\": y"), y, -LARGEST, LARGEST)?;
        }
        let limits = [("x", self.limits[0], low), ("y", self.limits[1], -LARGEST), ("y", self.cut, -LARGEST)];
        for (axis, limits, low) in limits {
            let Some([first, last]) = limits else { continue };
            let what = format!("the {axis} limits of \"{}\"", self.title);
            check(what.clone(), &[first, last], low, LARGEST)?;
            within(&what, 1, &[last], first.next_up(), LARGEST)?;
        }
        Ok(())
    }

    fn values(&self) -> Range<f64> {
        bounds(self.series.iter().flat_map(|series| series.y.iter().copied()))
    }

    /// The axes of a plot of that size: x spans the curves, y also bands and levels, with some room above and
    /// below.
    pub(crate) fn axes(&self, size_px: [f64; 2]) -> [Axis; 2] {
        let [numbers_x, numbers_y] = [0, 1].map(|i| (size_px[i] / NUMBER_PX[i]).max(LEAST_NUMBERS) as usize);
        let along = self.series.iter().flat_map(|series| series.x.iter().copied());
        let x = self.limits[0].map_or_else(|| bounds(along), |[low, high]| low..high);
        let x = match &self.scale {
            Scale::Linear => Axis::tidy(opened(x), numbers_x),
            Scale::Log => Axis::decades(opened(x.start.log10()..x.end.log10())),
            Scale::Categories(names) => Axis::categories(names),
        };
        if let Some([low, high]) = self.limits[1] {
            return [x, Axis::exact(low..high, numbers_y)];
        }
        let all = opened(self.values());
        let [low, high] = self.cut.unwrap_or([all.start, all.end]);
        let kept = all.start.max(low)..all.end.min(high);
        let y = if kept.start < kept.end { kept } else { low..high };
        let room = 0.05 * (y.end - y.start);
        [x, Axis::exact(y.start - room..y.end + room, numbers_y)]
    }

    /// Returns the position of an x in the units of the axis.
    pub(crate) fn position(&self, x: f64) -> f64 {
        if matches!(self.scale, Scale::Log) { x.log10() } else { x }
    }
}
