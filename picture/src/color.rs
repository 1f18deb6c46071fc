//! Colours of charts.

/// Red, green and blue.
pub type Color = [u8; 3];

/// Blue of Okabe and Ito.
pub const BLUE: Color = [0, 114, 178];
/// Vermilion of Okabe and Ito.
pub const VERMILION: Color = [213, 94, 0];
/// Bluish green of Okabe and Ito.
pub const GREEN: Color = [0, 158, 115];
/// Reddish purple of Okabe and Ito.
pub const PURPLE: Color = [204, 121, 167];
/// Black.
pub const BLACK: Color = [0, 0, 0];
/// Sky blue of Okabe and Ito.
pub const SKY: Color = [86, 180, 233];
/// Orange of Okabe and Ito.
pub const ORANGE: Color = [230, 159, 0];
/// Yellow of Okabe and Ito.
pub const YELLOW: Color = [240, 228, 66];
/// Grey, for what others are compared with.
pub const GREY: Color = [165, 172, 181];

/// The Okabe-Ito colours, distinct to readers with any colour vision; ordered so that the first few differ most in
/// print. Yellow is last because thin yellow lines fade on white.
pub const PALETTE: [Color; 8] = [BLUE, VERMILION, GREEN, PURPLE, BLACK, SKY, ORANGE, YELLOW];

/// Texts, grid lines and axes.
pub(crate) const INK: Color = [38, 44, 52];
pub(crate) const FAINT: Color = [226, 230, 235];
pub(crate) const FRAME: Color = [120, 130, 142];
