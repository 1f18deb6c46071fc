//! Axis ranges and the numbers along them.

use std::ops::Range;

use crate::font;

/// One axis of a chart: its range and the positions of its numbers.
#[derive(Debug, Clone)]
pub(crate) struct Axis {
    pub(crate) range: Range<f64>,
    pub(crate) ticks: Vec<(f64, String)>,
}

impl Axis {
    /// An axis over exactly this range; its numbers are 1, 2, 2.5 or 5 times a power of ten apart, `count` at
    /// most or so.
    pub(crate) fn exact(range: Range<f64>, count: usize) -> Self {
        let step = step(&range, count);
        let (first, last) = (range.start / step - 1e-6, range.end / step + 1e-6);
        Self::with(range, step, first.ceil() as i64, last.floor() as i64)
    }

    /// Creates an axis like [`Axis::exact`], but ends it on a round number less than 2 % farther out; recordings end
    /// just short of one.
    pub(crate) fn tidy(range: Range<f64>, count: usize) -> Self {
        let (step, reach) = (step(&range, count), 0.02 * (range.end - range.start));
        let (low, high) = ((range.start / step).floor() * step, (range.end / step).ceil() * step);
        let start = if low >= range.start - reach { low } else { range.start };
        let end = if high <= range.end + reach { high } else { range.end };
        Self::exact(start..end, count)
    }

    /// An axis that is opened to end on numbers.
    pub(crate) fn whole(range: Range<f64>, count: usize) -> Self {
        let step = step(&range, count);
        // A bound that is a whole step but for rounding is not pushed to the next one.
        let (first, last) = (range.start / step + 1e-6, range.end / step - 1e-6);
        let (first, last) = (first.floor() as i64, last.ceil() as i64);
        Self::with(first as f64 * step..last as f64 * step, step, first, last)
    }

    fn with(range: Range<f64>, step: f64, first: i64, last: i64) -> Self {
        let values = (first..=last).map(|k| k as f64 * step);
        let size = values.clone().map(f64::abs).fold(step, f64::max);
        let text = |value: f64| {
            if (1e-4..1e6).contains(&size) {
                // Adding zero turns a negative zero into zero.
                return format!("{:.*}", decimals(step), value + 0.0);
            }
            let digits = (1 + (size / step).log10().ceil() as usize).min(15);
            let text = format!("{:.digits$e}", value + 0.0);
            let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
            let mantissa = mantissa.trim_end_matches('0').trim_end_matches('.');
            if value == 0.0 { "0".to_owned() } else { format!("{mantissa}e{exponent}") }
        };
        Self { range, ticks: values.map(|value| (value, text(value))).collect() }
    }

    /// An axis of decimal logarithms, with a number at each power of ten, or at 2 and 5 as well where there
    /// would be fewer than two.
    pub(crate) fn decades(range: Range<f64>) -> Self {
        let text = |power: f64| {
            let (value, decimals) = (10_f64.powf(power), (-power.floor()).max(0.0) as usize);
            if (-4.0..6.0).contains(&power) { format!("{value:.decimals$}") } else { format!("{value:.0e}") }
        };
        let numbers = |parts: &[f64]| -> Vec<(f64, String)> {
            let decades = range.start.floor() as i32..=range.end.ceil() as i32;
            let powers = decades.flat_map(|decade| parts.iter().map(move |k| f64::from(decade) + k.log10()));
            let shown = powers.filter(|power| (range.start - 1e-9..=range.end + 1e-9).contains(power));
            shown.map(|power| (power, text(power))).collect()
        };
        let mut ticks = numbers(&[1.0]);
        if ticks.len() < 2 {
            ticks = numbers(&[1.0, 2.0, 5.0]);
        }
        Self { range, ticks }
    }

    /// An axis with a name at each whole number from 0 on.
    pub(crate) fn categories(names: &[String]) -> Self {
        let ticks = names.iter().enumerate().map(|(i, name)| (i as f64, name.clone())).collect();
        Self { range: -0.5..names.len() as f64 - 0.5, ticks }
    }

    /// Returns the position of a value: 0 at the start of the axis, 1 at its end.
    pub(crate) fn part(&self, value: f64) -> f64 {
        (value - self.range.start) / (self.range.end - self.range.start)
    }

