//! Operations available to a formula. Every formula of the simulator is written once, generic over [`Scalar`], and
//! runs on [`crate::lanes::Lanes`] (16 drones at once, `f32`) in the simulator and on `f64` as the reference. Only
//! IEEE basic operations are used, never a fused multiply-add or a system maths library, so that one formula gives
//! the same bits on every machine.

use std::f64::consts::TAU;
use std::fmt::Debug;
use std::ops::{Add, AddAssign, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub, SubAssign};

use crate::elementary;

/// A real number, or several side by side.
pub trait Scalar:
    Copy
    + Debug
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
{
    /// One truth value per lane.
    type Mask: Copy
        + Debug
        + Send
        + Sync
        + BitAnd<Output = Self::Mask>
        + BitOr<Output = Self::Mask>
        + Not<Output = Self::Mask>;
    /// One 32-bit word per lane: what the noise generator computes with.
    type Word: Word;

    /// Single precision: polynomials may stop at 1e-7.
    const SINGLE: bool;
    /// Noise is replaced by its mean: for predicting, not simulating.
    const MEAN: bool = false;

    /// The same number in every lane.
    fn from_f64(value: f64) -> Self;
    /// Takes the square root, rounded by IEEE 754.
    fn sqrt(self) -> Self;
    /// Takes the magnitude, lane by lane.
    fn abs(self) -> Self;
    /// The smaller of two numbers; `self` where either is NaN.
    fn min(self, other: Self) -> Self;
    /// The larger of two numbers; `self` where either is NaN.
    fn max(self, other: Self) -> Self;
    /// The nearest integer; exact for |self| < 2^22.
    fn round(self) -> Self;
    /// Compares lane by lane: `self < other`, false where either is NaN.
    fn lt(self, other: Self) -> Self::Mask;
    /// Compares lane by lane: `self <= other`, false where either is NaN.
    fn le(self, other: Self) -> Self::Mask;
    /// Picks `yes` in the lanes of `mask` and `no` in the others.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// Returns whether some lane is true.
    fn any(mask: Self::Mask) -> bool;
    /// Returns whether every lane is true.
    fn all(mask: Self::Mask) -> bool;
    /// Returns a mask that is false in every lane.
    fn nothing() -> Self::Mask;
    /// A word as a number strictly between 0 and 1.
    fn unit(word: Self::Word) -> Self;
    /// Split a positive normal number into mantissa in [sqrt(1/2), sqrt(2)) and exponent of two.
    fn split_exponent(self) -> (Self, Self);
    /// `self * 2^exponent` for an integral `exponent` within the normal range.
    fn scale_exponent(self, exponent: Self) -> Self;
    /// The number in one lane.
    fn lane(self, lane: usize) -> f64;
    /// Replace the number in one lane.
    fn set_lane(&mut self, lane: usize, value: f64);

    /// Returns 0 in every lane.
    #[inline(always)]
    fn zero() -> Self {
        Self::from_f64(0.0)
    }
    /// Compares lane by lane: `self > other`, false where either is NaN.
    #[inline(always)]
    fn gt(self, other: Self) -> Self::Mask {
        other.lt(self)
    }
    /// Returns whether every lane is 0, with all that the type carries: a product with it may be left out.
    #[inline(always)]
    fn is_zero(self) -> bool {
        Self::all(self.abs().le(Self::zero()))
    }
    /// Limits each lane to `low..=high`.
    #[inline(always)]
    fn clamp(self, low: Self, high: Self) -> Self {
        self.max(low).min(high)
    }

    /// Sine and cosine. Cody-Waite reduction to [-pi/4, pi/4] and the Taylor polynomials there: absolute
    /// error below 3e-7 in `f32` and 1e-11 in `f64` for |self| < 1e4 rad.
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        elementary::sin_cos(self)
    }

    /// Sine and cosine of an angle `quarter` (a whole number) quarter turns beyond the one whose sine and
    /// cosine are given.
    #[inline(always)]
    fn turned(quarter: Self, sin: Self, cos: Self) -> (Self, Self) {
        // quarter modulo 4 in {-2, -1, 0, 1, 2} decides which of the two and the signs
        let turn = quarter - Self::from_f64(4.0) * (quarter * Self::from_f64(0.25)).round();
        let odd = turn.abs().lt(Self::from_f64(1.5)) & turn.abs().gt(Self::from_f64(0.5));
        let flip_sin = turn.lt(Self::from_f64(-0.5)) | turn.gt(Self::from_f64(1.5));
        let flip_cos = turn.gt(Self::from_f64(0.5)) | turn.lt(Self::from_f64(-1.5));
        let (s, c) = (Self::select(odd, cos, sin), Self::select(odd, sin, cos));
        (Self::select(flip_sin, -s, s), Self::select(flip_cos, -c, c))
    }

    /// Sine and cosine of an angle within [-pi/2, pi/2]: Taylor polynomials, absolute error below 1e-7 in
    /// `f32` and 1e-9 in `f64`.
    #[inline(always)]
    fn sin_cos_quarter(self) -> (Self, Self) {
        elementary::sin_cos_quarter(self)
    }

    /// Tangent; the caller keeps away from odd multiples of pi/2.
    #[inline(always)]
    fn tan(self) -> Self {
        let (s, c) = self.sin_cos();
        s / c
    }

    /// Exponential for arguments within [-80, 80]; clamped outside. Relative error below 2e-7 in `f32`, 1e-13
    /// in `f64`.
    #[inline(always)]
    fn exp(self) -> Self {
        elementary::exp(self)
    }

    /// Natural logarithm of a positive normal number. Absolute error below 3e-7 in `f32`, 1e-10 in `f64`.
    #[inline(always)]
    fn ln(self) -> Self {
        elementary::ln(self)
    }

    /// `self^exponent` for positive `self`.
    #[inline(always)]
    fn powf(self, exponent: Self) -> Self {
        (self.ln() * exponent).exp()
    }
}

