//! Charts as files: each format identifies itself, and shows the same as the SVG.

mod common;

use std::path::Path;

use crazyflie_picture::{BLUE, Drawing, Format, PALETTE, Panel, Path3, Style, chart, path3d};

fn sample() -> Drawing {
    let (x, y) = ([0.0, 1.0, 2.0], [0.0, 0.5, 2.0]);
    let styles = [Style::Solid, Style::Dashed, Style::Points, Style::Step].into_iter().zip(PALETTE);
    let panel = styles.fold(Panel::new("time (s)", "height (m)").title("Panel"), |panel, (style, color)| {
        panel.curve(style, color, "height − set-point (m²)", x, y)
    });
    chart(&[panel.band(PALETTE[2], "goal", [0.2, 0.4])], 1, "Title").unwrap()
}

#[test]
fn a_files_ending_decides_and_an_unknown_one_lists_them_all() {
    for (file, format) in [("a.svg", Format::Svg), ("b/c.PNG", Format::Png), ("a.b.pdf", Format::Pdf)] {
        assert_eq!(Format::from_path(Path::new(file)), Ok(format));
    }
    for file in ["a.jpg", "a", "png", "a.svg.gz", ""] {
        let refused = Format::from_path(Path::new(file)).unwrap_err().to_string();
        for ending in ["svg", "png", "pdf"] {
            assert!(refused.contains(&format!(".{ending}")), "{refused}");
        }
    }
}

#[test]
fn each_format_begins_as_its_readers_expect() {
    let points_m = vec![[0.0, 0.0, 0.0], [1.0, 0.5, 0.7], [0.2, 0.1, 0.7]];
    let path = Path3 { label: "flown".into(), points_m, style: Style::Solid, color: BLUE };
    assert_eq!(sample(), sample());
    for drawing in [sample(), path3d(&[path], &[], "Path").unwrap()] {
        assert!(Format::Svg.encode(&drawing).unwrap().starts_with(b"<svg"));
        assert!(Format::Png.encode(&drawing).unwrap().starts_with(b"\x89PNG\r\n\x1a\n"));
        let pdf = Format::Pdf.encode(&drawing).unwrap();
        assert_eq!(Format::Pdf.encode(&drawing).unwrap(), pdf, "the same bytes each time");
        assert!(pdf.starts_with(b"%PDF-1.") && pdf.ends_with(b"%%EOF"));
    }
}

/// The curve's colour is where the SVG has the curve, and the title's row has ink.
#[test]
fn pixels_show_the_curves_and_the_texts() {
    let drawing = sample();
    let png = Format::Png.encode(&drawing).unwrap();
    let dots = tiny_skia::Pixmap::decode_png(&png).unwrap();
    let svg = drawing.svg();
    let size = ["width", "height"].map(|side| common::elements(&svg)[0].number(side) as u32);
    assert_eq!([dots.width(), dots.height()], size.map(|side| 2 * side));
    let color_at = |x: f64, y: f64| {
        let dot = dots.pixel(x as u32, y as u32).unwrap();
        [dot.red(), dot.green(), dot.blue()]
    };
    let curve = &common::curves(&svg, BLUE)[0];
    // a CSS pixel is two dots; a quarter of the way, where no other curve is
    let [x, y] = [0, 1].map(|i| 2.0 * (0.75 * curve[0][i] + 0.25 * curve[1][i]));
    assert!((-3..=3).any(|dy| color_at(x, y + f64::from(dy))[2] > 150), "no curve at {x}, {y}");
    let ink = (0..dots.width()).filter(|x| color_at(f64::from(*x), 40.0)[0] < 128).count();
    assert!(ink > 5, "{ink} dark dots in the title's row");
}
