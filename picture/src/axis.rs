//! Axis ranges and the numbers along them.

use std::ops::Range;

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};

/// One axis of a chart: what it spans and where its numbers stand.
///
/// plotters' own choice leaves as few as two numbers on an axis, so this one is handed to it instead.
#[derive(Debug, Clone)]
pub(crate) struct Axis {
    range: Range<f64>,
    at: Vec<f64>,
    digits: Digits,
    /// In place of numbers, as many as `at`; empty for numbers.
    names: Vec<String>,
}

/// How numbers on an axis are written: with so many decimals, or so many behind the first digit and an
/// exponent.
#[derive(Debug, Clone, Copy)]
enum Digits {
    Fixed(usize),
    Exponent(usize),
}

impl Axis {
    /// An axis over exactly this range; its numbers are 1, 2, 2.5 or 5 times a power of ten apart, `count` at
    /// most or so.
    pub(crate) fn exact(range: Range<f64>, count: usize) -> Self {
        let step = step(&range, count);
        let (first, last) = (range.start / step - 1e-6, range.end / step + 1e-6);
        Self::with(range, step, first.ceil() as i64, last.floor() as i64)
    }

    /// As [`Axis::exact`], but ended on a number that is less than 2 % farther out; recordings end just short
    /// of one.
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
        let at: Vec<f64> = (first..=last).map(|k| k as f64 * step).collect();
        let size = at.iter().map(|value| value.abs()).fold(step, f64::max);
        let digits = if (1e-4..1e6).contains(&size) {
            Digits::Fixed(decimals(step))
        } else {
            Digits::Exponent((1 + (size / step).log10().ceil() as usize).min(15))
        };
        Self { range, at, digits, names: Vec::new() }
    }

    /// An axis of decimal logarithms, with a number at each power of ten, or at 2 and 5 as well where there
    /// would be fewer than two.
    pub(crate) fn decades(range: Range<f64>) -> Self {
        let (first, last) = (range.start.floor() as i32, range.end.ceil() as i32);
        let fits = |power: &f64| *power >= range.start - 1e-9 && *power <= range.end + 1e-9;
        let numbers = |parts: &[f64]| -> Vec<f64> {
            let all =
                (first..=last).flat_map(|decade| parts.iter().map(move |k| f64::from(decade) + k.log10()));
            all.filter(fits).collect()
        };
        let mut at = numbers(&[1.0]);
        if at.len() < 2 {
            at = numbers(&[1.0, 2.0, 5.0]);
        }
        let text = |power: &f64| {
            let (value, decimals) = (10_f64.powf(*power), (-power.floor()).max(0.0) as usize);
            if (-4.0..6.0).contains(power) { format!("{value:.decimals$}") } else { format!("{value:.0e}") }
        };
        let names = at.iter().map(text).collect();
        Self { range, at, digits: Digits::Fixed(0), names }
    }

    /// An axis with a name at each whole number from 0 on.
    pub(crate) fn categories(names: &[&str]) -> Self {
        let at = (0..names.len()).map(|i| i as f64).collect();
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        let range = -0.5..names.len() as f64 - 0.5;
        Self { range, at, digits: Digits::Fixed(0), names }
    }

    pub(crate) fn start(&self) -> f64 {
        self.range.start
    }

    pub(crate) fn end(&self) -> f64 {
        self.range.end
    }

    /// Where a value stands: 0 at the start of the axis, 1 at its end.
    pub(crate) fn part(&self, value: f64) -> f64 {
        (value - self.range.start) / (self.range.end - self.range.start)
    }

    /// The numbers and their texts.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = (f64, String)> {
        self.at.iter().map(|value| (*value, Self::format_ext(self, value)))
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (from, to): (i32, i32)) -> i32 {
        from + (self.part(*value) * f64::from(to - from)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        // Only the bold grid lines carry numbers; there are no light ones.
        if hint.weight().allow_light_points() { Vec::new() } else { self.at.clone() }
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}

impl ValueFormatter<f64> for Axis {
    fn format_ext(&self, value: &f64) -> String {
        let place = self.at.iter().position(|at| at == value);
        if let Some(name) = place.and_then(|i| self.names.get(i)) {
            return name.clone();
        }
        match self.digits {
            Digits::Exponent(_) if *value == 0.0 => "0".to_owned(),
            Digits::Exponent(digits) => {
                let text = format!("{value:.digits$e}");
                let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
                let mantissa = match mantissa.contains('.') {
                    true => mantissa.trim_end_matches('0').trim_end_matches('.'),
                    false => mantissa,
                };
                format!("{mantissa}e{exponent}")
            }
            // Adding zero turns a negative zero into zero.
            Digits::Fixed(decimals) => format!("{:.decimals$}", value + 0.0),
        }
    }
}

/// Smallest range that holds all values; opened where they are all the same.
pub(crate) fn span(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    let size = low.abs().max(high.abs());
    if high - low > 1e-9 * size.max(1e-6) {
        return low..high;
    }
    let half = if size == 0.0 { 1.0 } else { 0.1 * size };
    low - half..high + half
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
        axis.numbers().map(|(_, text)| text).collect()
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
        assert!((axis.start() + 0.6).abs() < 1e-12 && (axis.end() - 0.6).abs() < 1e-12);
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
        assert_eq!(texts(&Axis::categories(&["a", "b"])), ["a", "b"]);
    }

    #[test]
    fn a_constant_gets_a_range_around_it() {
        let range = span([0.7, 0.7].into_iter());
        assert!(range.start < 0.7 && range.end > 0.7);
        assert_eq!(span([0.0].into_iter()), -1.0..1.0);
    }
}
