//! Sixteen drones at once in plain arrays: what every target can compile. [`crate::lanes_avx2`] and [`crate::lanes_avx512`] are the same
//! in registers.

use std::ops::{Add, AddAssign, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub, SubAssign};

use crate::real::{Real, Word};

/// Drones per tile: one AVX-512 or two AVX2 registers of `f32`.
pub const LANES: usize = 16;

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

/// What lanes in registers have in common: the numbers in their order, and what follows from the operators. The one that invokes it
/// promises that the types are plain registers of 16 * 32 bits.
#[cfg(target_arch = "x86_64")]
macro_rules! in_registers {
    ($lanes:ident, $words:ident, $mask:ident) => {
        impl $lanes {
            /// The lanes in order.
            #[inline(always)]
            pub fn array(&self) -> &[f32; LANES] {
                // SAFETY: the same size, at least the alignment, and every bit pattern is a value of both types
                unsafe { &*std::ptr::from_ref(self).cast() }
            }
            #[inline(always)]
            fn array_mut(&mut self) -> &mut [f32; LANES] {
                // SAFETY: as for `array`
                unsafe { &mut *std::ptr::from_mut(self).cast() }
            }
        }
        impl $words {
            #[inline(always)]
            fn array_mut(&mut self) -> &mut [u32; LANES] {
                // SAFETY: as for `array`
                unsafe { &mut *std::ptr::from_mut(self).cast() }
            }
        }
        const _: () = assert!(size_of::<$lanes>() == 4 * LANES && size_of::<$words>() == 4 * LANES);
        impl AddAssign for $lanes {
            #[inline(always)]
            fn add_assign(&mut self, other: $lanes) {
                *self = *self + other;
            }
        }
        impl SubAssign for $lanes {
            #[inline(always)]
            fn sub_assign(&mut self, other: $lanes) {
                *self = *self - other;
            }
        }
        impl fmt::Debug for $lanes {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.array().fmt(f)
            }
        }
        impl fmt::Debug for $mask {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{:016b}", self.bits())
            }
        }
        impl fmt::Debug for $words {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.lanes().array().map(f32::to_bits).fmt(f)
            }
        }
    };
}
#[cfg(target_arch = "x86_64")]
pub(crate) use in_registers;

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
    const SINGLE: bool = true;

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
