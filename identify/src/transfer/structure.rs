//! The form of a transfer function, and the numbers that a fit moves.
//!
//! A denominator is a product of s^2 + p s + q and at most one s + p: every polynomial is one, and a stable vehicle
//! has no negative p or q. So stability is a matter of bounds.

use std::fmt;

use crazyflie_control::loop_analysis;
use crazyflie_env::transfer_function::product;
use nalgebra::{Complex, DMatrix};

use crate::{Error, Result};

/// Degree of the largest denominator: its states, its numbers, delay and offset then fit the directions of a
/// dual number.
pub const LARGEST: usize = 4;
/// No vehicle of this size answers later.
pub const DELAY_MAX_S: f64 = 0.3;
const FAR: f64 = 1e9;

/// Offset of the input: a value from which it counts, such as the PWM at which the rotors begin to lift (5.1.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Offset {
    /// The input counts from 0.
    None,
    /// The same for all flights.
    Shared,
    /// Trim and battery differ between flights.
    PerFlight,
}

/// Structure of a transfer function: degrees, integrator, delay, offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Structure {
    /// Degree, below that of the denominator.
    pub numerator: usize,
    /// Degree, the integrator included.
    pub denominator: usize,
    /// One pole at zero.
    pub integrator: bool,
    /// Dead time of the input.
    pub delay: bool,
    /// Value from which the input counts.
    pub offset: Offset,
    /// No pole to the right of zero.
    pub stable: bool,
}

impl Structure {
    /// # Errors
    /// [`Error::Options`].
    pub fn check(&self) -> Result<()> {
        if !(1..=LARGEST).contains(&self.denominator) {
            return Err(self.refused("the denominator's degree must be 1 to 4"));
        }
        let is_proper = self.numerator < self.denominator;
        let refused = || self.refused("the numerator's degree must be less than the denominator's");
        if is_proper { Ok(()) } else { Err(refused()) }
    }

    /// An error about this order.
    pub(super) fn refused(&self, reason: &str) -> Error {
        let order = format!("{},{}", self.numerator, self.denominator);
        Error::Options(format!("a transfer function of order {order} is not supported: {reason}"))
    }

    /// Numbers of the denominator that are free.
    fn poles(&self) -> usize {
        self.denominator - usize::from(self.integrator)
    }

    /// Numbers besides the offsets: numerator, poles, delay.
    pub(super) fn dynamic(&self) -> usize {
        self.numerator + 1 + self.poles() + usize::from(self.delay)
    }

    pub(super) fn offsets(&self, flights: usize) -> usize {
        match self.offset {
            Offset::None => 0,
            Offset::Shared => 1,
            Offset::PerFlight => flights,
        }
    }

    pub(super) fn bounds(&self, flights: usize) -> Vec<[f64; 2]> {
        let numerator = std::iter::repeat_n([-FAR, FAR], self.numerator + 1);
        let poles = std::iter::repeat_n([if self.stable { 0.0 } else { -FAR }, FAR], self.poles());
        let delay = std::iter::repeat_n([0.0, DELAY_MAX_S], usize::from(self.delay));
        let offsets = std::iter::repeat_n([-FAR, FAR], self.offsets(flights));
        numerator.chain(poles).chain(delay).chain(offsets).collect()
    }

    /// The factors of the denominator, highest power first: quadratic ones, a linear one if one is left, the
    /// integrator.
    pub(super) fn factors<N: Copy>(&self, numbers: &[N], one: N, zero: N) -> Vec<Vec<N>> {
        let poles = &numbers[self.numerator + 1..][..self.poles()];
        let free = poles.chunks(2).map(|part| std::iter::once(one).chain(part.iter().copied()).collect());
        free.chain(self.integrator.then(|| vec![one, zero])).collect()
    }

    /// The transfer function of these numbers.
    pub fn function(&self, numbers: &[f64]) -> TransferFunction {
        let denominator =
            self.factors(numbers, 1.0, 0.0).iter().fold(vec![1.0], |all, factor| product(&all, factor));
        let at = self.numerator + 1 + self.poles();
        let delay_s = if self.delay { numbers[at] } else { 0.0 };
        let offsets = numbers[self.dynamic()..].to_vec();
        TransferFunction { numerator: numbers[..=self.numerator].to_vec(), denominator, delay_s, offsets }
    }

