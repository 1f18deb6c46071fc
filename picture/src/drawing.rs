//! A drawing: lines, areas, dots and texts in CSS pixels. Every file format is written from it.

use tiny_skia::{Path, PathBuilder, Transform};

use crate::color::{Color, INK};
use crate::font;

/// Right of the left edge and down from the top, in CSS pixels.
pub(crate) type Point = [f64; 2];

/// Length of dashes and of the gaps between them.
pub(crate) const DASH: [f32; 2] = [6.0, 4.0];
/// From the middle of a text down to its baseline, in ems: half the height of a digit.
const BASELINE_EM: f64 = 0.36;

/// Where a text stands on its point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

/// How a text looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Look {
    Plain,
    Bold,
    /// From the bottom to the top.
    Turned,
}

#[derive(Debug, Clone, PartialEq)]
enum Form {
    Line { points: Vec<Point>, width: f64, dashed: bool },
    Area(Vec<Point>),
    Dot { middle: Point, radius: f64 },
    Text { text: String, middle: Point, size: f64, look: Look, anchor: Anchor },
}

/// A form in one colour.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Shape {
    form: Form,
    pub(crate) color: Color,
    pub(crate) opacity: f64,
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

    /// Draws a polyline.
    pub(crate) fn line(&mut self, points: &[Point], width: f64, dashed: bool, color: Color) {
        self.push(Form::Line { points: points.to_vec(), width, dashed }, color, 1.0);
    }

    /// Fills a polygon.
    pub(crate) fn area(&mut self, corners: &[Point], color: Color, opacity: f64) {
        self.push(Form::Area(corners.to_vec()), color, opacity);
    }

    pub(crate) fn dot(&mut self, middle: Point, radius: f64, color: Color) {
        self.push(Form::Dot { middle, radius }, color, 1.0);
    }

    /// Writes a text whose vertical middle is at the point, smaller than `size` where it is longer than `room`.
    pub(crate) fn text(
        &mut self,
        text: &str,
        middle: Point,
        size: f64,
        look: Look,
        anchor: Anchor,
        room: f64,
    ) {
        if text.is_empty() {
            return;
        }
        // the reader's font may be a little wider
        let wanted = 1.06 * font::width_em(text, look == Look::Bold) * size;
        let size = if wanted > room { size * (room / wanted).max(0.3) } else { size };
        self.push(Form::Text { text: text.to_owned(), middle, size, look, anchor }, INK, 1.0);
    }

    /// Adds another drawing with its upper left corner at a point.
    pub(crate) fn place(&mut self, other: Drawing, [right, down]: Point) {
        let shift = |[x, y]: &mut Point| (*x, *y) = (*x + right, *y + down);
        for mut shape in other.shapes {
            match &mut shape.form {
                Form::Line { points, .. } | Form::Area(points) => points.iter_mut().for_each(shift),
                Form::Dot { middle, .. } | Form::Text { middle, .. } => shift(middle),
            }
            self.shapes.push(shape);
        }
    }

    /// The drawing as an SVG document, with texts in the reader's Helvetica, Arial or sans-serif.
    pub fn svg(&self) -> String {
        let [width, height] = self.size_px;
        let shapes: String = self.shapes.iter().map(Shape::svg).collect();
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"Helvetica, Arial, sans-serif\" fill=\"none\" \
             stroke-linejoin=\"round\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#FFFFFF\"/>\n\
             {shapes}</svg>\n"
        )
    }

    fn push(&mut self, form: Form, color: Color, opacity: f64) {
        self.shapes.push(Shape { form, color, opacity });
    }
}

impl Shape {
    fn svg(&self) -> String {
        let [red, green, blue] = self.color;
        let color = format!("\"#{red:02X}{green:02X}{blue:02X}\"");
        let faint = if self.opacity < 1.0 { format!(" opacity=\"{}\"", self.opacity) } else { String::new() };
        let numbers = |points: &[Point]| {
            points
                .iter()
                .map(|[x, y]| format!("{},{}", rounded(*x), rounded(*y)))
                .collect::<Vec<_>>()
                .join(" ")
        };
        match &self.form {
            Form::Line { points, width, dashed } => {
                let [dash, gap] = DASH;
                let dashes =
                    if *dashed { format!(" stroke-dasharray=\"{dash} {gap}\"") } else { String::new() };
                let points = numbers(points);
                format!(
                    "<polyline points=\"{points}\" stroke={color} stroke-width=\"{width}\"{dashes}{faint}/>\n"
                )
            }
            Form::Area(corners) => {
                format!("<polygon points=\"{}\" fill={color}{faint}/>\n", numbers(corners))
            }
            Form::Dot { middle, radius } => {
                let [x, y] = middle.map(rounded);
                format!("<circle cx=\"{x}\" cy=\"{y}\" r=\"{radius}\" fill={color}/>\n")
            }
            Form::Text { text, middle, size, look, anchor } => {
                let ([x, y], size) = (middle.map(rounded), rounded(*size));
                let anchor = ["start", "middle", "end"][*anchor as usize];
                let look = match look {
                    Look::Plain => String::new(),
                    Look::Bold => " font-weight=\"bold\"".to_owned(),
                    Look::Turned => format!(" transform=\"rotate(-90 {x} {y})\""),
                };
                let text = escaped(text);
                format!(
                    "<text x=\"{x}\" y=\"{y}\" dy=\"{BASELINE_EM}em\" font-size=\"{size}\" \
                     text-anchor=\"{anchor}\" fill={color}{look}>{text}</text>\n"
                )
            }
        }
    }

    /// Width of the line, and whether it is dashed; `None` for what is filled.
    pub(crate) fn pen(&self) -> Option<(f32, bool)> {
        match self.form {
            Form::Line { width, dashed, .. } => Some((width as f32, dashed)),
            _ => None,
        }
    }

    /// The shape as a path, texts as outlines; `None` where it has no extent.
    pub(crate) fn path(&self) -> Option<Path> {
        let mut builder = PathBuilder::new();
        match &self.form {
            Form::Line { points, .. } => {
                trace(&mut builder, points.iter().map(|p| p.map(|v| v as f32)), false)
            }
            Form::Area(corners) => trace(&mut builder, corners.iter().map(|p| p.map(|v| v as f32)), true),
            Form::Dot { middle, radius } => {
                let [x, y] = middle.map(|v| v as f32);
                builder.push_circle(x, y, *radius as f32);
            }
            Form::Text { text, middle, size, look, anchor } => {
                let (outline, width) = font::outline(text, *look == Look::Bold);
                let ([x, y], em) = (middle.map(|v| v as f32), *size as f32);
                let start = -em * width * 0.5 * f32::from(*anchor as u8);
                let placed = Transform::from_row(em, 0.0, 0.0, -em, x + start, y + em * BASELINE_EM as f32);
                let turn = if *look == Look::Turned { -90.0 } else { 0.0 };
                return outline?.transform(placed.post_concat(Transform::from_rotate_at(turn, x, y)));
            }
        }
        builder.finish()
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
fn rounded(px: f64) -> f64 {
    (10.0 * px).round() / 10.0
}

/// A text without what XML reads as its own, or not at all.
fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    text.replace(char::is_control, " ")
}
