//! The one error type of the crate.

use thiserror::Error;

/// Why a picture could not be drawn. Nothing is written to the output in that case.
#[derive(Debug, Clone, PartialEq, Error)]
#[allow(missing_docs, reason = "each variant lists its fields")]
pub enum PictureError {
    /// Width, height or the number of columns is zero.
    ///
    /// - `width`: width in pixels or columns.
    /// - `height`: height in pixels or rows.
    #[error("a picture needs at least one pixel and one column, got {width} x {height}")]
    ZeroSize { width: usize, height: usize },
    /// The frame is larger than the renderer is willing to allocate.
    ///
    /// - `width`: requested width.
    /// - `height`: requested height.
    /// - `limit`: largest accepted side.
    #[error("{width} x {height} is too large, the limit is {limit} on each side")]
    TooLarge { width: usize, height: usize, limit: usize },
    /// The pixel buffer does not have `height * width * 3` bytes.
    ///
    /// - `expected`: `height * width * 3`.
    /// - `actual`: length of the buffer handed over.
    #[error("the RGB buffer has {actual} bytes, expected {expected}")]
    BufferLength { expected: usize, actual: usize },
    /// A number is NaN or infinite.
    ///
    /// - `what`: which input, for example `series "height": y` or `drone position`.
    /// - `index`: index of the offending element within that input.
    #[error("{what}, element {index}, is not a finite number")]
    NonFinite { what: String, index: usize },
    /// A finite number is outside what can be drawn.
    ///
    /// - `what`: which input.
    /// - `index`: index of the offending element within that input.
    /// - `value`: the value.
    /// - `low`: smallest accepted value.
    /// - `high`: largest accepted value.
    #[error("{what}, element {index}, is out of range: {value} is not in {low} to {high}")]
    OutOfRange { what: String, index: usize, value: f64, low: f64, high: f64 },
    /// A series has a different number of x and y values.
    ///
    /// - `label`: label of the series.
    /// - `x`: number of x values.
    /// - `y`: number of y values.
    #[error("series \"{label}\" has {x} x values and {y} y values")]
    LengthMismatch { label: String, x: usize, y: usize },
    /// There is nothing to draw: no panel, no curve in a panel, or no point in a series.
    ///
    /// - `what`: title or label of the empty part.
    #[error("{what} is empty")]
    Empty { what: String },
    /// The ending of a file names no format.
    ///
    /// - `file`: path as given.
    /// - `known`: endings that there are.
    #[error("no picture is drawn as {file:?}, name a file that ends in one of {known}")]
    Format { file: String, known: String },
    /// A file could not be encoded.
    #[error("the picture cannot be encoded: {0}")]
    Encode(String),
}

/// Refuses values that are not finite or lie outside of a range; the error names the input and the index within
/// it.
pub(crate) fn within<T: Copy + Into<f64>>(
    what: &str,
    index: usize,
    values: &[T],
    low: T,
    high: T,
) -> Result<(), PictureError> {
    let (low, high) = (low.into(), high.into());
    let mut values = values.iter().map(|value| (*value).into());
    let Some(value) = values.find(|value| !(low..=high).contains(value)) else { return Ok(()) };
    let what = what.to_owned();
    if !value.is_finite() {
        return Err(PictureError::NonFinite { what, index });
    }
    Err(PictureError::OutOfRange { what, index, value, low, high })
}
