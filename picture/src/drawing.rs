//! A chart as paths: the elements that [`crate::sheet`] writes, read back, with texts as outlines of a font that
//! is compiled in. So PNG and PDF look like the SVG wherever they are made.

use roxmltree::{Document, Node};
use tiny_skia::{Path, PathBuilder, Rect, Transform};
use ttf_parser::{Face, OutlineBuilder};

use crate::PictureError;
use crate::sheet::svg_error;

const REGULAR: &[u8] = include_bytes!("../fonts/DejaVuSans.ttf");
const BOLD: &[u8] = include_bytes!("../fonts/DejaVuSans-Bold.ttf");
/// Half the x-height of the font, in ems: the vertical middle of small letters.
const HALF_EX: f32 = 0.27;
/// A character that the font lacks is drawn as this one.
const REPLACEMENT: char = '?';

/// Line of a stroked path; dash and gap where it is not continuous.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pen {
    pub(crate) width: f32,
    pub(crate) dash: Option<[f32; 2]>,
}

/// A path that is filled, or stroked where it has a pen.
#[derive(Debug)]
pub(crate) struct Shape {
    pub(crate) path: Path,
    pub(crate) color: [u8; 3],
    pub(crate) opacity: f32,
    pub(crate) pen: Option<Pen>,
}

/// Shapes from the back to the front.
#[derive(Debug)]
pub(crate) struct Drawing {
    /// Width and height in CSS pixels.
    pub(crate) size_px: [f32; 2],
    /// CSS pixels per unit of the shapes.
    pub(crate) scale: f32,
    pub(crate) shapes: Vec<Shape>,
}

impl Drawing {
    /// Reads a chart that this crate wrote.
    pub(crate) fn from_svg(svg: &str) -> Result<Drawing, PictureError> {
        let document = Document::parse(svg).map_err(svg_error)?;
        let root = document.root_element();
        let size_px = [number(&root, "width")?, number(&root, "height")?];
        let view = numbers(&root, "viewBox")?;
        let wide = view.get(2).copied().filter(|wide| *wide > 0.0).unwrap_or(size_px[0]);
        let fonts = Fonts::new()?;
        let mut shapes = Vec::new();
        for node in root.children().filter(Node::is_element) {
            shapes.extend(shape(&node, &fonts)?);
        }
        Ok(Drawing { size_px, scale: size_px[0] / wide, shapes })
    }
}

fn shape(node: &Node, fonts: &Fonts) -> Result<Option<Shape>, PictureError> {
    let path = match node.tag_name().name() {
        "rect" => {
            let [x, y, width, height] = four(node, ["x", "y", "width", "height"])?;
            Rect::from_xywh(x, y, width, height).map(PathBuilder::from_rect)
        }
        "circle" => PathBuilder::from_circle(number(node, "cx")?, number(node, "cy")?, number(node, "r")?),
        "line" => {
            let [x1, y1, x2, y2] = four(node, ["x1", "y1", "x2", "y2"])?;
            polyline(&[x1, y1, x2, y2], false)
        }
        "polyline" => polyline(&numbers(node, "points")?, false),
        "polygon" => polyline(&numbers(node, "points")?, true),
        "text" => text(node, fonts)?,
        other => return Err(PictureError::Svg(format!("the element {other} is unknown"))),
    };
    // a path without extent has nothing to show
    let Some(path) = path else { return Ok(None) };
    let opacity = node.attribute("opacity").map_or(Ok(1.0), |_| number(node, "opacity"))?;
    let paint = |name: &str| node.attribute(name).filter(|value| *value != "none");
    let (color, pen) = match (paint("stroke"), paint("fill")) {
        (Some(color), _) => (color, Some(pen(node)?)),
        (None, Some(color)) => (color, None),
        (None, None) => return Ok(None),
    };
    Ok(Some(Shape { path, color: rgb(color)?, opacity, pen }))
}

fn pen(node: &Node) -> Result<Pen, PictureError> {
    let dash = match node.attribute("stroke-dasharray") {
        None => None,
        Some(_) => numbers(node, "stroke-dasharray")?.first_chunk().copied(),
    };
    Ok(Pen { width: number(node, "stroke-width")?, dash })
}

fn polyline(points: &[f32], closed: bool) -> Option<Path> {
    let mut builder = PathBuilder::new();
    for (i, [x, y]) in points.as_chunks::<2>().0.iter().enumerate() {
        if i == 0 { builder.move_to(*x, *y) } else { builder.line_to(*x, *y) }
    }
    if closed {
        builder.close();
    }
    builder.finish()
}

