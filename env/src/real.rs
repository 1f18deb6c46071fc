//! Number types. Every formula of the simulator is written once, generic over [`Real`], and runs on [`Lanes`] (16 drones at
//! once, `f32`) in the simulator and on `f64` as the reference. Only IEEE basic operations are used, never a fused
//! multiply-add or a system maths library, so that one formula gives the same bits on every machine.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub, SubAssign};

/// Drones per tile: one AVX-512 or two AVX2 registers of `f32`.
pub const LANES: usize = 16;

/// A real number, or several side by side.
pub trait Real:
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
    type Mask: Copy + Debug + Send + Sync + BitAnd<Output = Self::Mask> + BitOr<Output = Self::Mask> + Not<Output = Self::Mask>;
    /// One 32-bit word per lane: what the noise generator computes with.
    type Word: Word;

    /// The same number in every lane.
    fn of(value: f64) -> Self;
    fn sqrt(self) -> Self;
    fn abs(self) -> Self;
    /// The smaller of two numbers; `self` where either is NaN.
    fn min(self, other: Self) -> Self;
    /// The larger of two numbers; `self` where either is NaN.
    fn max(self, other: Self) -> Self;
    /// The nearest integer; exact for |self| < 2^22.
    fn round(self) -> Self;
    fn lt(self, other: Self) -> Self::Mask;
    fn le(self, other: Self) -> Self::Mask;
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    fn any(mask: Self::Mask) -> bool;
    fn all(mask: Self::Mask) -> bool;
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

    #[inline(always)]
    fn zero() -> Self {
        Self::of(0.0)
    }
    #[inline(always)]
    fn gt(self, other: Self) -> Self::Mask {
        other.lt(self)
    }
    #[inline(always)]
    fn clamp(self, low: Self, high: Self) -> Self {
        self.max(low).min(high)
    }

    /// Sine and cosine. Cody-Waite reduction to [-pi/4, pi/4] and the Taylor polynomials there: absolute error below 3e-7 in
    /// `f32` and 1e-11 in `f64` for |self| < 1e4 rad.
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let quarter = (self * Self::of(std::f64::consts::FRAC_2_PI)).round();
        // pi/2 in three parts that are exact in f32: the products with a small integer lose nothing.
        let r = self
            - quarter * Self::of(1.570_312_5)
            - quarter * Self::of(4.837_512_969_970_703e-4)
            - quarter * Self::of(7.549_789_948_768_648e-8);
        let r2 = r * r;
        let sin = r + r * r2 * poly(r2, &[-1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362_880.0, -1.0 / 39_916_800.0]);
        let cos = Self::of(1.0) + r2 * poly(r2, &[-0.5, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40_320.0, -1.0 / 3_628_800.0, 1.0 / 479_001_600.0]);
        // quarter modulo 4 in {-2, -1, 0, 1, 2} decides which of the two and the signs
        let turn = quarter - Self::of(4.0) * (quarter * Self::of(0.25)).round();
        let odd = turn.abs().lt(Self::of(1.5)) & turn.abs().gt(Self::of(0.5));
        let flip_sin = turn.lt(Self::of(-0.5)) | turn.gt(Self::of(1.5));
        let flip_cos = turn.gt(Self::of(0.5)) | turn.lt(Self::of(-1.5));
        let (s, c) = (Self::select(odd, cos, sin), Self::select(odd, sin, cos));
        (Self::select(flip_sin, -s, s), Self::select(flip_cos, -c, c))
    }

    /// Tangent; the caller keeps away from odd multiples of pi/2.
    #[inline(always)]
    fn tan(self) -> Self {
        let (s, c) = self.sin_cos();
        s / c
    }

    /// Exponential for arguments within [-80, 80]; clamped outside. Relative error below 2e-7 in `f32`, 1e-13 in `f64`.
    #[inline(always)]
    fn exp(self) -> Self {
        let x = self.clamp(Self::of(-80.0), Self::of(80.0));
        let n = (x * Self::of(std::f64::consts::LOG2_E)).round();
        // ln 2 in two parts, the first exact in f32
        let r = x - n * Self::of(0.693_359_375) - n * Self::of(-2.121_944_400_546_905_8e-4);
        let e = Self::of(1.0)
            + r * poly(
                r,
                &[
                    1.0,
                    0.5,
                    1.0 / 6.0,
                    1.0 / 24.0,
                    1.0 / 120.0,
                    1.0 / 720.0,
                    1.0 / 5040.0,
                    1.0 / 40_320.0,
                    1.0 / 362_880.0,
                    1.0 / 3_628_800.0,
                ],
            );
        e.scale_exponent(n)
    }

    /// Natural logarithm of a positive normal number. Absolute error below 3e-7 in `f32`, 1e-10 in `f64`.
    #[inline(always)]
    fn ln(self) -> Self {
        let (m, n) = self.split_exponent();
        // ln m = 2 atanh(t), t = (m-1)/(m+1), |t| < 0.172
        let t = (m - Self::of(1.0)) / (m + Self::of(1.0));
        let t2 = t * t;
        n * Self::of(std::f64::consts::LN_2) + t * poly(t2, &[2.0, 2.0 / 3.0, 2.0 / 5.0, 2.0 / 7.0, 2.0 / 9.0, 2.0 / 11.0])
    }

    /// `self^exponent` for positive `self`.
    #[inline(always)]
    fn powf(self, exponent: Self) -> Self {
        (self.ln() * exponent).exp()
    }
}

