//! Legends in rows above the plot, where they cover no data.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use crate::PictureError;
use crate::sheet::{Area, Style, dot, fit, font, line, polygon, rgb, stroke, text, text_width};

pub(crate) const ROW_PX: f64 = 18.0;
const SIZE_PX: f64 = 12.0;
const SAMPLE_PX: f64 = 24.0;
const GAP_PX: f64 = 6.0;
const SPACE_PX: f64 = 18.0;

/// The style of the sample beside a label.
#[derive(Clone, Copy)]
pub(crate) enum Sample {
    Line(Style),
    Level,
    Band,
}

pub(crate) struct Entry<'a> {
    pub(crate) label: &'a str,
    pub(crate) color: [u8; 3],
    pub(crate) sample: Sample,
}

/// Left edge and row of every entry in a legend `width` wide.
fn places(entries: &[Entry], width: f64) -> Vec<(f64, usize)> {
    let (mut x, mut row) = (0.0, 0);
    let mut places = Vec::with_capacity(entries.len());
    for entry in entries {
        let needed = SAMPLE_PX + GAP_PX + text_width(entry.label, SIZE_PX);
        if x > 0.0 && x + needed > width {
            (x, row) = (0.0, row + 1);
        }
        places.push((x, row));
        x += needed + SPACE_PX;
    }
    places
}

/// Number of rows the legend takes.
pub(crate) fn rows(entries: &[Entry], width: f64) -> usize {
    places(entries, width).last().map_or(0, |(_, row)| row + 1)
}

/// Draws the legend with its upper left corner at `origin`, all in CSS pixels.
pub(crate) fn draw(
    area: &Area,
    entries: &[Entry],
    origin: (f64, f64),
    width: f64,
) -> Result<(), PictureError> {
    for (entry, (x, row)) in entries.iter().zip(places(entries, width)) {
        let (left, y) = (origin.0 + x, origin.1 + (row as f64 + 0.5) * ROW_PX);
        sample(area, entry, left, y)?;
        let start = left + SAMPLE_PX + GAP_PX;
        let size = fit(entry.label, SIZE_PX, origin.0 + width - start);
        text(area, entry.label, (start, y), font(size, false), HPos::Left)?;
    }
    Ok(())
}

fn sample(area: &Area, entry: &Entry, left: f64, y: f64) -> Result<(), PictureError> {
    let color = rgb(entry.color);
    let right = left + SAMPLE_PX;
    let middle = 0.5 * (left + right);
    let flat = [(left, y), (right, y)];
    match entry.sample {
        Sample::Line(Style::Solid) => line(area, &flat, stroke(color, 2.0, false)),
        Sample::Line(Style::Dashed) => line(area, &flat, stroke(color, 2.0, true)),
        Sample::Line(Style::Step) => {
            let steps = [(left, y + 4.0), (middle, y + 4.0), (middle, y - 4.0), (right, y - 4.0)];
            line(area, &steps, stroke(color, 2.0, false))
        }
        Sample::Line(Style::Points) => {
            [-8.0, 0.0, 8.0].iter().try_for_each(|shift| dot(area, (middle + shift, y), 2.0, color))
        }
        Sample::Level => line(area, &flat, stroke(color, 1.2, true)),
        Sample::Band => {
            let corners = [(left, y - 5.0), (right, y - 5.0), (right, y + 5.0), (left, y + 5.0)];
            polygon(area, &corners, color.mix(BAND_OPACITY))
        }
    }
}

/// Opacity of bands, in the legend and in the plot.
pub(crate) const BAND_OPACITY: f64 = 0.16;
