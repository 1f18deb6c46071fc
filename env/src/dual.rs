//! A number with its derivatives in some directions (forward-mode automatic differentiation):
//! fitting runs the simulator's own formulas on it. Draws of noise are their means, so that a world of duals
//! predicts what is expected.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use crate::scalar::Scalar;

/// Derivatives carried along: twelve states, six disturbances and six parameters fit in one pass of a filter.
pub const DIRECTIONS: usize = 24;

/// A value and its derivatives, of single precision: they give the direction of a step and the uncertainty of an
/// estimate, and half of the time of a fit goes to moving them about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DualNumber<const D: usize> {
    /// Value in double precision, the same as a plain `f64` would have.
    pub value: f64,
    /// Partial derivatives of the value, one for each direction.
    pub slope: [f32; D],
}

/// A number of a fit.
pub type Dual = DualNumber<DIRECTIONS>;
/// A number without derivatives, for what is only predicted.
pub type Mean = DualNumber<0>;

impl<const D: usize> DualNumber<D> {
    /// The variable of one direction.
    pub fn variable(value: f64, direction: usize) -> Self {
        let mut slope = [0.0_f32; D];
        slope[direction] = 1.0;
        DualNumber { value, slope }
    }

    /// f(self), given the value of f and its derivative.
    #[inline(always)]
    fn chain(self, value: f64, derivative: f64) -> Self {
        let (mut slope, derivative) = (self.slope, derivative as f32);
        for s in &mut slope {
            *s *= derivative;
        }
        DualNumber { value, slope }
    }

    /// `p` of the slope of `a` and `q` of that of `b`.
    #[inline(always)]
    fn mix(value: f64, a: &Self, p: f64, b: &Self, q: f64) -> Self {
        let (p, q) = (p as f32, q as f32);
        let mut slope = [0.0_f32; D];
        for i in 0..D {
            slope[i] = p * a.slope[i] + q * b.slope[i];
        }
        DualNumber { value, slope }
    }
}

impl<const D: usize> Add for DualNumber<D> {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl<const D: usize> Sub for DualNumber<D> {
    type Output = Self;
    #[inline(always)]
    fn sub(mut self, other: Self) -> Self {
        self -= other;
        self
    }
}

impl<const D: usize> Mul for DualNumber<D> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self::mix(self.value * other.value, &self, other.value, &other, self.value)
    }
}

impl<const D: usize> Div for DualNumber<D> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let (value, per) = (self.value / other.value, 1.0 / other.value);
        Self::mix(value, &self, per, &other, -value * per)
    }
}

impl<const D: usize> Neg for DualNumber<D> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.chain(-self.value, -1.0)
    }
}

impl<const D: usize> AddAssign for DualNumber<D> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        self.value += other.value;
        for i in 0..D {
            self.slope[i] += other.slope[i];
        }
    }
}

impl<const D: usize> SubAssign for DualNumber<D> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        self.value -= other.value;
        for i in 0..D {
            self.slope[i] -= other.slope[i];
        }
    }
}

impl<const D: usize> Scalar for DualNumber<D> {
    type Mask = bool;
    type Word = u32;
    const SINGLE: bool = false;
    const MEAN: bool = true;

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        DualNumber { value, slope: [0.0; D] }
    }
    /// At zero the derivative is taken as zero, not infinite.
    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, if root > 0.0 { 0.5 / root } else { 0.0 })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        if self.value < 0.0 { -self } else { self }
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if other.value < self.value { other } else { self }
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if other.value > self.value { other } else { self }
    }
    fn round(self) -> Self {
        Self::from_f64(Scalar::round(self.value))
    }
    #[inline(always)]
    fn lt(self, other: Self) -> bool {
        self.value < other.value
    }
    #[inline(always)]
    fn le(self, other: Self) -> bool {
        self.value <= other.value
    }
    #[inline(always)]
    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }
    #[inline(always)]
    fn is_zero(self) -> bool {
        self.value == 0.0 && self.slope == [0.0; D]
    }
    fn any(mask: bool) -> bool {
        mask
    }
    fn all(mask: bool) -> bool {
        mask
    }
    fn nothing() -> bool {
        false
    }
    fn unit(word: u32) -> Self {
        Self::from_f64(f64::unit(word))
    }
    fn split_exponent(self) -> (Self, Self) {
        let (mantissa, exponent) = Scalar::split_exponent(self.value);
        let derivative = mantissa / self.value;
        (self.chain(mantissa, derivative), Self::from_f64(exponent))
    }
    fn scale_exponent(self, exponent: Self) -> Self {
        let factor = Scalar::scale_exponent(1.0, exponent.value);
        self.chain(self.value * factor, factor)
    }
    fn lane(self, _: usize) -> f64 {
        self.value
    }
    fn set_lane(&mut self, _: usize, value: f64) {
        *self = Self::from_f64(value);
    }
    // The same values as from the general formulas; the derivatives in closed form.
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = Scalar::sin_cos(self.value);
        (self.chain(sin, cos), self.chain(cos, -sin))
    }
    fn sin_cos_quarter(self) -> (Self, Self) {
        let (sin, cos) = Scalar::sin_cos_quarter(self.value);
        (self.chain(sin, cos), self.chain(cos, -sin))
    }
    fn exp(self) -> Self {
        let value = Scalar::exp(self.value);
        self.chain(value, value)
    }
    fn ln(self) -> Self {
        self.chain(Scalar::ln(self.value), 1.0 / self.value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Applies every operation of a number in one formula.
    fn formula<R: Scalar>(x: R, y: R) -> R {
        let (s, c) = (x * y).sin_cos();
        let bent = R::select(x.lt(y), x.max(y).sqrt(), x.min(y)) + (x - y).abs();
        (s / (R::from_f64(2.0) + c)).exp() * bent.powf(y) - x.tan()
            + (-y).clamp(R::from_f64(-0.9), R::from_f64(0.9))
    }

    #[test]
    fn slopes_are_the_derivatives_and_values_those_of_f64() {
        for (x, y) in [(0.3, 0.7), (0.9, 0.2), (-0.4, 1.3)] {
            let dual = formula(Dual::variable(x, 3), Dual::variable(y, 9));
            assert_eq!(dual.value, formula(x, y));
            let h = 1e-6;
            let by_difference = [
                (formula(x + h, y) - formula(x - h, y)) / (2.0 * h),
                (formula(x, y + h) - formula(x, y - h)) / (2.0 * h),
            ];
            for (slope, difference) in
                [dual.slope[3], dual.slope[9]].map(f64::from).into_iter().zip(by_difference)
            {
                assert!(
                    (slope - difference).abs() < 1e-6 * (1.0 + difference.abs()),
                    "{x} {y}: {slope} against {difference}"
                );
            }
            assert_eq!(dual.slope[0], 0.0);
        }
    }

    #[test]
    fn a_root_of_zero_has_no_infinite_slope() {
        assert_eq!(Dual::variable(0.0, 0).sqrt(), Dual::from_f64(0.0));
    }
}
