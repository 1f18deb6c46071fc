//! Tests of charts, read back as XML.

mod common;

use common::{assert_on_page, curves, texts};
use crazyflie_picture::{Band, HLine, PALETTE, Panel, PictureError, Scale, Series, Style, chart};
use roxmltree::Document;

const X: [f64; 3] = [0.0, 1.0, 2.0];

fn series<'a>(label: &'a str, x: &'a [f64], y: &'a [f64], style: Style) -> Series<'a> {
    Series { label, x, y, style, color: PALETTE[0] }
}

fn panel(series: Vec<Series>) -> Panel {
    Panel { title: "Panel", x_label: "time (s)", y_label: "height (m)", series, ..Panel::default() }
}

#[test]
fn a_grid_of_panels_names_everything_with_units() {
    let y = [0.1, 0.4, 0.2];
    let labels = ["flown", "wanted", "fixes", "command"];
    let styles = [Style::Solid, Style::Dashed, Style::Points, Style::Step];
    let all = labels.iter().zip(styles).map(|(label, style)| series(label, &X, &y, style));
    let mut panels = vec![panel(all.collect()), panel(vec![series("a < b & \"c\"", &X, &y, Style::Solid)])];
    panels[1].bands.push(Band { label: "tolerance", low: -0.5, high: 0.5, color: PALETTE[2] });
    panels[1].hlines.push(HLine { label: "limit", y: 1.5, color: PALETTE[1] });
    let svg = chart(&panels, 2, "Flight").unwrap();
    let document = Document::parse(&svg).unwrap();
    let texts = texts(&document);
    for wanted in
        ["Flight", "time (s)", "height (m)", "a < b & \"c\"", "tolerance", "limit"].iter().chain(&labels)
    {
        assert!(texts.iter().any(|text| text == wanted), "{wanted} is missing in {texts:?}");
    }
    let first = document.descendants().find(|node| node.has_tag_name("rect")).unwrap();
    assert_eq!(first.attribute("fill"), Some("#FFFFFF"));
    assert!(document.descendants().any(|node| node.attribute("stroke-dasharray").is_some()));
    assert_on_page(&document);
}

#[test]
fn curves_run_right_and_up() {
    let y = [0.0, 0.5, 2.0];
    let svg = chart(&[panel(vec![series("", &X, &y, Style::Solid)])], 1, "").unwrap();
    let document = Document::parse(&svg).unwrap();
    let drawn = &curves(&document, PALETTE[0])[0];
    assert_eq!(drawn.len(), 3);
    assert!(drawn.windows(2).all(|pair| pair[1].0 > pair[0].0 && pair[1].1 < pair[0].1));
    // Evenly spaced in x, and y to scale: the first rise is a quarter of the whole.
    assert!((2.0 * drawn[1].0 - drawn[0].0 - drawn[2].0).abs() <= 2.0);
    assert!((drawn[0].1 - drawn[1].1 - 0.25 * (drawn[0].1 - drawn[2].1)).abs() <= 2.0);
}

#[test]
fn steps_hold_the_value_before() {
    let y = [0.0, 1.0, 0.5];
    let svg = chart(&[panel(vec![series("", &X, &y, Style::Step)])], 1, "").unwrap();
    let document = Document::parse(&svg).unwrap();
    let drawn = &curves(&document, PALETTE[0])[0];
    assert_eq!(drawn.len(), 5);
    assert!(drawn[0].1 == drawn[1].1 && drawn[1].0 == drawn[2].0 && drawn[2].1 == drawn[3].1);
}

#[test]
fn limits_and_bands_are_inside_the_axes() {
    let mut shown = panel(vec![series("", &X, &[0.0, 0.0, 0.1], Style::Solid)]);
    shown.hlines.push(HLine { label: "", y: 8.0, color: PALETTE[1] });
    shown.bands.push(Band { label: "", low: -3.0, high: -4.0, color: PALETTE[2] });
    let svg = chart(&[shown], 1, "").unwrap();
    let document = Document::parse(&svg).unwrap();
    let texts = texts(&document);
    assert!(texts.contains(&"8".to_owned()) && texts.contains(&"-4".to_owned()), "{texts:?}");
    assert_on_page(&document);
}

#[test]
fn a_hundred_thousand_points_make_a_small_file_that_keeps_the_peak() {
    let x: Vec<f64> = (0..100_000).map(|i| f64::from(i) * 0.01).collect();
    let mut y: Vec<f64> = x.iter().map(|x| (x * 91.7).sin()).collect();
    y[54_321] = 5.0;
    let backwards: Vec<f64> = x.iter().map(|x| (x * 3.0).cos()).collect();
    for style in [Style::Solid, Style::Dashed, Style::Points, Style::Step] {
        for across in [&x, &backwards] {
            let many = (0..3).map(|_| series("gyro", across, &y, style)).collect();
            let svg = chart(&[panel(many)], 1, "").unwrap();
            assert!(svg.len() < 1_000_000, "{style:?}: {} bytes", svg.len());
            Document::parse(&svg).unwrap();
        }
    }
    let svg = chart(&[panel(vec![series("gyro", &x, &y, Style::Solid)])], 1, "").unwrap();
    assert!(svg.len() < 100_000);
    let document = Document::parse(&svg).unwrap();
    let drawn = &curves(&document, PALETTE[0])[0];
    let top = drawn.iter().map(|p| p.1).fold(f64::MAX, f64::min);
    let at = drawn.iter().find(|p| p.1 == top).unwrap().0;
    let (first, last) = (drawn[0].0, drawn[drawn.len() - 1].0);
    assert!(((at - first) / (last - first) - 0.54321).abs() < 0.002);
}

