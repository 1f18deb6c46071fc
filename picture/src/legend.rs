//! Legends in rows above the plot, where they cover no data.

use crate::color::Color;
use crate::drawing::{Anchor, Drawing, Look, Pen, Point};
use crate::font::width_em;
use crate::panel::Style;

pub(crate) const ROW_PX: f64 = 18.0;
/// Opacity of bands, in the legend and in the plot.
pub(crate) const BAND_OPACITY: f32 = 0.16;
const SIZE_PX: f64 = 12.0;
const SAMPLE_PX: f64 = 24.0;
const GAP_PX: f64 = 6.0;
const SPACE_PX: f64 = 18.0;

/// A label with the looks of the series that it names.
pub(crate) type Entry<'a> = (&'a str, Style, Color);

/// A legend that is so wide.
pub(crate) struct Legend<'a> {
    entries: Vec<Entry<'a>>,
    /// Left edge and row of every entry.
    places: Vec<(f64, usize)>,
    width: f64,
}

impl<'a> Legend<'a> {
    /// Lays out all entries that have a label.
    pub(crate) fn new(entries: impl Iterator<Item = Entry<'a>>, width: f64) -> Self {
        let entries: Vec<Entry> = entries.filter(|(label, ..)| !label.is_empty()).collect();
        let (mut x, mut row) = (0.0, 0);
        let mut places = Vec::with_capacity(entries.len());
        for (label, ..) in &entries {
            let needed = SAMPLE_PX + GAP_PX + SIZE_PX * width_em(label, false);
            if x > 0.0 && x + needed > width {
                (x, row) = (0.0, row + 1);
            }
            places.push((x, row));
            x += needed + SPACE_PX;
        }
        Self { entries, places, width }
    }

    pub(crate) fn height(&self) -> f64 {
        self.places.last().map_or(0.0, |(_, row)| ROW_PX * (row + 1) as f64)
    }

    /// Draws the legend with its lower left corner at a point.
    pub(crate) fn draw(&self, drawing: &mut Drawing, [left, bottom]: Point) {
        let top = bottom - self.height();
        for ((label, style, color), (x, row)) in self.entries.iter().zip(&self.places) {
            let at = [left + x, top + (*row as f64 + 0.5) * ROW_PX];
            sample(drawing, *style, *color, at);
            let start = [at[0] + SAMPLE_PX + GAP_PX, at[1]];
            drawing.text(label, start, SIZE_PX, Look::Plain, Anchor::Start, left + self.width - start[0]);
        }
    }
}

fn sample(drawing: &mut Drawing, style: Style, color: Color, [left, y]: Point) {
    let (middle, right) = (left + 0.5 * SAMPLE_PX, left + SAMPLE_PX);
    let (pen, points) = match style {
        Style::Solid => (Pen::Line(2.0), vec![[left, y], [right, y]]),
        Style::Dashed => (Pen::Dashes(2.0), vec![[left, y], [right, y]]),
        Style::Level => (Pen::Dashes(1.2), vec![[left, y], [right, y]]),
        Style::Step => {
            (Pen::Line(2.0), vec![[left, y + 4.0], [middle, y + 4.0], [middle, y - 4.0], [right, y - 4.0]])
        }
        Style::Points => (Pen::Dots(4.0), [-8.0, 0.0, 8.0].map(|x| [middle + x, y]).to_vec()),
        Style::Band => {
            let corners = [[left, y - 5.0], [right, y - 5.0], [right, y + 5.0], [left, y + 5.0]];
            (Pen::Fill(BAND_OPACITY), corners.to_vec())
        }
    };
    drawing.draw(&points, pen, color);
}