/// Horner's scheme, lowest coefficient first.
#[inline(always)]
fn poly<R: Real, const N: usize>(x: R, coefficients: &[f64; N]) -> R {
    let mut sum = R::of(coefficients[N - 1]);
    for i in (0..N - 1).rev() {
        sum = sum * x + R::of(coefficients[i]);
    }
    sum
}

/// Integers modulo 2^32, one per lane.
pub trait Word: Copy + Debug + Send + Sync + BitXor<Output = Self> {
    fn of(value: u32) -> Self;
    fn add(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    fn shr(self, bits: u32) -> Self;
    fn set_lane(&mut self, lane: usize, value: u32);
}

/// Sixteen drones side by side, in single precision.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Lanes(pub [f32; LANES]);

/// A truth value per lane: all bits set, or none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, align(64))]
pub struct LaneMask(pub [u32; LANES]);

/// A word per lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, align(64))]
pub struct LaneWord(pub [u32; LANES]);

#[inline(always)]
fn zip<A: Copy, B: Copy, C: Copy + Default>(a: [A; LANES], b: [B; LANES], f: impl Fn(A, B) -> C) -> [C; LANES] {
    let mut out = [C::default(); LANES];
    for i in 0..LANES {
        out[i] = f(a[i], b[i]);
    }
    out
}

#[inline(always)]
fn map<A: Copy, C: Copy + Default>(a: [A; LANES], f: impl Fn(A) -> C) -> [C; LANES] {
    let mut out = [C::default(); LANES];
    for i in 0..LANES {
        out[i] = f(a[i]);
    }
    out
}

macro_rules! lane_operator {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for Lanes {
            type Output = Lanes;
            #[inline(always)]
            fn $method(self, other: Lanes) -> Lanes {
                Lanes(zip(self.0, other.0, |a, b| a $op b))
            }
        }
    };
}
lane_operator!(Add, add, +);
lane_operator!(Sub, sub, -);
lane_operator!(Mul, mul, *);
lane_operator!(Div, div, /);