    /// Width of the longest text in ems.
    pub(crate) fn longest_em(&self) -> f64 {
        self.ticks.iter().map(|(_, text)| font::width_em(text, false)).fold(0.0, f64::max)
    }
}

/// Returns the smallest range of all values.
pub(crate) fn bounds(values: impl Iterator<Item = f64>) -> Range<f64> {
    values.fold(f64::MAX..f64::MIN, |range, value| range.start.min(value)..range.end.max(value))
}

/// Returns a range, widened if it has a single value.
pub(crate) fn opened(Range { start, end }: Range<f64>) -> Range<f64> {
    let size = start.abs().max(end.abs());
    if end - start > 1e-9 * size.max(1e-6) {
        return start..end;
    }
    let half = if size == 0.0 { 1.0 } else { 0.1 * size };
    start - half..end + half
}

/// The smallest of 1, 2, 2.5 and 5 times a power of ten that fits into the range at most `count` times.
fn step(range: &Range<f64>, count: usize) -> f64 {
    let least = (range.end - range.start) / count as f64;
    let power = 10_f64.powf(least.log10().floor());
    // Half a per mille short of fitting is a rounding error.
    let fits = |step: &f64| *step >= 0.9995 * least;
    let steps = [1.0, 2.0, 2.5, 5.0].map(|k| k * power);
    steps.into_iter().find(fits).unwrap_or(10.0 * power)
}

/// Decimals that multiples of a step need.
fn decimals(step: f64) -> usize {
    let whole = |decimals: &usize| {
        let scaled = step * 10_f64.powi(*decimals as i32);
        scaled > 0.5 && (scaled - scaled.round()).abs() < 1e-6 * scaled
    };
    (0..15).find(whole).unwrap_or(15)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(axis: &Axis) -> Vec<String> {
        axis.ticks.iter().map(|(_, text)| text.clone()).collect()
    }

    fn exact(range: Range<f64>) -> Vec<String> {
        texts(&Axis::exact(range, 6))
    }

    #[test]
    fn numbers_have_no_needless_decimals() {
        assert_eq!(exact(0.0..10.0), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(exact(-0.3..0.3), ["-0.3", "-0.2", "-0.1", "0.0", "0.1", "0.2", "0.3"]);
        assert_eq!(exact(0.0..3.0e7), ["0", "5e6", "1e7", "1.5e7", "2e7", "2.5e7", "3e7"]);
        assert_eq!(exact(0.0..2.0e-6), ["0", "5e-7", "1e-6", "1.5e-6", "2e-6"]);
    }

    #[test]
    fn every_axis_has_three_different_numbers_or_more() {
        let awkward =
            [9.0e5..9.00001e5, -0.004..0.001, 0.0..65535.0, -4.6..8.6, 1e7..1e7 + 1.0, -1e300..1e300];
        for range in awkward {
            let mut texts = exact(range);
            let count = texts.len();
            texts.dedup();
            assert!(texts.len() == count && (3..=8).contains(&count), "{texts:?}");
        }
    }

    #[test]
    fn boxes_end_on_numbers() {
        let axis = Axis::whole(-0.55..0.55, 6);
        assert!((axis.range.start + 0.6).abs() < 1e-12 && (axis.range.end - 0.6).abs() < 1e-12);
        assert_eq!(texts(&axis).len(), 7);
        assert_eq!(Axis::whole(0.0..0.8, 6).range, 0.0..0.8);
    }

    #[test]
    fn recordings_that_end_short_of_a_number_get_it() {
        assert_eq!(Axis::tidy(0.0..7.98, 7).range, 0.0..8.0);
        assert_eq!(Axis::tidy(0.0..7.5, 7).range, 0.0..7.5);
    }

    #[test]
    fn decades_and_categories_have_their_own_texts() {
        assert_eq!(texts(&Axis::decades(-2.0..2.0)), ["0.01", "0.1", "1", "10", "100"]);
        assert_eq!(texts(&Axis::decades(0.1..0.9)), ["2", "5"]);
        assert_eq!(texts(&Axis::categories(&["a".into(), "b".into()])), ["a", "b"]);
    }

    #[test]
    fn a_constant_gets_a_range_around_it() {
        let range = opened(bounds([0.7, 0.7].into_iter()));
        assert!(range.start < 0.7 && range.end > 0.7);
        assert_eq!(opened(bounds([0.0].into_iter())), -1.0..1.0);
    }
}
