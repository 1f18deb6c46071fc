//! Tests of drawings of trajectories, read back from their SVG.

mod common;

use common::{assert_on_page, curves, dots, elements, texts};
use crazyflie_picture::{BLUE, PALETTE, Path3, PictureError, Style, VERMILION, path3d};

fn solid(label: &str, points_m: Vec<[f64; 3]>, color: [u8; 3]) -> Path3 {
    Path3 { label: label.into(), points_m, style: Style::Solid, color }
}

fn svg(path: Path3) -> String {
    path3d(&[path], &[], "").unwrap().svg()
}

#[test]
fn trajectories_are_seen_from_the_given_angles() {
    let line = |to: [f64; 3]| vec![[0.0; 3], to.map(|v| 0.5 * v), to];
    let ends = [("along x", [1.0, 0.0, 0.0]), ("along y", [0.0, 1.0, 0.0]), ("up", [0.0, 0.0, 1.0])];
    let paths: Vec<Path3> =
        ends.iter().zip(PALETTE).map(|((label, to), color)| solid(label, line(*to), color)).collect();
    let svg = path3d(&paths, &[], "Axes").unwrap().svg();
    let texts = texts(&svg);
    for wanted in ["Axes", "x (m)", "y (m)", "z (m)", "along x", "along y", "up"] {
        assert!(texts.iter().any(|text| text == wanted), "{wanted}");
    }
    assert_on_page(&svg);
    let step = |index: usize| {
        let drawn = &curves(&svg, PALETTE[index])[0];
        let (from, to) = (drawn[0], drawn[drawn.len() - 1]);
        (to[0] - from[0], to[1] - from[1])
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
    let svg = svg(solid("", vec![[-1.0, 0.2, 0.7], [0.0, 0.1, 0.8], [2.0, 0.0, 0.7]], VERMILION));
    let elements = elements(&svg);
    let black = elements.iter().filter(|e| e.attribute("fill") == Some("#101214"));
    assert_eq!(black.count(), 1);
    assert_eq!(dots(&svg), 3);
    assert_on_page(&svg);
}

#[test]
fn long_trajectories_stay_small() {
    let spiral = |i: u32| {
        let a = f64::from(i) * 0.01;
        [0.001 * a * a.cos(), 0.001 * a * a.sin(), 0.001 * a]
    };
    let svg = svg(solid("spiral", (0..100_000).map(spiral).collect(), VERMILION));
    assert!(svg.len() < 300_000, "{}", svg.len());
    assert_on_page(&svg);
}

#[test]
fn trajectories_that_cannot_be_drawn_say_why() {
    let path = solid("flown", vec![[0.0; 3], [0.0, 0.0, f64::NAN]], BLUE);
    let nan = PictureError::NonFinite { what: "path \"flown\"".to_owned(), index: 1 };
    assert_eq!(path3d(&[path], &[], ""), Err(nan));
    assert!(matches!(path3d(&[solid("flown", vec![], BLUE)], &[], ""), Err(PictureError::Empty { .. })));
    assert!(matches!(path3d(&[], &[], ""), Err(PictureError::Empty { .. })));
    let far = [vec![[0.0; 3], [0.0, 2e6, 0.0]]];
    let beyond = path3d(&[solid("flown", vec![[0.0; 3]], BLUE)], &far, "");
    assert!(matches!(beyond, Err(PictureError::OutOfRange { index: 1, .. })));
}

#[test]
fn trajectories_along_a_corridor_have_readable_numbers() {
    let points = (0..100).map(|i| [0.2 * f64::from(i), 0.01, 0.7]).collect();
    let svg = svg(Path3 { style: Style::Dashed, ..solid("corridor", points, BLUE) });
    assert_on_page(&svg);
    let elements = elements(&svg);
    let texts = elements.iter().filter(|element| element.name == "text");
    let places: Vec<[f64; 2]> = texts.map(|text| ["x", "y"].map(|name| text.number(name))).collect();
    for (i, a) in places.iter().enumerate() {
        assert!(places[..i].iter().all(|b| (a[0] - b[0]).hypot(a[1] - b[1]) > 7.5), "texts overlap");
    }
}
