//! The fonts that are compiled in: widths of texts and their outlines, the same on every machine.

use tiny_skia::{Path, PathBuilder};
use ttf_parser::{Face, OutlineBuilder};

const REGULAR: &[u8] = include_bytes!("../fonts/DejaVuSans.ttf");
const BOLD: &[u8] = include_bytes!("../fonts/DejaVuSans-Bold.ttf");
/// A character that the font lacks is drawn as this one.
const REPLACEMENT: char = '?';

/// Width of a text in ems.
pub(crate) fn width_em(text: &str, bold: bool) -> f64 {
    f64::from(outline(text, bold).1)
}

/// The outline of a text in ems, baseline at 0, and its width.
pub(crate) fn outline(text: &str, bold: bool) -> (Option<Path>, f32) {
    let Ok(face) = Face::parse(if bold { BOLD } else { REGULAR }, 0) else { return (None, 0.0) };
    let em = 1.0 / f32::from(face.units_per_em());
    let mut pen = Pen { builder: PathBuilder::new(), em, right: 0.0 };
    for character in text.chars() {
        let glyph = face.glyph_index(character).or_else(|| face.glyph_index(REPLACEMENT)).unwrap_or_default();
        face.outline_glyph(glyph, &mut pen);
        pen.right += em * f32::from(face.glyph_hor_advance(glyph).unwrap_or_default());
    }
    (pen.builder.finish(), pen.right)
}

/// Collects glyphs from left to right.
struct Pen {
    builder: PathBuilder,
    em: f32,
    right: f32,
}

impl Pen {
    fn place_px(&self, x: f32, y: f32) -> (f32, f32) {
        (self.right + self.em * x, self.em * y)
    }
}

impl OutlineBuilder for Pen {
    fn move_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.place_px(x, y);
        self.builder.move_to(x, y);
    }
    fn line_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.place_px(x, y);
        self.builder.line_to(x, y);
    }
    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let ((x1, y1), (x, y)) = (self.place_px(x1, y1), self.place_px(x, y));
        self.builder.quad_to(x1, y1, x, y);
    }
    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let ((x1, y1), (x2, y2), (x, y)) =
            (self.place_px(x1, y1), self.place_px(x2, y2), self.place_px(x, y));
        self.builder.cubic_to(x1, y1, x2, y2, x, y);
    }
    fn close(&mut self) {
        self.builder.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_fonts_have_the_letters_of_charts() {
        for bold in [false, true] {
            assert!(outline("height − set-point (m²)", bold).0.is_some());
            assert!((5.0..8.0).contains(&width_em("0123456789", bold)));
            assert!(width_em("W", bold) > 2.0 * width_em("i", bold));
        }
        assert_eq!(width_em("\u{10FFFF}", false), width_em("?", false));
    }
}
