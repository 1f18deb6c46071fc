//! Tests of charts, read back from their SVG.

mod common;

use common::{assert_on_page, curves, dots, elements, texts};
use crazyflie_picture::{BLUE, GREEN, Panel, PictureError, Style, VERMILION, chart, tiles};

const X: [f64; 3] = [0.0, 1.0, 2.0];

fn panel() -> Panel {
    Panel::new("time (s)", "height (m)").title("Panel")
}

fn svg(panel: Panel) -> String {
    chart(&[panel], 1, "").unwrap().svg()
}

#[test]
fn a_grid_of_panels_names_everything_with_units() {
    let y = [0.1, 0.4, 0.2];
    let labels = ["flown", "wanted", "fixes", "command"];
    let styles = [Style::Solid, Style::Dashed, Style::Points, Style::Step];
    let all = labels.iter().zip(styles);
    let first = all.fold(panel(), |panel, (label, style)| panel.curve(style, BLUE, *label, X, y));
    let second = panel().curve(Style::Solid, BLUE, "a < b & \"c\"", X, y);
    let second = second.band(GREEN, "tolerance", [-0.5, 0.5]).level(VERMILION, "limit", 1.5);
    let svg = chart(&[first, second], 2, "Flight").unwrap().svg();
    let texts = texts(&svg);
    for wanted in
        ["Flight", "time (s)", "height (m)", "a < b & \"c\"", "tolerance", "limit"].iter().chain(&labels)
    {
        assert!(texts.iter().any(|text| text == wanted), "{wanted} is missing in {texts:?}");
    }
    let elements = elements(&svg);
    assert_eq!((elements[1].name, elements[1].attribute("fill")), ("rect", Some("#FFFFFF")));
    assert!(elements.iter().any(|element| element.attribute("stroke-dasharray").is_some()));
    assert_on_page(&svg);
}

#[test]
fn curves_run_right_and_up() {
    let svg = svg(panel().curve(Style::Solid, BLUE, "", X, [0.0, 0.5, 2.0]));
    let drawn = &curves(&svg, BLUE)[0];
    assert_eq!(drawn.len(), 3);
    assert!(drawn.windows(2).all(|pair| pair[1][0] > pair[0][0] && pair[1][1] < pair[0][1]));
    // Evenly spaced in x, and y to scale: the first rise is a quarter of the whole.
    assert!((2.0 * drawn[1][0] - drawn[0][0] - drawn[2][0]).abs() <= 0.5);
    assert!((drawn[0][1] - drawn[1][1] - 0.25 * (drawn[0][1] - drawn[2][1])).abs() <= 0.5);
}

#[test]
fn steps_hold_the_value_before() {
    let svg = svg(panel().curve(Style::Step, BLUE, "", X, [0.0, 1.0, 0.5]));
    let drawn = &curves(&svg, BLUE)[0];
    assert_eq!(drawn.len(), 5);
    assert!(drawn[0][1] == drawn[1][1] && drawn[1][0] == drawn[2][0] && drawn[2][1] == drawn[3][1]);
}

#[test]
fn levels_and_bands_are_inside_the_axes_and_behind_the_curves() {
    let shown = panel().curve(Style::Solid, BLUE, "", X, [0.0, 0.0, 0.1]);
    let svg = svg(shown.level(VERMILION, "", 8.0).band(GREEN, "", [-3.0, -4.0]));
    let texts = texts(&svg);
    assert!(texts.contains(&"8".to_owned()) && texts.contains(&"-4".to_owned()), "{texts:?}");
    assert_on_page(&svg);
    let place = |color: &str| {
        elements(&svg).iter().position(|e| e.attribute("stroke").or(e.attribute("fill")) == Some(color))
    };
    assert!(place("#009E73") < place("#D55E00") && place("#D55E00") < place("#0072B2"));
}

#[test]
fn a_hundred_thousand_points_make_a_small_file_that_keeps_the_peak() {
    let x: Vec<f64> = (0..100_000).map(|i| f64::from(i) * 0.01).collect();
    let mut y: Vec<f64> = x.iter().map(|x| (x * 91.7).sin()).collect();
    y[54_321] = 5.0;
    let backwards: Vec<f64> = x.iter().map(|x| (x * 3.0).cos()).collect();
    for style in [Style::Solid, Style::Dashed, Style::Points, Style::Step] {
        for across in [&x, &backwards] {
            let svg = svg((0..3).fold(panel(), |panel, _| panel.curve(style, BLUE, "gyro", across, &y)));
            assert!(svg.len() < 1_000_000, "{style:?}: {} bytes", svg.len());
            elements(&svg);
        }
    }
    let svg = svg(panel().curve(Style::Solid, BLUE, "gyro", &x, &y));
    assert!(svg.len() < 100_000);
    let drawn = &curves(&svg, BLUE)[0];
    let top = drawn.iter().map(|p| p[1]).fold(f64::MAX, f64::min);
    let peak_x = drawn.iter().find(|p| p[1] == top).unwrap()[0];
    let (first, last) = (drawn[0][0], drawn[drawn.len() - 1][0]);
    assert!(((peak_x - first) / (last - first) - 0.54321).abs() < 0.002);
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
        let both = panel().curve(Style::Solid, BLUE, "s", X, y).curve(Style::Solid, BLUE, "t", y, X);
        assert_on_page(&svg(both));
    }
    let single = chart(&[panel().curve(Style::Solid, BLUE, "s", [1.0], [2.0])], 3, "").unwrap().svg();
    assert_eq!(dots(&single), 1);
}

