//! A drawing: lines, areas, dots and texts in CSS pixels. Every file format is written from it.

use tiny_skia::{Path, PathBuilder, PathSegment, Transform};

use crate::color::{Color, INK};
use crate::font;

/// Right of the left edge and down from the top, in CSS pixels.
pub(crate) type Point = [f64; 2];

/// Length of dashes and of the gaps between them.
pub(crate) const DASH: [f32; 2] = [6.0, 4.0];
/// From the middle of a text down to its baseline, in ems: half the height of a digit.
const BASELINE_EM: f32 = 0.36;

/// Styles of points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Pen {
    /// A polygon of some opacity.
    Fill(f32),
    /// A line of some width.
    Line(f32),
    Dashes(f32),
    /// A dot of some diameter at each point.
    Dots(f32),
}

/// Position of a text relative to its point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

/// Appearance of a text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Look {
    Plain,
    Bold,
    /// From the bottom to the top.
    Turned,
}

/// A path in one colour, and the text that it outlines.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Shape {
    pub(crate) path: Path,
    pub(crate) pen: Pen,
    pub(crate) color: Color,
    label: Option<Label>,
}

#[derive(Debug, Clone, PartialEq)]
struct Label {
    text: String,
    at: [f32; 2],
    size: f32,
    anchor: Anchor,
    look: Look,
}

/// A finished picture on white. [`Format`](crate::Format) writes it to files.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    pub(crate) size_px: Point,
    /// From the back to the front.
    pub(crate) shapes: Vec<Shape>,
}

impl Drawing {
    pub(crate) fn new(size_px: Point) -> Self {
        Drawing { size_px, shapes: Vec::new() }
    }

    /// Draws a line or dots through points, or fills the polygon between them.
    pub(crate) fn draw(&mut self, points: &[Point], pen: Pen, color: Color) {
        let mut builder = PathBuilder::new();
        let points = points.iter().map(|point| point.map(|v| v as f32));
        match pen {
            // a line without length, whose ends are round
            Pen::Dots(_) => points.for_each(|point| trace(&mut builder, [point; 2].into_iter(), false)),
            _ => trace(&mut builder, points, matches!(pen, Pen::Fill(_))),
        }
        self.shapes.extend(builder.finish().map(|path| Shape { path, pen, color, label: None }));
    }

    /// Writes a text whose vertical middle is at the point, smaller than `size` where it is longer than `room`.
    pub(crate) fn text(&mut self, text: &str, at: Point, size: f64, look: Look, anchor: Anchor, room: f64) {
        let (outline, width_em) = font::outline(text, look == Look::Bold);
        // the usual sans-serif faces are narrower, so there is room in SVG too
        let wanted = f64::from(width_em) * size;
        let size = if wanted > room { size * (room / wanted).max(0.3) } else { size } as f32;
        let [x, y] = at.map(|v| v as f32);
        let start = x - 0.5 * f32::from(anchor as u8) * size * width_em;
        let placed = Transform::from_row(size, 0.0, 0.0, -size, start, y + BASELINE_EM * size);
        let turn = Transform::from_rotate_at(if look == Look::Turned { -90.0 } else { 0.0 }, x, y);
        let path = outline.and_then(|outline| outline.transform(placed.post_concat(turn)));
        let label = Some(Label { text: text.to_owned(), at: [x, y], size, anchor, look });
        self.shapes.extend(path.map(|path| Shape { path, pen: Pen::Fill(1.0), color: INK, label }));
    }

    /// Adds another drawing with its upper left corner at a point.
    pub(crate) fn place(&mut self, other: Drawing, corner: Point) {
        let [right, down] = corner.map(|v| v as f32);
        for Shape { path, pen, color, label } in other.shapes {
            let label = label.map(|label| Label { at: [label.at[0] + right, label.at[1] + down], ..label });
            let path = path.transform(Transform::from_translate(right, down));
            self.shapes.extend(path.map(|path| Shape { path, pen, color, label }));
        }
    }

    /// The drawing as an SVG document, with texts in the reader's Helvetica, Arial or sans-serif.
    pub fn svg(&self) -> String {
        self.svg_with(" xmlns=\"http://www.w3.org/2000/svg\"")
    }

    /// Returns the drawing like [`Drawing::svg`], for a place within a page of HTML: it names no outside address.
    pub fn inline_svg(&self) -> String {
        self.svg_with("")
    }

    fn svg_with(&self, namespace: &str) -> String {
        let [width, height] = self.size_px;
        let shapes: String = self.shapes.iter().map(Shape::svg).collect();
        format!(
            "<svg{namespace} width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"Helvetica, Arial, sans-serif\" \
             stroke-linejoin=\"round\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#FFFFFF\"/>\n\
             {shapes}</svg>\n"
        )
    }
}

impl Shape {
    fn svg(&self) -> String {
        let [red, green, blue] = self.color;
        let color = format!("#{red:02X}{green:02X}{blue:02X}");
        if let Some(Label { text, at, size, anchor, look }) = &self.label {
            let ([x, y], size, anchor) =
                (at.map(rounded), rounded(*size), ["start", "middle", "end"][*anchor as usize]);
            let look = match look {
                Look::Plain => String::new(),
                Look::Bold => " font-weight=\"bold\"".to_owned(),
                Look::Turned => format!(" transform=\"rotate(-90 {x} {y})\""),
            };
            return format!(
                "<text x=\"{x}\" y=\"{y}\" dy=\"{BASELINE_EM}em\" font-size=\"{size}\" \
                 text-anchor=\"{anchor}\" fill=\"{color}\"{look}>{}</text>\n",
                escaped(text)
            );
        }
        let [dash, gap] = DASH;
        let line = |width| format!("fill=\"none\" stroke=\"{color}\" stroke-width=\"{width}\"");
        let paint = match self.pen {
            Pen::Fill(1.0) => format!("fill=\"{color}\""),
            Pen::Fill(opacity) => format!("fill=\"{color}\" opacity=\"{opacity}\""),
            Pen::Line(width) => line(width),
            Pen::Dashes(width) => format!("{} stroke-dasharray=\"{dash} {gap}\"", line(width)),
            Pen::Dots(width) => format!("{} stroke-linecap=\"round\"", line(width)),
        };
        let place = |points: &[tiny_skia::Point]| {
            points.iter().map(|p| format!("{} {}", rounded(p.x), rounded(p.y))).collect::<Vec<_>>().join(" ")
        };
        let segment = |segment| match segment {
            PathSegment::MoveTo(p) => format!("M{}", place(&[p])),
            PathSegment::LineTo(p) => format!("L{}", place(&[p])),
            PathSegment::QuadTo(a, p) => format!("Q{}", place(&[a, p])),
            PathSegment::CubicTo(a, b, p) => format!("C{}", place(&[a, b, p])),
            PathSegment::Close => "Z".to_owned(),
        };
        format!("<path d=\"{}\" {paint}/>\n", self.path.segments().map(segment).collect::<String>())
    }
}

/// Adds a polyline to a path.
pub(crate) fn trace(builder: &mut PathBuilder, points: impl Iterator<Item = [f32; 2]>, close: bool) {
    for (i, [x, y]) in points.enumerate() {
        if i == 0 { builder.move_to(x, y) } else { builder.line_to(x, y) }
    }
    if close {
        builder.close();
    }
}

/// A tenth of a pixel is finer than screens show.
fn rounded(px: f32) -> f32 {
    (10.0 * px).round() / 10.0
}

/// A text without the characters that XML keeps for itself or does not take.
fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    text.replace(char::is_control, " ")
}
