//! Sixteen drones at once in four registers of four, which every target has (SSE2, NEON, or arrays where
//! there are none). `lanes_avx2` and `lanes_avx512` are the same in wider registers.

use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub};

use wide::{bytemuck, f32x4, i32x4, u32x4};

use crate::scalar::{Scalar, Word, assigns};

/// Drones per tile: one AVX-512 or two AVX2 registers of `f32`.
pub const LANES: usize = 16;

/// Sixteen drones side by side, in single precision.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Lanes([f32x4; 4]);

/// A truth value per lane: all bits set, or none.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct LaneMask([f32x4; 4]);

/// A word per lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, align(64))]
pub struct LaneWord([u32x4; 4]);

/// Register by register, written out: of loops over lanes a compiler makes the same, in five times the time.
macro_rules! quads {
    ($a:expr, $f:expr) => {{
        let (a, f) = ($a.0, $f);
        [f(a[0]), f(a[1]), f(a[2]), f(a[3])]
    }};
    ($a:expr, $b:expr, $f:expr) => {{
        let (a, b, f) = ($a.0, $b.0, $f);
        [f(a[0], b[0]), f(a[1], b[1]), f(a[2], b[2]), f(a[3], b[3])]
    }};
}

/// Common parts of lanes in registers: the numbers in their order, and the methods that follow from the operators.
/// The caller of the macro promises that the types are plain registers of 16 * 32 bits.
#[cfg(all(target_arch = "x86_64", not(test)))]
macro_rules! in_registers {
    ($lanes:ident, $words:ident, $mask:ident) => {
        impl $lanes {
            /// The lanes in order.
            #[inline(always)]
            pub fn array(&self) -> &[f32; LANES] {
                // SAFETY: the same size, at least the alignment, and every bit pattern is a value of both
                // types
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
        crate::scalar::assigns!($lanes);
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
#[cfg(all(target_arch = "x86_64", not(test)))]
pub(crate) use in_registers;

macro_rules! lane_operator {
    ($trait:ident, $method:ident, $type:ident) => {
        impl $trait for $type {
            type Output = $type;
            #[inline(always)]
            fn $method(self, other: $type) -> $type {
                $type(quads!(self, other, $trait::$method))
            }
        }
    };
}
lane_operator!(Add, add, Lanes);
lane_operator!(Sub, sub, Lanes);
lane_operator!(Mul, mul, Lanes);
lane_operator!(Div, div, Lanes);
lane_operator!(BitAnd, bitand, LaneMask);
lane_operator!(BitOr, bitor, LaneMask);
lane_operator!(BitXor, bitxor, LaneWord);
assigns!(Lanes);

impl Neg for Lanes {
    type Output = Lanes;
    #[inline(always)]
    fn neg(self) -> Lanes {
        Lanes(quads!(self, Neg::neg))
    }
}
impl Not for LaneMask {
    type Output = LaneMask;
    #[inline(always)]
    fn not(self) -> LaneMask {
        LaneMask(quads!(self, Not::not))
    }
}

impl From<[f32; LANES]> for Lanes {
    fn from(lanes: [f32; LANES]) -> Lanes {
        Lanes(bytemuck::cast(lanes))
    }
}
impl Lanes {
    /// The lanes in order.
    #[inline(always)]
    pub fn array(&self) -> &[f32; LANES] {
        bytemuck::cast_ref(&self.0)
    }
    /// Returns the lanes in order, to be written.
    #[inline(always)]
    pub fn array_mut(&mut self) -> &mut [f32; LANES] {
        bytemuck::cast_mut(&mut self.0)
    }
}
impl From<[u32; LANES]> for LaneWord {
    fn from(words: [u32; LANES]) -> LaneWord {
        LaneWord(bytemuck::cast(words))
    }
}
impl From<[bool; LANES]> for LaneMask {
    /// From one truth value per lane.
    fn from(flags: [bool; LANES]) -> LaneMask {
        LaneMask(bytemuck::cast(flags.map(|on| if on { u32::MAX } else { 0 })))
    }
}
impl LaneMask {
    /// Bit `i` set where lane `i` is true.
    #[inline(always)]
    pub fn bits(self) -> u32 {
        let [a, b, c, d] = quads!(self, f32x4::to_bitmask);
        a | b << 4 | c << 8 | d << 12
    }
}

impl Word for LaneWord {
    #[inline(always)]
    fn from_u32(value: u32) -> Self {
        LaneWord([u32x4::splat(value); 4])
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        LaneWord(quads!(self, other, Add::add))
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        LaneWord(quads!(self, other, Mul::mul))
    }
    #[inline(always)]
    fn shr(self, bits: u32) -> Self {
        LaneWord(quads!(self, |a: u32x4| a >> bits))
    }
    #[inline(always)]
    fn set_lane(&mut self, lane: usize, value: u32) {
        bytemuck::cast_mut::<_, [u32; LANES]>(&mut self.0)[lane] = value;
    }
}

impl LaneWord {
    /// Signed integers as numbers.
    #[inline(always)]
    fn numbers(self) -> Lanes {
        Lanes(quads!(self, |words| f32x4::from_i32x4(bytemuck::cast::<u32x4, i32x4>(words))))
    }
}

/// Adding and subtracting 1.5 * 2^23 leaves the nearest integer of an `f32`: a rounding that every
/// instruction set has.
pub(crate) const ROUND: f64 = 12_582_912.0;

/// Operations of lanes that follow from the others, whatever the registers.
macro_rules! common_operations {
    () => {
        #[inline(always)]
        fn round(self) -> Self {
            (self + Self::from_f64(ROUND)) - Self::from_f64(ROUND)
        }
        #[inline(always)]
        fn any(mask: Self::Mask) -> bool {
            mask.bits() != 0
        }
        #[inline(always)]
        fn all(mask: Self::Mask) -> bool {
            mask.bits() == u32::from(u16::MAX)
        }
        #[inline(always)]
        fn unit(word: Self::Word) -> Self {
            // 23 bits and a half are exact in f32: never 0, never 1
            (word.shr(9).numbers() + Self::from_f64(0.5)) * Self::from_f64(1.0 / 8_388_608.0)
        }
        #[inline(always)]
        fn lane(self, lane: usize) -> f64 {
            f64::from(self.array()[lane])
        }
        #[inline(always)]
        fn set_lane(&mut self, lane: usize, value: f64) {
            self.array_mut()[lane] = value as f32;
        }
    };
}
#[cfg(all(target_arch = "x86_64", not(test)))]
pub(crate) use common_operations;

impl Scalar for Lanes {
    type Mask = LaneMask;
    type Word = LaneWord;
    const SINGLE: bool = true;
    common_operations!();

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        Lanes([f32x4::splat(value as f32); 4])
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Lanes(quads!(self, f32x4::sqrt))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Lanes(quads!(self, f32x4::abs))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Lanes(quads!(self, other, |a: f32x4, b: f32x4| b.simd_lt(a).bitselect(b, a)))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Lanes(quads!(self, other, |a: f32x4, b: f32x4| a.simd_lt(b).bitselect(b, a)))
    }
    #[inline(always)]
    fn lt(self, other: Self) -> LaneMask {
        LaneMask(quads!(self, other, f32x4::simd_lt))
    }
    #[inline(always)]
    fn le(self, other: Self) -> LaneMask {
        LaneMask(quads!(self, other, f32x4::simd_le))
    }
    #[inline(always)]
    fn select(mask: LaneMask, yes: Self, no: Self) -> Self {
        let (m, y, n) = (mask.0, yes.0, no.0);
        Lanes([
            m[0].bitselect(y[0], n[0]),
            m[1].bitselect(y[1], n[1]),
            m[2].bitselect(y[2], n[2]),
            m[3].bitselect(y[3], n[3]),
        ])
    }
    #[inline(always)]
    fn nothing() -> LaneMask {
        LaneMask([f32x4::splat(0.0); 4])
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        // offset so that the mantissa comes out in [sqrt(1/2), sqrt(2))
        const SQRT_HALF_BITS: u32 = 0x3f35_04f3;
        let offset = u32x4::splat(SQRT_HALF_BITS);
        let shifted = LaneWord(quads!(self, |a: f32x4| bytemuck::cast::<_, u32x4>(a) - offset));
        let exponent = quads!(shifted, |b| f32x4::from_i32x4(bytemuck::cast::<u32x4, i32x4>(b) >> 23_u32));
        let mantissa = quads!(shifted, |b| bytemuck::cast((b & u32x4::splat(0x007f_ffff)) + offset));
        (Lanes(mantissa), Lanes(exponent))
    }
    #[inline(always)]
    fn scale_exponent(self, exponent: Self) -> Self {
        // 2^n from the low bits of n + 1.5 * 2^23, which hold the integer n
        let integer = exponent + Lanes::from_f64(ROUND);
        let power = quads!(integer, |n: f32x4| bytemuck::cast(
            (bytemuck::cast::<_, u32x4>(n) + u32x4::splat(127)) << 23_u32
        ));
        self * Lanes(power)
    }
}
