//! Tests of drawings of trajectories, read back as XML.

mod common;

use common::{assert_on_page, curves, texts};
use crazyflie_picture::{PALETTE, Path3, PictureError, Style, path3d};
use roxmltree::{Document, Node};

#[test]
fn trajectories_are_seen_from_the_given_angles() {
    let line = |to: [f64; 3]| vec![[0.0; 3], to.map(|v| 0.5 * v), to];
    let ends = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let lines = ends.map(line);
    let paths: Vec<Path3> = lines
        .iter()
        .zip(["along x", "along y", "up"])
        .enumerate()
        .map(|(i, (points_m, label))| Path3 { label, points_m, style: Style::Solid, color: PALETTE[i] })
        .collect();
    let svg = path3d(&paths, "Axes").unwrap();
    let document = Document::parse(&svg).unwrap();
    let texts = texts(&document);
    for wanted in ["Axes", "x (m)", "y (m)", "z (m)", "along x", "along y", "up"] {
        assert!(texts.iter().any(|text| text == wanted), "{wanted}");
    }
    assert_on_page(&document);
    // Of each colour the copy on the floor comes first; the path up has none worth drawing.
    let step = |index: usize| {
        let drawn = curves(&document, PALETTE[index]).pop().unwrap();
        let (from, to) = (drawn[0], drawn[drawn.len() - 1]);
        (to.0 - from.0, to.1 - from.1)
    };
    let (x, y, z) = (step(0), step(1), step(2));
    assert!(x.0 > 0.0 && x.1 > 0.0, "x runs to the right and towards the reader");
    assert!(y.0 > 0.0 && y.1 < 0.0, "y runs to the right and away");
    assert!(z.0.abs() <= 1.0 && z.1 < 0.0, "z runs up");
    // One scale for all axes: right of x is cos 43, right of y is sin 43, up of z is cos 24.
    let unit = -z.1 / 24.0_f64.to_radians().cos();
    assert!((x.0 / unit - 43.0_f64.to_radians().cos()).abs() < 0.01);
    assert!((y.0 / unit - 43.0_f64.to_radians().sin()).abs() < 0.01);
}

#[test]
fn trajectories_mark_the_marker_start_and_end() {
    let points = [[-1.0, 0.2, 0.7], [0.0, 0.1, 0.8], [2.0, 0.0, 0.7]];
    let path = Path3 { label: "", points_m: &points, style: Style::Solid, color: PALETTE[1] };
    let svg = path3d(&[path], "").unwrap();
    let document = Document::parse(&svg).unwrap();
    let black = document
        .descendants()
        .filter(|n| n.has_tag_name("polygon") && n.attribute("fill") == Some("#101214"));
    assert_eq!(black.count(), 1);
    assert_eq!(document.descendants().filter(|node| node.has_tag_name("circle")).count(), 3);
    assert_on_page(&document);
}

#[test]
fn long_trajectories_stay_small() {
    let spiral = |i: u32| {
        let a = f64::from(i) * 0.01;
        [0.001 * a * a.cos(), 0.001 * a * a.sin(), 0.001 * a]
    };
    let points: Vec<[f64; 3]> = (0..100_000).map(spiral).collect();
    let path = Path3 { label: "spiral", points_m: &points, style: Style::Solid, color: PALETTE[1] };
    let svg = path3d(&[path], "").unwrap();
    assert!(svg.len() < 300_000, "{}", svg.len());
    assert_on_page(&Document::parse(&svg).unwrap());
}

#[test]
fn trajectories_that_cannot_be_drawn_say_why() {
    let points = [[0.0; 3], [0.0, 0.0, f64::NAN]];
    let path = Path3 { label: "flown", points_m: &points, style: Style::Solid, color: PALETTE[0] };
    let nan = PictureError::NonFinite { what: "path \"flown\"".to_owned(), index: 1 };
    assert_eq!(path3d(&[path], ""), Err(nan));
    let empty = Path3 { points_m: &[], ..path };
    assert!(matches!(path3d(&[empty], ""), Err(PictureError::Empty { .. })));
    assert!(matches!(path3d(&[], ""), Err(PictureError::Empty { .. })));
}

#[test]
fn trajectories_along_a_corridor_have_readable_numbers() {
    let points: Vec<[f64; 3]> = (0..100).map(|i| [0.2 * f64::from(i), 0.01, 0.7]).collect();
    let path = Path3 { label: "corridor", points_m: &points, style: Style::Dashed, color: PALETTE[0] };
    let svg = path3d(&[path], "").unwrap();
    let document = Document::parse(&svg).unwrap();
    assert_on_page(&document);
    let place = |node: &Node| ["x", "y"].map(|name| node.attribute(name).unwrap().parse::<f64>().unwrap());
    let nodes = document.descendants().filter(|node| node.has_tag_name("text"));
    let places: Vec<[f64; 2]> = nodes.map(|node| place(&node)).collect();
    for (i, a) in places.iter().enumerate() {
        assert!(places[..i].iter().all(|b| (a[0] - b[0]).hypot(a[1] - b[1]) > 30.0), "texts overlap");
    }
}
