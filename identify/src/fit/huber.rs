//! Huber's loss: outliers of a marker count linearly.

/// Residuals beyond so many standard deviations count linearly.
const HUBER: f64 = 3.0;

/// Loss of a residual in standard deviations, and its weight in a step of least squares.
#[inline(always)]
pub fn huber(residual: f64) -> (f64, f64) {
    let size = residual.abs();
    if size > HUBER { (HUBER * (size - 0.5 * HUBER), HUBER / size) } else { (0.5 * size * size, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weight_is_the_slope_over_the_residual() {
        for residual in [-7.0, -3.1, -2.9, 0.4, 2.9, 3.1, 7.0] {
            let slope = (huber(residual + 1e-6).0 - huber(residual - 1e-6).0) / 2e-6;
            assert!((slope / residual - huber(residual).1).abs() < 1e-6, "{residual}");
        }
        assert_eq!((huber(0.0), huber(3.0)), ((0.0, 1.0), (4.5, 1.0)));
    }
}
