//! Files of charts: SVG as it is, PNG for slides, PDF for papers.

use std::path::Path;

use pdf_writer::{Content, Name, Pdf, Ref};
use tiny_skia::{
    Color, FillRule, LineJoin, Paint, PathSegment, Pixmap, Point, Stroke, StrokeDash, Transform,
};

use crate::PictureError;
use crate::drawing::{Drawing, Pen, Shape};
use crate::sheet::svg_error;

/// Dots of a PNG per CSS pixel: sharp on screens and on slides.
const DOTS_PER_PX: f32 = 2.0;
/// Points of a PDF per CSS pixel.
const POINTS_PER_PX: f32 = 0.75;

/// Kind of file that a chart is written to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Text of the reader's own fonts; the form that charts are drawn in.
    Svg,
    /// Pixels, two for each CSS pixel.
    Png,
    /// Vectors, texts as outlines.
    Pdf,
}

impl Format {
    /// Every format.
    pub const ALL: [Format; 3] = [Format::Svg, Format::Png, Format::Pdf];

    /// The ending of its files, without a dot.
    pub fn extension(self) -> &'static str {
        match self {
            Format::Svg => "svg",
            Format::Png => "png",
            Format::Pdf => "pdf",
        }
    }

    /// The format that a file's ending asks for, in small letters or capitals.
    ///
    /// # Errors
    /// [`PictureError::Format`], which lists the endings, for any other.
    pub fn from_path(path: &Path) -> Result<Format, PictureError> {
        let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
        let named = Format::ALL.into_iter().find(|format| format.extension().eq_ignore_ascii_case(ending));
        named.ok_or_else(|| {
            let known: Vec<String> = Format::ALL.iter().map(|f| format!(".{}", f.extension())).collect();
            PictureError::Format { file: path.display().to_string(), known: known.join(", ") }
        })
    }

    /// A chart that [`crate::chart()`] or [`crate::path3d()`] drew, as the bytes of such a file.
    ///
    /// # Errors
    /// [`PictureError::Svg`] for a document that is no chart of this crate.
    pub fn encode(self, svg: &str) -> Result<Vec<u8>, PictureError> {
        match self {
            Format::Svg => Ok(svg.as_bytes().to_vec()),
            Format::Png => png(&Drawing::from_svg(svg)?),
            Format::Pdf => Ok(pdf(&Drawing::from_svg(svg)?)),
        }
    }
}

fn png(drawing: &Drawing) -> Result<Vec<u8>, PictureError> {
    let [width, height] = drawing.size_px.map(|side| (side * DOTS_PER_PX).round() as u32);
    let empty = || PictureError::ZeroSize { width: width as usize, height: height as usize };
    let mut dots = Pixmap::new(width, height).ok_or_else(empty)?;
    dots.fill(Color::WHITE);
    let scale = drawing.scale * DOTS_PER_PX;
    let placed = Transform::from_scale(scale, scale);
    for Shape { path, color: [red, green, blue], opacity, pen } in &drawing.shapes {
        let mut paint = Paint { anti_alias: true, ..Paint::default() };
        paint.set_color_rgba8(*red, *green, *blue, (255.0 * opacity).round() as u8);
        match pen {
            None => dots.fill_path(path, &paint, FillRule::Winding, placed, None),
            Some(pen) => dots.stroke_path(path, &paint, &stroke(pen), placed, None),
        }
    }
    dots.encode_png().map_err(svg_error)
}

fn stroke(pen: &Pen) -> Stroke {
    Stroke {
        width: pen.width,
        line_join: LineJoin::Round,
        dash: pen.dash.and_then(|dash| StrokeDash::new(dash.to_vec(), 0.0)),
        ..Stroke::default()
    }
}

/// One page without margins.
fn pdf(drawing: &Drawing) -> Vec<u8> {
    let [catalog, pages, page, contents] = [1, 2, 3, 4].map(Ref::new);
    let mut opacities: Vec<f32> = drawing.shapes.iter().map(|shape| shape.opacity).collect();
    opacities.sort_by(f32::total_cmp);
    opacities.dedup();
    let state = |index: usize| (format!("O{index}"), Ref::new(5 + index as i32));
    let [width, height] = drawing.size_px.map(|side| side * POINTS_PER_PX);
    let mut file = Pdf::new();
    file.catalog(catalog).pages(pages);
    file.pages(pages).kids([page]).count(1);
    {
        let mut first = file.page(page);
        first.parent(pages).media_box(pdf_writer::Rect::new(0.0, 0.0, width, height)).contents(contents);
        let mut resources = first.resources();
        let mut states = resources.ext_g_states();
        for index in 0..opacities.len() {
            let (name, id) = state(index);
            states.pair(Name(name.as_bytes()), id);
        }
    }
    for (index, opacity) in opacities.iter().enumerate() {
        file.ext_graphics(state(index).1).stroking_alpha(*opacity).non_stroking_alpha(*opacity);
    }
    let mut content = Content::new();
    // the page's y runs up, the drawing's down
    let scale = drawing.scale * POINTS_PER_PX;
    content.transform([scale, 0.0, 0.0, -scale, 0.0, height]);
    content.set_line_join(pdf_writer::types::LineJoinStyle::RoundJoin);
    for shape in &drawing.shapes {
        let index = opacities.partition_point(|opacity| *opacity < shape.opacity);
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
            PathSegment::MoveTo(p) => {
                content.move_to(p.x, p.y);
                last = p;
            }
            PathSegment::LineTo(p) => {
                content.line_to(p.x, p.y);
                last = p;
            }
            PathSegment::QuadTo(c, p) => {
                // a parabola as a cubic: two thirds of the way to its control point
                let third =
                    |from: Point| Point::from_xy((from.x + 2.0 * c.x) / 3.0, (from.y + 2.0 * c.y) / 3.0);
                let (a, b) = (third(last), third(p));
                content.cubic_to(a.x, a.y, b.x, b.y, p.x, p.y);
                last = p;
            }
            PathSegment::CubicTo(a, b, p) => {
                content.cubic_to(a.x, a.y, b.x, b.y, p.x, p.y);
                last = p;
            }
            PathSegment::Close => {
                content.close_path();
            }
        }
    }
    let Some(pen) = shape.pen else {
        content.set_fill_rgb(red, green, blue).fill_nonzero();
        return;
    };
    content.set_stroke_rgb(red, green, blue).set_line_width(pen.width);
    content.set_dash_pattern(pen.dash.unwrap_or_default().into_iter().filter(|part| *part > 0.0), 0.0);
    content.stroke();
}