impl Neg for Lanes {
    type Output = Lanes;
    #[inline(always)]
    fn neg(self) -> Lanes {
        Lanes(map(self.0, |a| -a))
    }
}
impl AddAssign for Lanes {
    #[inline(always)]
    fn add_assign(&mut self, other: Lanes) {
        *self = *self + other;
    }
}
impl SubAssign for Lanes {
    #[inline(always)]
    fn sub_assign(&mut self, other: Lanes) {
        *self = *self - other;
    }
}
impl BitAnd for LaneMask {
    type Output = LaneMask;
    #[inline(always)]
    fn bitand(self, other: LaneMask) -> LaneMask {
        LaneMask(zip(self.0, other.0, |a, b| a & b))
    }
}
impl BitOr for LaneMask {
    type Output = LaneMask;
    #[inline(always)]
    fn bitor(self, other: LaneMask) -> LaneMask {
        LaneMask(zip(self.0, other.0, |a, b| a | b))
    }
}
impl Not for LaneMask {
    type Output = LaneMask;
    #[inline(always)]
    fn not(self) -> LaneMask {
        LaneMask(map(self.0, |a| !a))
    }
}
impl LaneMask {
    /// From one truth value per lane.
    #[inline(always)]
    pub fn from_bools(flags: [bool; LANES]) -> LaneMask {
        LaneMask(map(flags, |f| if f { u32::MAX } else { 0 }))
    }
    /// Bit `i` set where lane `i` is true.
    #[inline(always)]
    pub fn bits(self) -> u32 {
        let mut bits = 0;
        for i in 0..LANES {
            bits |= (self.0[i] & 1) << i;
        }
        bits
    }
}
impl BitXor for LaneWord {
    type Output = LaneWord;
    #[inline(always)]
    fn bitxor(self, other: LaneWord) -> LaneWord {
        LaneWord(zip(self.0, other.0, |a, b| a ^ b))
    }
}
impl Word for LaneWord {
    #[inline(always)]
    fn of(value: u32) -> Self {
        LaneWord([value; LANES])
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        LaneWord(zip(self.0, other.0, |a, b| a.wrapping_add(b)))
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        LaneWord(zip(self.0, other.0, |a, b| a.wrapping_mul(b)))
    }
    #[inline(always)]
    fn shr(self, bits: u32) -> Self {
        LaneWord(map(self.0, |a| a >> bits))
    }
    #[inline(always)]
    fn set_lane(&mut self, lane: usize, value: u32) {
        self.0[lane] = value;
    }
}

/// Adding and subtracting 1.5 * 2^23 leaves the nearest integer of an `f32`: a rounding that every instruction set has.
const ROUND_F32: f32 = 12_582_912.0;

impl Real for Lanes {
    type Mask = LaneMask;
    type Word = LaneWord;

    #[inline(always)]
    fn of(value: f64) -> Self {
        Lanes([value as f32; LANES])
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Lanes(map(self.0, f32::sqrt))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Lanes(map(self.0, f32::abs))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Lanes(zip(self.0, other.0, |a, b| if b < a { b } else { a }))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Lanes(zip(self.0, other.0, |a, b| if b > a { b } else { a }))
    }
    #[inline(always)]
    fn round(self) -> Self {
        Lanes(map(self.0, |a| (a + ROUND_F32) - ROUND_F32))
    }
    #[inline(always)]
    fn lt(self, other: Self) -> LaneMask {
        LaneMask(zip(self.0, other.0, |a, b| if a < b { u32::MAX } else { 0 }))
    }
    #[inline(always)]
    fn le(self, other: Self) -> LaneMask {
        LaneMask(zip(self.0, other.0, |a, b| if a <= b { u32::MAX } else { 0 }))
    }
    #[inline(always)]
    fn select(mask: LaneMask, yes: Self, no: Self) -> Self {
        let mut out = [0.0; LANES];
        for i in 0..LANES {
            out[i] = f32::from_bits((mask.0[i] & yes.0[i].to_bits()) | (!mask.0[i] & no.0[i].to_bits()));
        }
        Lanes(out)
    }
    #[inline(always)]
    fn any(mask: LaneMask) -> bool {
        mask.0.iter().fold(0, |a, b| a | b) != 0
    }
    #[inline(always)]
    fn all(mask: LaneMask) -> bool {
        mask.0.iter().fold(u32::MAX, |a, b| a & b) != 0
    }
    #[inline(always)]
    fn nothing() -> LaneMask {
        LaneMask([0; LANES])
    }
    #[inline(always)]
    fn unit(word: LaneWord) -> Self {
        // 23 bits and a half are exact in f32: never 0, never 1
        Lanes(map(word.0, |w| ((w >> 9) as i32 as f32 + 0.5) * (1.0 / 8_388_608.0)))
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        // offset so that the mantissa comes out in [sqrt(1/2), sqrt(2))
        const SQRT_HALF_BITS: u32 = 0x3f35_04f3;
        let shifted = map(self.0, |a| a.to_bits().wrapping_sub(SQRT_HALF_BITS));
        let exponent = map(shifted, |b| ((b as i32) >> 23) as f32);
        let mantissa = map(shifted, |b| f32::from_bits((b & 0x007f_ffff).wrapping_add(SQRT_HALF_BITS)));
        (Lanes(mantissa), Lanes(exponent))
    }
    #[inline(always)]
    fn scale_exponent(self, exponent: Self) -> Self {
        // 2^n from the low bits of n + 1.5 * 2^23, which hold the integer n
        Lanes(zip(self.0, exponent.0, |a, n| a * f32::from_bits((n + ROUND_F32).to_bits().wrapping_add(127) << 23)))
    }
    #[inline(always)]
    fn lane(self, lane: usize) -> f64 {
        f64::from(self.0[lane])
    }
    #[inline(always)]
    fn set_lane(&mut self, lane: usize, value: f64) {
        self.0[lane] = value as f32;
    }
}