/// Adds to a number, and subtracts from it, by the operators that it has.
macro_rules! assigns {
    ($type:ty) => {
        impl std::ops::AddAssign for $type {
            #[inline(always)]
            fn add_assign(&mut self, other: $type) {
                *self = *self + other;
            }
        }
        impl std::ops::SubAssign for $type {
            #[inline(always)]
            fn sub_assign(&mut self, other: $type) {
                *self = *self - other;
            }
        }
    };
}
pub(crate) use assigns;

/// An angle within [-pi, pi].
#[inline(always)]
pub fn wrap<R: Scalar>(angle: R) -> R {
    angle - R::from_f64(TAU) * (angle * R::from_f64(1.0 / TAU)).round()
}

/// `values` through `f`. Unlike `[T; N]::map` it is inlined always, which a caller compiled for wider
/// registers needs.
#[inline(always)]
pub fn each<R: Scalar, const N: usize>(values: [R; N], f: impl Fn(R) -> R) -> [R; N] {
    let mut out = values;
    for i in 0..N {
        out[i] = f(values[i]);
    }
    out
}

/// `new` in the lanes of `mask`, and `old` in the others.
#[inline(always)]
pub fn merge<R: Scalar, const N: usize>(mask: R::Mask, old: [R; N], new: [R; N]) -> [R; N] {
    tabulate(
        #[inline(always)]
        |i| R::select(mask, new[i], old[i]),
    )
}

/// Sum of products.
#[inline(always)]
pub fn dot<R: Scalar, const N: usize>(a: &[R; N], b: [R; N]) -> R {
    let mut sum = a[0] * b[0];
    for i in 1..N {
        sum += a[i] * b[i];
    }
    sum
}

/// `[f(0), f(1), ...]`, inlined always.
#[inline(always)]
pub fn tabulate<R: Scalar, const N: usize>(f: impl Fn(usize) -> R) -> [R; N] {
    let mut out = [R::zero(); N];
    for i in 0..N {
        out[i] = f(i);
    }
    out
}

/// Integers modulo 2^32, one per lane.
pub trait Word: Copy + Debug + Send + Sync + BitXor<Output = Self> {
    /// Puts the same word into every lane.
    fn from_u32(value: u32) -> Self;
    /// Adds modulo 2^32.
    fn add(self, other: Self) -> Self;
    /// Multiplies modulo 2^32.
    fn mul(self, other: Self) -> Self;
    /// Shifts right by `bits`, below 32, and fills with zeros.
    fn shr(self, bits: u32) -> Self;
    /// Replaces the word in one lane.
    fn set_lane(&mut self, lane: usize, value: u32);
}

impl Word for u32 {
    fn from_u32(value: u32) -> Self {
        value
    }
    fn add(self, other: Self) -> Self {
        self.wrapping_add(other)
    }
    fn mul(self, other: Self) -> Self {
        self.wrapping_mul(other)
    }
    fn shr(self, bits: u32) -> Self {
        self >> bits
    }
    fn set_lane(&mut self, _: usize, value: u32) {
        *self = value;
    }
}