#[test]
fn awkward_ranges_are_drawn() {
    let cases: [[f64; 3]; 6] = [
        [0.7, 0.7, 0.7],
        [0.0, 0.0, 0.0],
        [-1e300, 0.0, 1e300],
        [1e-12, 2e-12, 3e-12],
        [1e15, 1e15 + 1.0, 1e15 + 2.0],
        [35000.0, 35000.001, 35000.002],
    ];
    for y in cases {
        let svg = chart(
            &[panel(vec![series("s", &X, &y, Style::Solid), series("t", &y, &X, Style::Solid)])],
            1,
            "",
        );
        assert_on_page(&Document::parse(&svg.unwrap()).unwrap());
    }
    let single = chart(&[panel(vec![series("s", &[1.0], &[2.0], Style::Solid)])], 3, "").unwrap();
    assert!(Document::parse(&single).unwrap().descendants().any(|node| node.has_tag_name("circle")));
}

#[test]
fn long_texts_are_made_to_fit() {
    let long = "a very long description of a quantity that goes on and on, and then on (m/s)";
    let mut shown = panel(vec![series(long, &X, &X, Style::Solid), series(long, &X, &X, Style::Dashed)]);
    (shown.title, shown.x_label, shown.y_label) = (long, long, long);
    let panels = vec![shown; 6];
    let svg = chart(&panels, 3, &long.repeat(2)).unwrap();
    assert_on_page(&Document::parse(&svg).unwrap());
}

#[test]
fn charts_that_cannot_be_drawn_say_why() {
    let refused = |series: Series| chart(&[panel(vec![series])], 1, "").unwrap_err();
    let nan = refused(series("pitch", &X, &[0.0, f64::NAN, 1.0], Style::Solid));
    assert_eq!(nan, PictureError::NonFinite { what: "series \"pitch\": y".to_owned(), index: 1 });
    let huge = refused(series("pitch", &[0.0, 1.0, 1e301], &X, Style::Solid));
    assert!(matches!(huge, PictureError::OutOfRange { index: 2, .. }));
    let uneven = refused(series("roll", &X, &X[..2], Style::Solid));
    assert_eq!(uneven, PictureError::LengthMismatch { label: "roll".to_owned(), x: 3, y: 2 });
    assert!(matches!(refused(series("yaw", &[], &[], Style::Solid)), PictureError::Empty { .. }));
    assert!(matches!(chart(&[], 1, ""), Err(PictureError::Empty { .. })));
    assert!(matches!(chart(&[panel(vec![])], 1, ""), Err(PictureError::Empty { .. })));
    let fine = panel(vec![series("", &X, &X, Style::Solid)]);
    assert!(matches!(chart(&[fine], 0, ""), Err(PictureError::ZeroSize { .. })));
}

#[test]
fn a_curve_that_leaves_the_limits_ends_on_the_edge() {
    let (x, y) = ([0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 0.5, 1.0, 40.0, 9000.0]);
    let mut shown = panel(vec![series("", &x, &y, Style::Solid)]);
    shown.y_limits = Some([0.0, 2.0]);
    let svg = chart(&[shown.clone()], 1, "").unwrap();
    let document = Document::parse(&svg).unwrap();
    let drawn = curves(&document, PALETTE[0]);
    assert_eq!(drawn.len(), 1);
    let (last, before) = (drawn[0][drawn[0].len() - 1], drawn[0][drawn[0].len() - 2]);
    // it goes on rising to the edge, and is not drawn flat along it
    assert!(last.1 < before.1 - 100.0 && last.0 > before.0, "{drawn:?}");
    assert_on_page(&document);
    shown.y_limits = Some([2.0, 2.0]);
    assert!(matches!(chart(&[shown], 1, ""), Err(PictureError::OutOfRange { .. })));
}

#[test]
fn categories_are_named_and_decades_are_evenly_apart() {
    let mut shown = panel(vec![series("", &X, &[1.0, 2.0, 1.5], Style::Points)]);
    shown.x_scale = Scale::Categories(&["nominal", "randomised", "undeclared"]);
    let svg = chart(&[shown.clone()], 1, "").unwrap();
    let all = texts(&Document::parse(&svg).unwrap());
    assert!(["nominal", "randomised", "undeclared"].iter().all(|name| all.iter().any(|text| text == name)));
    shown.x_scale = Scale::Categories(&["only"]);
    assert!(matches!(chart(&[shown], 1, ""), Err(PictureError::OutOfRange { .. })));

    let frequency = [0.1, 1.0, 10.0];
    let mut bode = panel(vec![series("", &frequency, &[1.0, 2.0, 1.0], Style::Solid)]);
    bode.x_scale = Scale::Log;
    let svg = chart(&[bode.clone()], 1, "").unwrap();
    let document = Document::parse(&svg).unwrap();
    let drawn = &curves(&document, PALETTE[0])[0];
    assert!((2.0 * drawn[1].0 - drawn[0].0 - drawn[2].0).abs() <= 2.0, "{drawn:?}");
    assert!(["0.1", "1", "10"].iter().all(|number| texts(&document).iter().any(|text| text == number)));
    bode.series[0].x = &X;
    assert!(matches!(chart(&[bode], 1, ""), Err(PictureError::OutOfRange { .. })));
}