impl Word for u32 {
    fn of(value: u32) -> Self {
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

impl Real for f64 {
    type Mask = bool;
    type Word = u32;

    fn of(value: f64) -> Self {
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
        // as for Lanes: ties to even, on every platform
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
        if mantissa < std::f64::consts::FRAC_1_SQRT_2 { (mantissa * 2.0, f64::from(exponent - 1)) } else { (mantissa, f64::from(exponent)) }
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

    fn worst(low: f64, high: f64, ours: impl Fn(Lanes) -> Lanes, ours64: impl Fn(f64) -> f64, truth: impl Fn(f64) -> f64) -> (f64, f64) {
        let (mut e32, mut e64) = (0.0_f64, 0.0_f64);
        for i in 0..=20_000 {
            let x = low + (high - low) * f64::from(i) / 20_000.0;
            let x32 = x as f32;
            e32 = e32.max((ours(Lanes([x32; LANES])).lane(3) - truth(f64::from(x32))).abs());
            e64 = e64.max((ours64(x) - truth(x)).abs());
        }
        (e32, e64)
    }

    #[test]
    fn elementary_functions_are_accurate() {
        let (s32, s64) = worst(-100.0, 100.0, |x| x.sin_cos().0, |x| Real::sin_cos(x).0, libm::sin);
        let (c32, c64) = worst(-100.0, 100.0, |x| x.sin_cos().1, |x| Real::sin_cos(x).1, libm::cos);
        let (l32, l64) = worst(1e-7, 8.0, Real::ln, |x| Real::ln(x), libm::log);
        let (e32, e64) = worst(-4.0, 1.0, Real::exp, |x| Real::exp(x), libm::exp);
        println!("sin {s32:e} {s64:e} cos {c32:e} {c64:e} ln {l32:e} {l64:e} exp {e32:e} {e64:e}");
        assert!(s32 < 3e-7 && c32 < 3e-7 && l32 < 2e-6 && e32 < 6e-7);
        assert!(s64 < 1e-10 && c64 < 1e-10 && l64 < 1e-8 && e64 < 1e-12);
    }

    #[test]
    fn unit_never_reaches_its_ends() {
        for w in [0, 1, u32::MAX, 0x8000_0000] {
            let u = Lanes::unit(LaneWord([w; LANES])).lane(0);
            assert!(u > 0.0 && u < 1.0, "{w:x} gave {u}");
        }
    }

    #[test]
    fn min_max_select_and_masks_agree_with_scalars() {
        let a = Lanes(std::array::from_fn(|i| i as f32 - 7.5));
        let b = Lanes([0.25; LANES]);
        for i in 0..LANES {
            assert_eq!(a.min(b).0[i], a.0[i].min(0.25));
            assert_eq!(a.max(b).0[i], a.0[i].max(0.25));
            assert_eq!(Lanes::select(a.lt(b), a, b).0[i], a.0[i].min(0.25));
            assert_eq!(a.lt(b).bits() >> i & 1 == 1, a.0[i] < 0.25);
        }
        assert!(Lanes::any(a.lt(b)) && !Lanes::all(a.lt(b)) && Lanes::all(a.lt(Lanes::of(100.0))));
    }
}