    /// The numbers of a denominator, its integrator left out. Real roots are paired, the slowest with the
    /// next; an odd one stays alone.
    pub(super) fn numbers_of(&self, denominator: &[f64]) -> Vec<f64> {
        let mut roots = roots(&denominator[..=self.poles()]);
        roots.sort_by(|a, b| {
            (a.im == 0.0).cmp(&(b.im == 0.0)).then(a.re.total_cmp(&b.re)).then(a.im.total_cmp(&b.im))
        });
        let positive = |p: f64| if self.stable { p.max(0.0) } else { p };
        let pair = |two: &[Complex<f64>]| match two {
            [a, b] => vec![positive(-(a + b).re), positive((a * b).re)],
            one => vec![positive(-one[0].re)],
        };
        // conjugates stand beside each other
        roots.chunks(2).flat_map(pair).collect()
    }

    /// Names and units of the coefficients that [`Structure::coefficients`] gives, then delay and offsets.
    /// `ratio` is the unit of output over input and its power of the second.
    pub(super) fn names(&self, ratio: (&str, i32), input: &str, flights: &[String]) -> Vec<(String, String)> {
        let per = |power: usize, (unit, seconds): (&str, i32)| match (seconds - power as i32, unit) {
            (0, unit) => unit.to_owned(),
            (-1, unit) => format!("{unit}/s"),
            (1, "1") => "s".to_owned(),
            (1, unit) => format!("{unit} s"),
            (n, unit) => format!("{unit}/s^{}", -n),
        };
        let b = (0..=self.numerator).rev().map(|i| (format!("b{i}"), per(self.denominator - i, ratio)));
        let least = usize::from(self.integrator);
        let a =
            (least..self.denominator).rev().map(|i| (format!("a{i}"), per(self.denominator - i, ("1", 0))));
        let delay = self.delay.then(|| ("delay".to_owned(), "s".to_owned()));
        let offset = |name: String| (name, input.to_owned());
        let offsets = match self.offset {
            Offset::None => Vec::new(),
            Offset::Shared => vec![offset("offset".into())],
            Offset::PerFlight => flights.iter().map(|f| offset(format!("offset {f}"))).collect(),
        };
        b.chain(a).chain(delay).chain(offsets).collect()
    }

    /// The numbers as coefficients of polynomials, and the slopes of these (a row each) by the numbers.
    pub(super) fn coefficients(&self, numbers: &[f64]) -> (Vec<f64>, DMatrix<f64>) {
        let (m, poles, count) = (self.numerator + 1, self.poles(), numbers.len());
        let function = self.function(numbers);
        let mut values = numbers.to_vec();
        values[m..m + poles].copy_from_slice(&function.denominator[1..=poles]);
        let mut slopes = DMatrix::identity(count, count);
        let factors = self.factors(numbers, 1.0, 0.0);
        for p in 0..poles {
            // the derivative of a product by a coefficient of one factor is the power that it stands with,
            // times the other factors
            let (own, place) = (p / 2, p % 2);
            let degree = factors[own].len() - 1;
            let mut power = vec![0.0; degree - place];
            power[0] = 1.0;
            let others = factors.iter().enumerate().filter(|(f, _)| *f != own);
            let others = others.fold(power, |all, (_, f)| product(&all, f));
            for row in 0..poles {
                // both end at the constant; the denominator has its leading one in front
                let at = (row + 1 + others.len()).checked_sub(function.denominator.len());
                slopes[(m + row, m + p)] = at.and_then(|at| others.get(at)).copied().unwrap_or(0.0);
            }
        }
        (values, slopes)
    }
}

/// numerator / denominator, highest power first, the denominator monic, of a delayed input that counts from
/// its offset.
#[derive(Debug, Clone, PartialEq)]
pub struct TransferFunction {
    /// Coefficients, highest power first.
    pub numerator: Vec<f64>,
    /// Coefficients, highest power first; the first is 1.
    pub denominator: Vec<f64>,
    /// Dead time of the input.
    pub delay_s: f64,
    /// None, one, or one per flight.
    pub offsets: Vec<f64>,
}

impl TransferFunction {
    /// Computes the poles, in 1/s.
    pub fn poles(&self) -> Vec<Complex<f64>> {
        roots(&self.denominator)
    }

    /// Computes the zeros, in 1/s.
    pub fn zeros(&self) -> Vec<Complex<f64>> {
        roots(&self.numerator)
    }

    /// Output over input at rest; `None` with an integrator.
    pub fn gain(&self) -> Option<f64> {
        let [b, a] = [&self.numerator, &self.denominator].map(|p| p.last().copied().unwrap_or(0.0));
        (a != 0.0).then(|| b / a)
    }
}

