//! Frames for a terminal.

use std::fmt::Write as _;

use crate::PictureError;

/// Turns an RGB frame (`height * width * 3` bytes, row after row) into text for a terminal with 24-bit
/// colour.
///
/// Each character is an upper half block over two picture cells. The text is `columns` characters wide (never
/// more than `width`) and as many lines high as keeps the picture's proportions with characters twice as high
/// as wide. Every line ends with a colour reset and a newline. No cursor movement is included.
///
/// # Errors
/// [`PictureError::ZeroSize`] when a size or `columns` is zero, [`PictureError::TooLarge`] for sizes that
/// overflow, [`PictureError::BufferLength`].
pub fn ansi(rgb: &[u8], width: usize, height: usize, columns: usize) -> Result<String, PictureError> {
    if width == 0 || height == 0 || columns == 0 {
        return Err(PictureError::ZeroSize { width: width.min(columns), height });
    }
    let limit = usize::MAX / 3;
    let bytes = width.checked_mul(height).and_then(|pixels| pixels.checked_mul(3));
    let expected = bytes.ok_or(PictureError::TooLarge { width, height, limit })?;
    if rgb.len() != expected {
        return Err(PictureError::BufferLength { expected, actual: rgb.len() });
    }
    let columns = columns.min(width);
    let lines = (height * columns + width) / (2 * width);
    let lines = lines.clamp(1, height.div_ceil(2));
    let cell = |column: usize, row: usize| {
        mean(rgb, width, span(column, columns, width), span(row.min(2 * lines - 1), 2 * lines, height))
    };
    let mut text = String::with_capacity(lines * columns * 24);
    for line in 0..lines {
        let mut before = None;
        for column in 0..columns {
            let pair = (cell(column, 2 * line), cell(column, 2 * line + 1));
            // Long runs of one colour are common; naming it once keeps a frame small enough for slow
            // terminals.
            if before != Some(pair) {
                let ([r, g, b], [s, h, c]) = pair;
                let _ = write!(text, "\x1b[38;2;{r};{g};{b};48;2;{s};{h};{c}m");
                before = Some(pair);
            }
            text.push('\u{2580}');
        }
        text.push_str("\x1b[0m\n");
    }
    Ok(text)
}

/// The pixels that cell `index` of `cells` covers, at least one.
fn span(index: usize, cells: usize, pixels: usize) -> std::ops::Range<usize> {
    let start = (index * pixels / cells).min(pixels - 1);
    start..((index + 1) * pixels / cells).max(start + 1)
}

fn mean(rgb: &[u8], width: usize, x: std::ops::Range<usize>, y: std::ops::Range<usize>) -> [u8; 3] {
    let mut sum = [0_usize; 3];
    let count = x.len() * y.len();
    for row in y {
        for pixel in rgb[(row * width + x.start) * 3..(row * width + x.end) * 3].chunks_exact(3) {
            sum.iter_mut().zip(pixel).for_each(|(total, value)| *total += usize::from(*value));
        }
    }
    sum.map(|total| ((total + count / 2) / count) as u8)
}
