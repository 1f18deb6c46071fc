//! The one error type of the crate.

use thiserror::Error;

/// Why a picture could not be drawn. Nothing is written to the output in that case.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PictureError {
    /// Width, height or the number of columns is zero.
    #[error("a picture needs at least one pixel and one column, got {width} x {height}")]
    ZeroSize {
        /// Width in pixels or columns.
        width: usize,
        /// Height in pixels or rows.
        height: usize,
    },
    /// The frame is larger than the renderer is willing to allocate.
    #[error("{width} x {height} is too large, the limit is {limit} on each side")]
    TooLarge {
        /// Requested width.
        width: usize,
        /// Requested height.
        height: usize,
        /// Largest accepted side.
        limit: usize,
    },
    /// The pixel buffer does not have `height * width * 3` bytes.
    #[error("the RGB buffer holds {actual} bytes, {expected} were expected")]
    BufferLength {
        /// `height * width * 3`.
        expected: usize,
        /// Length of the buffer handed over.
        actual: usize,
    },
    /// A number is NaN or infinite.
    #[error("{what}, element {index}, is not a finite number")]
    NonFinite {
        /// Which input, for example `series "height": y` or `drone position`.
        what: String,
        /// Index of the offending element within that input.
        index: usize,
    },
    /// A finite number is outside what can be drawn.
    #[error("{what}, element {index}, is out of range: {value} is not in {low} to {high}")]
    OutOfRange {
        /// Which input.
        what: String,
        /// Index of the offending element within that input.
        index: usize,
        /// The value.
        value: f64,
        /// Smallest accepted value.
        low: f64,
        /// Largest accepted value.
        high: f64,
    },
    /// A series has a different number of x and y values.
    #[error("series \"{label}\" has {x} x values and {y} y values")]
    LengthMismatch {
        /// Label of the series.
        label: String,
        /// Number of x values.
        x: usize,
        /// Number of y values.
        y: usize,
    },
    /// There is nothing to draw: no panel, no curve in a panel, or no point in a series.
    #[error("{what} is empty")]
    Empty {
        /// Title or label of the empty part.
        what: String,
    },
    /// The ending of a file names no format.
    #[error("no picture is drawn as {file:?}, name a file that ends in one of {known}")]
    Format {
        /// Path as given.
        file: String,
        /// Endings that there are.
        known: String,
    },
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
