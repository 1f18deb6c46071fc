//! An SVG page: sizes in CSS pixels, text that is made to fit, and lines finer than plotters' whole pixels.

use std::fmt::Display;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::PictureError;

/// plotters places everything on whole pixels. The page is laid out this much larger and shown at its proper
/// size, so that curves are smooth.
pub(crate) const FINE: i32 = 4;
/// Name of the typeface; whatever the reader has.
const FAMILY: FontFamily<'static> = FontFamily::Name("Helvetica, Arial, sans-serif");
/// Opacity that stands for "dashed": plotters cannot say `stroke-dasharray`, so [`page`] swaps it in for this
/// value.
const DASHED: f64 = 0.998;
pub(crate) const TEXT: RGBColor = RGBColor(38, 44, 52);
pub(crate) const FAINT: RGBColor = RGBColor(226, 230, 235);
pub(crate) const FRAME: RGBColor = RGBColor(120, 130, 142);

pub(crate) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// The Okabe-Ito colours, told apart by readers with any colour vision; ordered so that the first few differ
/// most in print. Yellow comes last because thin yellow lines fade on white.
pub const PALETTE: [[u8; 3]; 8] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [0, 0, 0],
    [86, 180, 233],
    [230, 159, 0],
    [240, 228, 66],
];

/// How the points of a series are joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Style {
    /// A continuous line.
    #[default]
    Solid,
    /// A dashed line.
    Dashed,
    /// Dots, not joined.
    Points,
    /// Each value held until the next one, as a command is.
    Step,
}

pub(crate) fn svg_error(error: impl Display) -> PictureError {
    PictureError::Svg(error.to_string())
}

pub(crate) fn rgb([r, g, b]: [u8; 3]) -> RGBColor {
    RGBColor(r, g, b)
}

/// CSS pixels to positions on the enlarged page.
pub(crate) fn fine(pixels: f64) -> i32 {
    (pixels * f64::from(FINE)).round() as i32
}

/// Line style of a width in CSS pixels.
pub(crate) fn stroke(color: RGBColor, width: f64, dashed: bool) -> ShapeStyle {
    let color = color.mix(if dashed { DASHED } else { 1.0 });
    ShapeStyle { color, filled: false, stroke_width: fine(width).max(1) as u32 }
}

/// Writes an SVG document of the given size in CSS pixels with a white background.
pub(crate) fn page(
    (width, height): (u32, u32),
    draw: impl FnOnce(&Area) -> Result<(), PictureError>,
) -> Result<String, PictureError> {
    let mut svg = String::new();
    let (wide, high) = (width * FINE as u32, height * FINE as u32);
    {
        let root = SVGBackend::with_string(&mut svg, (wide, high)).into_drawing_area();
        root.fill(&WHITE).map_err(svg_error)?;
        draw(&root)?;
        root.present().map_err(svg_error)?;
    }
    let written = format!("<svg width=\"{wide}\" height=\"{high}\"");
    let wanted = format!("<svg width=\"{width}\" height=\"{height}\" stroke-linejoin=\"round\"");
    let dashes = format!("stroke-dasharray=\"{} {}\"", 6 * FINE, 4 * FINE);
    // Quotes within texts are escaped, so this matches attributes only.
    Ok(svg.replacen(&written, &wanted, 1).replace(&format!("opacity=\"{DASHED}\""), &dashes))
}

/// Estimated width in CSS pixels, after DejaVu Sans: the widest of the usual sans-serif faces, so there is
/// room.
pub(crate) fn text_width(text: &str, size: f64) -> f64 {
    let ems = |character| match character {
        'i' | 'j' | 'l' | 'I' | '\'' | '|' => 0.29,
        ' ' | '.' | ',' | ':' | ';' | '/' => 0.33,
        'f' | 'r' | 't' | '(' | ')' | '[' | ']' | '-' => 0.40,
        'a'..='z' if !matches!(character, 'm' | 'w') => 0.60,
        '0'..='9' => 0.64,
        'm' | 'w' | 'M' | 'W' | '%' | '@' => 0.97,
        _ => 0.74,
    };
    text.chars().map(ems).sum::<f64>() * size
}

/// The font size that makes a text fit into a width, at most `size`.
pub(crate) fn fit(text: &str, size: f64, width: f64) -> f64 {
    // Some texts are bold, and those are wider.
    let wanted = 1.08 * text_width(text, size);
    if wanted > width { size * (width / wanted).max(0.3) } else { size }
}

/// A text style of a font size in CSS pixels.
pub(crate) fn font(size: f64, bold: bool) -> TextStyle<'static> {
    // plotters divides sizes by 1.24 on their way into the file.
    let style = if bold { FontStyle::Bold } else { FontStyle::Normal };
    let font = FontDesc::new(FAMILY, size * 1.24 * f64::from(FINE), style);
    TextStyle::from(font).color(&TEXT)
}

/// Writes a text with its vertical middle at `y`.
pub(crate) fn text(
    area: &Area,
    text: &str,
    (x, y): (f64, f64),
    style: TextStyle,
    anchor: HPos,
) -> Result<(), PictureError> {
    let style = style.pos(Pos::new(anchor, VPos::Center));
    area.draw(&Text::new(text.to_owned(), (fine(x), fine(y)), style)).map_err(svg_error)
}

/// Draws a polyline in CSS pixels.
pub(crate) fn line(area: &Area, points: &[(f64, f64)], style: ShapeStyle) -> Result<(), PictureError> {
    let points: Vec<(i32, i32)> = points.iter().map(|(x, y)| (fine(*x), fine(*y))).collect();
    area.draw(&PathElement::new(points, style)).map_err(svg_error)
}

/// Draws a dot with a radius in CSS pixels.
pub(crate) fn dot(area: &Area, (x, y): (f64, f64), radius: f64, color: RGBColor) -> Result<(), PictureError> {
    area.draw(&Circle::new((fine(x), fine(y)), fine(radius), color.filled())).map_err(svg_error)
}

/// Fills a polygon in CSS pixels.
pub(crate) fn polygon(area: &Area, points: &[(f64, f64)], color: RGBAColor) -> Result<(), PictureError> {
    let points: Vec<(i32, i32)> = points.iter().map(|(x, y)| (fine(*x), fine(*y))).collect();
    area.draw(&Polygon::new(points, color)).map_err(svg_error)
}
