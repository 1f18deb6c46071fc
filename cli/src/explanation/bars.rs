//! Lengths of bars in tables, in percent of the room they have.

/// Share of the largest, and nothing where there is none.
fn linear(value: f64, largest: f64) -> f64 {
    let share = 100.0 * value / largest;
    if share.is_finite() { share.clamp(0.0, 100.0) } else { 0.0 }
}

/// A logarithmic scale of some positive values, the smallest still visible.
#[derive(Debug, Clone, Copy)]
pub(super) struct LogScale {
    low: f64,
    high: f64,
}

impl LogScale {
    pub(super) fn spanning(values: impl Iterator<Item = f64>) -> Self {
        let logs = values.filter(|v| v.is_finite() && *v > 0.0).map(f64::ln);
        let (low, high) = logs.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
        LogScale { low: low - 0.7, high: high.max(low + 0.1) }
    }

    pub(super) fn length(&self, value: f64) -> f64 {
        if value > 0.0 { linear(value.ln() - self.low, self.high - self.low) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decades_are_equally_far_apart_and_nothing_is_no_bar() {
        let log = LogScale::spanning([0.01, 0.1, 1.0, f64::NAN].into_iter());
        let [a, b, c] = [0.01, 0.1, 1.0].map(|v| log.length(v));
        assert!((c - 100.0).abs() < 1e-9 && ((c - b) - (b - a)).abs() < 1e-9 && a > 5.0);
        assert_eq!([log.length(f64::NAN), linear(1.0, 0.0), linear(-1.0, 2.0)], [0.0, 0.0, 0.0]);
    }
}
