//! Files of drawings: SVG for pages, PNG for slides, PDF for papers.

use std::path::Path;

use pdf_writer::types::{LineCapStyle, LineJoinStyle};
use pdf_writer::{Content, Name, Pdf, Rect, Ref};
use tiny_skia::{Color, FillRule, LineCap, PathSegment, Pixmap, Point, Stroke, Transform};

use crate::PictureError;
use crate::draw::{paint, stroke};
use crate::drawing::{DASH, Drawing, Pen, Shape};

/// Dots of a PNG per CSS pixel: sharp on screens and on slides.
const DOTS_PER_PX: f32 = 2.0;
/// Points of a PDF per CSS pixel.
const POINTS_PER_PX: f32 = 0.75;

/// Kind of file that a chart is written to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Vectors, texts in the reader's own fonts.
    Svg,
    /// Pixels, two for each CSS pixel.
    Png,
    /// Vectors, texts as outlines.
    Pdf,
}

impl Format {
    /// Returns the format of a file's ending, in small letters or capitals.
    ///
    /// # Errors
    /// [`PictureError::Format`], which lists the endings, for any other.
    pub fn from_path(path: &Path) -> Result<Format, PictureError> {
        by_ending(path, &[("svg", Format::Svg), ("png", Format::Png), ("pdf", Format::Pdf)])
    }

    /// A drawing as the bytes of such a file.
    ///
    /// # Errors
    /// [`PictureError::ZeroSize`] and [`PictureError::Encode`] for pictures that do not fit into a file.
    pub fn encode(self, drawing: &Drawing) -> Result<Vec<u8>, PictureError> {
        match self {
            Format::Svg => Ok(drawing.svg().into_bytes()),
            Format::Png => png(drawing),
            Format::Pdf => Ok(pdf(drawing)),
        }
    }
}

/// Returns the format of a file's ending, in small letters or capitals.
///
/// # Errors
/// [`PictureError::Format`], which lists the endings, for any other.
pub(crate) fn by_ending<T: Copy>(path: &Path, known: &[(&str, T)]) -> Result<T, PictureError> {
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
    let named = known.iter().find(|(name, _)| name.eq_ignore_ascii_case(ending));
    named.map(|(_, format)| *format).ok_or_else(|| {
        let known: Vec<String> = known.iter().map(|(name, _)| format!(".{name}")).collect();
        PictureError::Format { file: path.display().to_string(), known: known.join(", ") }
    })
}

fn png(drawing: &Drawing) -> Result<Vec<u8>, PictureError> {
    let [width, height] = drawing.size_px.map(|side| (side as f32 * DOTS_PER_PX).round() as u32);
    let empty = || PictureError::ZeroSize { width: width as usize, height: height as usize };
    let mut dots = Pixmap::new(width, height).ok_or_else(empty)?;
    dots.fill(Color::WHITE);
    let placed = Transform::from_scale(DOTS_PER_PX, DOTS_PER_PX);
    for Shape { path, pen, color, .. } in &drawing.shapes {
        let stroke = match *pen {
            Pen::Fill(opacity) => {
                let paint = paint(*color, (255.0 * opacity).round() as u8);
                dots.fill_path(path, &paint, FillRule::Winding, placed, None);
                continue;
            }
            Pen::Line(width) => stroke(width, None),
            Pen::Dashes(width) => stroke(width, Some(DASH)),
            Pen::Dots(width) => Stroke { line_cap: LineCap::Round, ..stroke(width, None) },
        };
        dots.stroke_path(path, &paint(*color, 255), &stroke, placed, None);
    }
    dots.encode_png().map_err(|error| PictureError::Encode(error.to_string()))
}

/// One page without margins.
fn pdf(drawing: &Drawing) -> Vec<u8> {
    let [catalog, pages, page, contents] = [1, 2, 3, 4].map(Ref::new);
    let opacity = |shape: &Shape| if let Pen::Fill(opacity) = shape.pen { opacity } else { 1.0 };
    let mut opacities: Vec<f32> = drawing.shapes.iter().map(opacity).collect();
    opacities.sort_by(f32::total_cmp);
    opacities.dedup();
    let state = |index: usize| (format!("O{index}"), Ref::new(5 + index as i32));
    let [width, height] = drawing.size_px.map(|side| side as f32 * POINTS_PER_PX);
    let mut file = Pdf::new();
    file.catalog(catalog).pages(pages);
    file.pages(pages).kids([page]).count(1);
    {
        let mut first = file.page(page);
        first.parent(pages).media_box(Rect::new(0.0, 0.0, width, height)).contents(contents);
        let mut resources = first.resources();
        let mut states = resources.ext_g_states();
        for index in 0..opacities.len() {
            let (name, id) = state(index);
            states.pair(Name(name.as_bytes()), id);
        }
    }
    for (index, opacity) in opacities.iter().enumerate() {
        file.ext_graphics(state(index).1).non_stroking_alpha(*opacity);
    }
    let mut content = Content::new();
    // the page's y runs up, the drawing's down
    content.transform([POINTS_PER_PX, 0.0, 0.0, -POINTS_PER_PX, 0.0, height]);
    content.set_line_join(LineJoinStyle::RoundJoin);
    for shape in &drawing.shapes {
        let index = opacities.partition_point(|less| *less < opacity(shape));
        content.set_parameters(Name(state(index).0.as_bytes()));
        write_shape(&mut content, shape);
    }
    file.stream(contents, &content.finish());
    file.finish()
}

fn write_shape(content: &mut Content, shape: &Shape) {
    let [red, green, blue] = shape.color.map(|part| f32::from(part) / 255.0);
    let mut last = Point::default();
    for segment in shape.path.segments() {
        match segment {
            PathSegment::MoveTo(p) => _ = content.move_to(p.x, p.y),
            PathSegment::LineTo(p) => _ = content.line_to(p.x, p.y),
            PathSegment::QuadTo(c, p) => {
                // a parabola as a cubic: two thirds of the way to its control point
                let [a, b] = [last, p].map(|from| [from.x + 2.0 * c.x, from.y + 2.0 * c.y].map(|v| v / 3.0));
                content.cubic_to(a[0], a[1], b[0], b[1], p.x, p.y);
            }
            PathSegment::CubicTo(a, b, p) => _ = content.cubic_to(a.x, a.y, b.x, b.y, p.x, p.y),
            PathSegment::Close => _ = content.close_path(),
        }
        if let PathSegment::MoveTo(p)
        | PathSegment::LineTo(p)
        | PathSegment::QuadTo(_, p)
        | PathSegment::CubicTo(_, _, p) = segment
        {
            last = p;
        }
    }
    let (width, dash, cap) = match shape.pen {
        Pen::Fill(_) => {
            content.set_fill_rgb(red, green, blue).fill_nonzero();
            return;
        }
        Pen::Line(width) => (width, &[][..], LineCapStyle::ButtCap),
        Pen::Dashes(width) => (width, &DASH[..], LineCapStyle::ButtCap),
        Pen::Dots(width) => (width, &[][..], LineCapStyle::RoundCap),
    };
    content.set_stroke_rgb(red, green, blue).set_line_width(width).set_line_cap(cap);
    content.set_dash_pattern(dash.iter().copied(), 0.0).stroke();
}