impl Scalar for f64 {
    type Mask = bool;
    type Word = u32;
    const SINGLE: bool = false;

    fn from_f64(value: f64) -> Self {
        value
    }
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    fn abs(self) -> Self {
        f64::abs(self)
    }
    fn min(self, other: Self) -> Self {
        if other < self { other } else { self }
    }
    fn max(self, other: Self) -> Self {
        if other > self { other } else { self }
    }
    fn round(self) -> Self {
        // the same rounding as for Lanes: ties to even, on every platform
        const ROUND_F64: f64 = 6_755_399_441_055_744.0;
        (self + ROUND_F64) - ROUND_F64
    }
    fn lt(self, other: Self) -> bool {
        self < other
    }
    fn le(self, other: Self) -> bool {
        self <= other
    }
    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
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
        (f64::from(word >> 9) + 0.5) / 8_388_608.0
    }
    fn split_exponent(self) -> (Self, Self) {
        let (mantissa, exponent) = libm::frexp(self);
        if mantissa < std::f64::consts::FRAC_1_SQRT_2 {
            (mantissa * 2.0, f64::from(exponent - 1))
        } else {
            (mantissa, f64::from(exponent))
        }
    }
    fn scale_exponent(self, exponent: Self) -> Self {
        libm::ldexp(self, exponent as i32)
    }
    fn lane(self, _: usize) -> f64 {
        self
    }
    fn set_lane(&mut self, _: usize, value: f64) {
        *self = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{LANES, LaneWord, Lanes};

    fn worst(
        low: f64,
        high: f64,
        ours: impl Fn(Lanes) -> Lanes,
        ours64: impl Fn(f64) -> f64,
        truth: impl Fn(f64) -> f64,
    ) -> (f64, f64) {
        let (mut e32, mut e64) = (0.0_f64, 0.0_f64);
        for i in 0..=20_000 {
            let x = low + (high - low) * f64::from(i) / 20_000.0;
            let x32 = x as f32;
            e32 = e32.max((ours(Lanes::from([x32; LANES])).lane(3) - truth(f64::from(x32))).abs());
            e64 = e64.max((ours64(x) - truth(x)).abs());
        }
        (e32, e64)
    }

    #[test]
    fn elementary_functions_are_accurate() {
        let (s32, s64) = worst(-100.0, 100.0, |x| x.sin_cos().0, |x| Scalar::sin_cos(x).0, libm::sin);
        let (c32, c64) = worst(-100.0, 100.0, |x| x.sin_cos().1, |x| Scalar::sin_cos(x).1, libm::cos);
        let (l32, l64) = worst(1e-7, 8.0, Scalar::ln, Scalar::ln, libm::log);
        let (e32, e64) = worst(-4.0, 1.0, Scalar::exp, Scalar::exp, libm::exp);
        assert!(s32 < 3e-7 && c32 < 3e-7 && l32 < 2e-6 && e32 < 6e-7, "{s32:e} {c32:e} {l32:e} {e32:e}");
        assert!(s64 < 1e-10 && c64 < 1e-10 && l64 < 1e-8 && e64 < 1e-12, "{s64:e} {c64:e} {l64:e} {e64:e}");
    }

    #[test]
    fn unit_never_reaches_its_ends() {
        for w in [0, 1, u32::MAX, 0x8000_0000] {
            let u = Lanes::unit(LaneWord::from([w; LANES])).lane(0);
            assert!(u > 0.0 && u < 1.0, "{w:x} gave {u}");
        }
    }

    #[test]
    fn min_max_select_and_masks_agree_with_scalars() {
        let x: [f32; LANES] = std::array::from_fn(|i| i as f32 - 7.5);
        let a = Lanes::from(x);
        let b = Lanes::from([0.25; LANES]);
        for i in 0..LANES {
            assert_eq!(a.min(b).array()[i], x[i].min(0.25));
            assert_eq!(a.max(b).array()[i], x[i].max(0.25));
            assert_eq!(Lanes::select(a.lt(b), a, b).array()[i], x[i].min(0.25));
            assert_eq!(a.lt(b).bits() >> i & 1 == 1, x[i] < 0.25);
        }
        assert!(Lanes::any(a.lt(b)) && !Lanes::all(a.lt(b)) && Lanes::all(a.lt(Lanes::from_f64(100.0))));
    }
}
