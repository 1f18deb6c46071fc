//! Charts as files: each format says what it is, and shows what the SVG shows.

mod common;

use std::path::Path;

use crazyflie_picture::{Format, PALETTE, Panel, Path3, PictureError, Series, Style, chart, path3d};

fn sample() -> String {
    let (x, y) = ([0.0, 1.0, 2.0], [0.0, 0.5, 2.0]);
    let series = [Style::Solid, Style::Dashed, Style::Points, Style::Step].iter().zip(PALETTE).map(
        |(style, color)| Series { label: "height − set-point (m²)", x: &x, y: &y, style: *style, color },
    );
    let panel = Panel { title: "Panel", x_label: "time (s)", series: series.collect(), ..Panel::default() };
    chart(&[panel], 1, "Title").unwrap()
}

#[test]
fn a_files_ending_decides_and_an_unknown_one_lists_them_all() {
    for (file, format) in [("a.svg", Format::Svg), ("b/c.PNG", Format::Png), ("a.b.pdf", Format::Pdf)] {
        assert_eq!(Format::from_path(Path::new(file)), Ok(format));
    }
    for file in ["a.jpg", "a", "png", "a.svg.gz", ""] {
        let refused = Format::from_path(Path::new(file)).unwrap_err().to_string();
        for format in Format::ALL {
            assert!(refused.contains(&format!(".{}", format.extension())), "{refused}");
        }
    }
}

#[test]
fn each_format_begins_as_its_readers_expect() {
    let points = [[0.0, 0.0, 0.0], [1.0, 0.5, 0.7], [0.2, 0.1, 0.7]];
    let path = Path3 { label: "flown", points_m: &points, style: Style::Solid, color: PALETTE[0] };
    for svg in [sample(), path3d(&[path], "Path").unwrap()] {
        assert_eq!(Format::Svg.encode(&svg).unwrap(), svg.as_bytes());
        assert!(Format::Png.encode(&svg).unwrap().starts_with(b"\x89PNG\r\n\x1a\n"));
        let pdf = Format::Pdf.encode(&svg).unwrap();
        assert!(pdf.starts_with(b"%PDF-1.") && pdf.ends_with(b"%%EOF"));
    }
}

/// The curve's colour is where the SVG has the curve, and the title's row holds ink.
#[test]
fn pixels_show_the_curves_and_the_texts() {
    let svg = sample();
    let png = Format::Png.encode(&svg).unwrap();
    let dots = tiny_skia::Pixmap::decode_png(&png).unwrap();
    let document = roxmltree::Document::parse(&svg).unwrap();
    let root = document.root_element();
    let side = |name: &str| root.attribute(name).unwrap().parse::<u32>().unwrap();
    assert_eq!([dots.width(), dots.height()], [2 * side("width"), 2 * side("height")]);
    let color_at = |x: f64, y: f64| {
        let dot = dots.pixel(x as u32, y as u32).unwrap();
        [dot.red(), dot.green(), dot.blue()]
    };
    let curve = &common::curves(&document, PALETTE[0])[0];
    // four units of the page are one CSS pixel, and that is two dots; a quarter of the way, where no other curve is
    let middle = [0, 1].map(|i| {
        if i == 0 { 0.75 * curve[0].0 + 0.25 * curve[1].0 } else { 0.75 * curve[0].1 + 0.25 * curve[1].1 }
    });
    let near = (-3..=3).any(|dy| color_at(0.5 * middle[0], 0.5 * middle[1] + f64::from(dy))[2] > 150);
    assert!(near, "no curve at {middle:?}");
    let ink = (0..dots.width()).filter(|x| color_at(f64::from(*x), 40.0)[0] < 128).count();
    assert!(ink > 5, "{ink} dark dots in the title's row");
}

#[test]
fn what_is_no_chart_is_refused() {
    for text in ["", "<svg", "<svg width=\"1\" height=\"1\" viewBox=\"0 0 1 1\"><path d=\"M0 0\"/></svg>"] {
        assert!(matches!(Format::Png.encode(text), Err(PictureError::Svg(_))), "{text}");
        assert!(matches!(Format::Pdf.encode(text), Err(PictureError::Svg(_))), "{text}");
    }
}