impl fmt::Display for TransferFunction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.delay_s > 0.0 {
            write!(f, "exp(-{} s) ", digits(self.delay_s))?;
        }
        let (over, under) = (polynomial(&self.numerator), polynomial(&self.denominator));
        let bracket = |text: &str| if text.contains(' ') { format!("({text})") } else { text.to_owned() };
        write!(f, "{} / {}", bracket(&over), bracket(&under))
    }
}

/// Five digits, as the thesis prints.
fn digits(value: f64) -> String {
    let size = value.abs();
    if size != 0.0 && !(1e-3..1e6).contains(&size) {
        return format!("{value:.4e}");
    }
    let whole = if size < 1.0 { 1 } else { size.log10().floor() as usize + 1 };
    let text = format!("{value:.*}", 5_usize.saturating_sub(whole));
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

fn polynomial(coefficients: &[f64]) -> String {
    let mut text = String::new();
    for (i, c) in coefficients.iter().enumerate().filter(|(_, c)| **c != 0.0) {
        let power = ["", "s", "s^2", "s^3", "s^4"][coefficients.len() - 1 - i];
        let is_plain = *c == 1.0 && !power.is_empty();
        let signed = if text.is_empty() { *c } else { c.abs() };
        let size = if is_plain { String::new() } else { digits(signed) };
        let sign = match (text.is_empty(), *c < 0.0) {
            (true, _) => "",
            (false, true) => " - ",
            (false, false) => " + ",
        };
        let gap = if size.is_empty() || power.is_empty() { "" } else { " " };
        text += &format!("{sign}{size}{gap}{power}");
    }
    if text.is_empty() { "0".into() } else { text }
}

/// The roots of a polynomial, highest power first. Almost real ones are real.
pub(super) fn roots(polynomial: &[f64]) -> Vec<Complex<f64>> {
    if polynomial.iter().any(|c| !c.is_finite()) {
        return Vec::new();
    }
    let real = |z: Complex<f64>| if z.im.abs() < 1e-9 * z.norm() { Complex::new(z.re, 0.0) } else { z };
    loop_analysis::roots(polynomial).into_iter().map(real).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn structure(numerator: usize, denominator: usize, integrator: bool) -> Structure {
        Structure { numerator, denominator, integrator, delay: false, offset: Offset::None, stable: true }
    }

    #[test]
    fn numbers_and_coefficients_go_both_ways() {
        // (s + 2)(s + 5)(s + 30), with an integrator
        let form = structure(1, 4, true);
        let denominator = product(&product(&[1.0, 2.0], &[1.0, 5.0]), &[1.0, 30.0]);
        let numbers = [vec![3.0, 4.0], form.numbers_of(&product(&denominator, &[1.0, 0.0]))].concat();
        let function = form.function(&numbers);
        for (a, b) in function.denominator.iter().zip(product(&denominator, &[1.0, 0.0])) {
            assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{:?}", function.denominator);
        }
        assert_eq!(function.numerator, [3.0, 4.0]);
        assert_eq!(function.gain(), None);
        let (values, slopes) = form.coefficients(&numbers);
        for p in 0..numbers.len() {
            let mut moved = numbers.clone();
            moved[p] += 1e-6;
            for (row, after) in form.coefficients(&moved).0.iter().enumerate() {
                let slope = (after - values[row]) / 1e-6;
                assert!(
                    (slope - slopes[(row, p)]).abs() < 1e-4 * (1.0 + slope.abs()),
                    "{row} {p}: {slope} {}",
                    slopes[(row, p)]
                );
            }
        }
    }

    #[test]
    fn written_as_the_thesis_does() {
        let form = structure(0, 2, false);
        assert_eq!(form.function(&[123.2, 31.86, 81.85]).to_string(), "123.2 / (s^2 + 31.86 s + 81.85)");
        let yaw = structure(0, 1, true).function(&[-1.0]);
        assert_eq!(yaw.to_string(), "-1 / s");
        assert_eq!(
            structure(0, 1, false).function(&[9.87e-5, 0.6123]).to_string(),
            "9.8700e-5 / (s + 0.6123)"
        );
        let late = TransferFunction {
            numerator: vec![1.0, -2.0],
            denominator: vec![1.0, 3.5],
            delay_s: 0.02,
            offsets: vec![],
        };
        assert_eq!(late.to_string(), "exp(-0.02 s) (s - 2) / (s + 3.5)");
    }

    #[test]
    fn orders_that_make_no_sense_are_refused() {
        assert!(structure(2, 2, false).check().is_err() && structure(0, 5, false).check().is_err());
        assert!(structure(0, 0, false).check().is_err() && structure(3, 4, true).check().is_ok());
    }
}
