//! Terminal frames, read back character by character.

use crazyflie_picture::{PictureError, ansi};

/// A picture whose upper half is red and whose lower half is blue, with a green right half below.
fn picture(width: usize, height: usize) -> Vec<u8> {
    let color = |x: usize, y: usize| match (2 * x < width, 2 * y < height) {
        (_, true) => [200, 0, 0],
        (true, false) => [0, 0, 200],
        (false, false) => [0, 200, 0],
    };
    (0..height).flat_map(|y| (0..width).flat_map(move |x| color(x, y))).collect()
}

#[test]
fn each_character_shows_the_pixels_it_covers() {
    let text = ansi(&picture(8, 4), 8, 4, 2).unwrap();
    let up_blue = "\x1b[38;2;200;0;0;48;2;0;0;200m\u{2580}";
    let up_green = "\x1b[38;2;200;0;0;48;2;0;200;0m\u{2580}";
    // Two columns of four pixels need half a line; the least is one.
    assert_eq!(text, format!("{up_blue}{up_green}\x1b[0m\n"));
}

#[test]
fn proportions_are_kept() {
    for (width, height, columns, lines) in [(480, 360, 80, 30), (100, 100, 100, 50), (64, 48, 200, 24)] {
        let text = ansi(&picture(width, height), width, height, columns).unwrap();
        assert_eq!(text.lines().count(), lines);
        assert!(text.lines().all(|line| line.matches('\u{2580}').count() == columns.min(width)));
        assert!(text.lines().all(|line| line.ends_with("\x1b[0m")));
    }
}

#[test]
fn colours_are_averaged() {
    let stripes: Vec<u8> =
        (0..16).flat_map(|i| if i % 2 == 0 { [0, 10, 255] } else { [100, 10, 0] }).collect();
    let text = ansi(&stripes, 4, 4, 2).unwrap();
    assert!(text.starts_with("\x1b[38;2;50;10;128;48;2;50;10;128m"), "{text:?}");
    // A run of one colour names it once.
    assert_eq!(text.matches("38;2").count(), 1);
}

#[test]
fn single_pixels_work() {
    assert_eq!(ansi(&[1, 2, 3], 1, 1, 80).unwrap(), "\x1b[38;2;1;2;3;48;2;1;2;3m\u{2580}\x1b[0m\n");
}

#[test]
fn wrong_sizes_are_refused() {
    assert!(matches!(ansi(&[], 0, 4, 2), Err(PictureError::ZeroSize { .. })));
    assert!(matches!(ansi(&[0; 12], 2, 2, 0), Err(PictureError::ZeroSize { .. })));
    let short = Err(PictureError::BufferLength { expected: 12, actual: 11 });
    assert_eq!(ansi(&[0; 11], 2, 2, 2), short);
    assert!(matches!(ansi(&[], usize::MAX, 3, 2), Err(PictureError::TooLarge { .. })));
}