#[test]
fn long_texts_are_made_to_fit() {
    let long = "a very long description of a quantity that goes on and on, and then on (m/s)";
    let shown = Panel::new(long, long).title(long).curve(Style::Solid, BLUE, long, X, X);
    let shown = shown.curve(Style::Dashed, BLUE, long, X, X);
    assert_on_page(&chart(&vec![shown; 6], 3, &long.repeat(2)).unwrap().svg());
}

#[test]
fn charts_that_cannot_be_drawn_say_why() {
    let refused = |label: &str, x: &[f64], y: &[f64]| {
        chart(&[panel().curve(Style::Solid, BLUE, label, x, y)], 1, "").unwrap_err()
    };
    let nan = refused("pitch", &X, &[0.0, f64::NAN, 1.0]);
    assert_eq!(nan, PictureError::NonFinite { what: "series \"pitch\": y".to_owned(), index: 1 });
    let huge = refused("pitch", &[0.0, 1.0, 1e301], &X);
    assert!(matches!(huge, PictureError::OutOfRange { index: 2, .. }));
    let uneven = refused("roll", &X, &X[..2]);
    assert_eq!(uneven, PictureError::LengthMismatch { label: "roll".to_owned(), x: 3, y: 2 });
    assert!(matches!(refused("yaw", &[], &[]), PictureError::Empty { .. }));
    assert!(matches!(chart(&[], 1, ""), Err(PictureError::Empty { .. })));
    let only_a_level = panel().level(BLUE, "limit", 1.0);
    assert!(matches!(chart(&[panel(), only_a_level], 1, ""), Err(PictureError::Empty { .. })));
    let fine = panel().curve(Style::Solid, BLUE, "", X, X);
    assert!(matches!(chart(&[fine], 0, ""), Err(PictureError::ZeroSize { .. })));
}

#[test]
fn a_curve_that_leaves_the_limits_ends_on_the_edge() {
    let (x, y) = ([0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 0.5, 1.0, 40.0, 9000.0]);
    let shown = panel().curve(Style::Solid, BLUE, "", x, y);
    let limited = svg(shown.clone().y_limits([0.0, 2.0]));
    let drawn = curves(&limited, BLUE);
    assert_eq!(drawn.len(), 1);
    let [.., before, last] = drawn[0][..] else { panic!("{drawn:?}") };
    // it goes on rising to the edge, and is not drawn flat along it
    assert!(last[1] < before[1] - 40.0 && last[0] > before[0], "{drawn:?}");
    assert_on_page(&limited);
    assert!(matches!(chart(&[shown.y_limits([2.0, 2.0])], 1, ""), Err(PictureError::OutOfRange { .. })));
}

#[test]
fn what_comes_after_the_first_curve_is_cut_around_it() {
    let first = panel().curve(Style::Solid, BLUE, "", X, [0.0, 1.0, 0.0]).cut_around(0.5, 0.1);
    let near = first.clone().curve(Style::Solid, VERMILION, "", X, [0.2, 0.4, 0.6]);
    let far = first.curve(Style::Solid, VERMILION, "", X, [0.2, 0.4, 900.0]);
    let numbers = |svg: &str| texts(svg).iter().filter_map(|text| text.parse().ok()).fold(0.0, f64::max);
    assert_eq!(numbers(&svg(near)), 2.0, "the axis of x, with y up to 1");
    let far = svg(far);
    assert_on_page(&far);
    assert!(texts(&far).contains(&"1.50".to_owned()) && !texts(&far).contains(&"1.75".to_owned()));
}

#[test]
fn categories_are_named_and_decades_are_evenly_apart() {
    let shown = panel().curve(Style::Points, BLUE, "", X, [1.0, 2.0, 1.5]);
    let all = texts(&svg(shown.clone().categories(["nominal", "randomised", "undeclared"])));
    assert!(["nominal", "randomised", "undeclared"].iter().all(|name| all.iter().any(|text| text == name)));
    assert!(matches!(chart(&[shown.categories(["only"])], 1, ""), Err(PictureError::OutOfRange { .. })));

    let bode = |x: [f64; 3]| panel().log_x().curve(Style::Solid, BLUE, "", x, [1.0, 2.0, 1.0]);
    let drawn_svg = svg(bode([0.1, 1.0, 10.0]));
    let drawn = &curves(&drawn_svg, BLUE)[0];
    assert!((2.0 * drawn[1][0] - drawn[0][0] - drawn[2][0]).abs() <= 0.5, "{drawn:?}");
    assert!(["0.1", "1", "10"].iter().all(|number| texts(&drawn_svg).iter().any(|text| text == number)));
    assert!(matches!(chart(&[bode(X)], 1, ""), Err(PictureError::OutOfRange { .. })));
}

#[test]
fn tiles_have_one_size_and_one_frame() {
    let large = panel().curve(Style::Solid, BLUE, "a", X, [1e5, 2e5, 3e5]);
    let small = Panel::new("time (s)", "height (m)").curve(Style::Solid, BLUE, "", X, X);
    let drawn: Vec<String> =
        tiles(&[large, small], [300.0, 90.0]).unwrap().iter().map(|tile| tile.svg()).collect();
    let left = |svg: &str| curves(svg, BLUE)[0][0][0];
    assert_eq!(left(&drawn[0]), left(&drawn[1]));
    let size = |svg: &str| ["width", "height"].map(|side| elements(svg)[0].number(side));
    assert_eq!(size(&drawn[0]), size(&drawn[1]));
    assert_eq!(size(&drawn[0])[0], 300.0);
}