fn text(node: &Node, fonts: &Fonts) -> Result<Option<Path>, PictureError> {
    let written = node.text().unwrap_or_default().trim();
    let face = if node.attribute("font-weight") == Some("bold") { &fonts.bold } else { &fonts.regular };
    let [x, y, size] = [number(node, "x")?, number(node, "y")?, number(node, "font-size")?];
    let (outline, width) = outline(face, written);
    let ems = match node.attribute("text-anchor") {
        Some("middle") => -0.5 * width,
        Some("end") => -width,
        _ => 0.0,
    };
    let placed = Transform::from_row(size, 0.0, 0.0, -size, x + size * ems, y + size * HALF_EX);
    let turned = match node.attribute("transform") {
        None => placed,
        Some(turn) => {
            let angle = turn.trim_start_matches("rotate(").split(',').next().unwrap_or_default();
            let angle_deg: f32 = angle.parse().map_err(svg_error)?;
            placed.post_concat(Transform::from_rotate_at(angle_deg, x, y))
        }
    };
    Ok(outline.and_then(|path| path.transform(turned)))
}

/// The outline of a text in ems, baseline at 0, and its width.
fn outline(face: &Face, text: &str) -> (Option<Path>, f32) {
    let em = 1.0 / f32::from(face.units_per_em());
    let mut pen = Glyphs { builder: PathBuilder::new(), em, right: 0.0 };
    for character in text.chars() {
        let glyph = face.glyph_index(character).or_else(|| face.glyph_index(REPLACEMENT));
        let Some(glyph) = glyph else { continue };
        face.outline_glyph(glyph, &mut pen);
        pen.right += em * f32::from(face.glyph_hor_advance(glyph).unwrap_or_default());
    }
    (pen.builder.finish(), pen.right)
}

/// Collects glyphs from left to right.
struct Glyphs {
    builder: PathBuilder,
    em: f32,
    right: f32,
}

impl Glyphs {
    fn place(&self, x: f32, y: f32) -> (f32, f32) {
        (self.right + self.em * x, self.em * y)
    }
}

impl OutlineBuilder for Glyphs {
    fn move_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.place(x, y);
        self.builder.move_to(x, y);
    }
    fn line_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.place(x, y);
        self.builder.line_to(x, y);
    }
    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let ((x1, y1), (x, y)) = (self.place(x1, y1), self.place(x, y));
        self.builder.quad_to(x1, y1, x, y);
    }
    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let ((x1, y1), (x2, y2), (x, y)) = (self.place(x1, y1), self.place(x2, y2), self.place(x, y));
        self.builder.cubic_to(x1, y1, x2, y2, x, y);
    }
    fn close(&mut self) {
        self.builder.close();
    }
}

struct Fonts {
    regular: Face<'static>,
    bold: Face<'static>,
}

impl Fonts {
    fn new() -> Result<Fonts, PictureError> {
        let face = |bytes| Face::parse(bytes, 0).map_err(svg_error);
        Ok(Fonts { regular: face(REGULAR)?, bold: face(BOLD)? })
    }
}

fn attribute<'a>(node: &'a Node, name: &str) -> Result<&'a str, PictureError> {
    let missing = || PictureError::Svg(format!("{} without {name}", node.tag_name().name()));
    node.attribute(name).ok_or_else(missing)
}

fn number(node: &Node, name: &str) -> Result<f32, PictureError> {
    attribute(node, name)?.parse().map_err(svg_error)
}

fn four(node: &Node, names: [&str; 4]) -> Result<[f32; 4], PictureError> {
    let [a, b, c, d] = names.map(|name| number(node, name));
    Ok([a?, b?, c?, d?])
}

fn numbers(node: &Node, name: &str) -> Result<Vec<f32>, PictureError> {
    let parts = attribute(node, name)?.split([' ', ',']).filter(|part| !part.is_empty());
    parts.map(|part| part.parse().map_err(svg_error)).collect()
}

/// A colour as `#RRGGBB`.
fn rgb(text: &str) -> Result<[u8; 3], PictureError> {
    let digits = text.strip_prefix('#').filter(|digits| digits.len() == 6);
    let value = digits.and_then(|digits| u32::from_str_radix(digits, 16).ok());
    let value = value.ok_or_else(|| PictureError::Svg(format!("{text} is no colour")))?;
    let [_, red, green, blue] = value.to_be_bytes();
    Ok([red, green, blue])
}
