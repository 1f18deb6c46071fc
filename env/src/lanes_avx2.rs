//! Sixteen drones at once in two AVX2 registers; operation for operation the same results as
//! [`crate::lanes::Lanes`].
//!
//! SAFETY, for all of this file: the intrinsics need a processor with AVX2. Values of these types are made only
//! inside tiles, stages and judges that [`crate::vector`] builds for a [`crate::isa::Level`] of AVX2, and such a
//! level exists only after `is_x86_feature_detected!("avx2")` was true (see `isa.rs`). The types are private to the
//! crate, so nobody else can make one.
#![allow(unsafe_code)]

use std::arch::x86_64::*;
use std::fmt;
use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub};

use crate::lanes::{LANES, ROUND, common_operations, in_registers};
use crate::scalar::{Scalar, Word};

/// [`crate::lanes::Lanes`] in two AVX2 registers.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub struct Lanes([__m256; 2]);

/// All bits of a lane set, or none.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub struct Mask([__m256; 2]);

/// A 32-bit word per lane.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub struct Words([__m256i; 2]);

in_registers!(Lanes, Words, Mask);

macro_rules! both {
    ($make:ident, $a:expr, $f:expr) => {
        // SAFETY: see the head of this file
        $make(unsafe { [$f($a.0[0]), $f($a.0[1])] })
    };
    ($make:ident, $a:expr, $b:expr, $f:expr) => {
        // SAFETY: see the head of this file
        $make(unsafe { [$f($a.0[0], $b.0[0]), $f($a.0[1], $b.0[1])] })
    };
}

macro_rules! operator {
    ($trait:ident, $method:ident, $type:ident, $intrinsic:ident) => {
        impl $trait for $type {
            type Output = $type;
            #[inline(always)]
            fn $method(self, other: $type) -> $type {
                both!($type, self, other, $intrinsic)
            }
        }
    };
}
operator!(Add, add, Lanes, _mm256_add_ps);
operator!(Sub, sub, Lanes, _mm256_sub_ps);
operator!(Mul, mul, Lanes, _mm256_mul_ps);
operator!(Div, div, Lanes, _mm256_div_ps);
operator!(BitAnd, bitand, Mask, _mm256_and_ps);
operator!(BitOr, bitor, Mask, _mm256_or_ps);
operator!(BitXor, bitxor, Words, _mm256_xor_si256);

/// The same bits in all lanes.
#[inline(always)]
fn ones(bits: u32) -> Lanes {
    // SAFETY: see the head of this file
    Lanes(unsafe { [_mm256_set1_ps(f32::from_bits(bits)); 2] })
}

#[inline(always)]
fn word(value: u32) -> Words {
    // SAFETY: see the head of this file
    Words(unsafe { [_mm256_set1_epi32(value as i32); 2] })
}

impl Neg for Lanes {
    type Output = Lanes;
    #[inline(always)]
    fn neg(self) -> Lanes {
        both!(Lanes, self, ones(0x8000_0000), _mm256_xor_ps)
    }
}
impl Not for Mask {
    type Output = Mask;
    #[inline(always)]
    fn not(self) -> Mask {
        both!(Mask, self, ones(u32::MAX), _mm256_xor_ps)
    }
}

impl Word for Words {
    #[inline(always)]
    fn from_u32(value: u32) -> Self {
        word(value)
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        both!(Words, self, other, _mm256_add_epi32)
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        both!(Words, self, other, _mm256_mullo_epi32)
    }
    #[inline(always)]
    fn shr(self, bits: u32) -> Self {
        let count = bits as i32;
        // SAFETY: see the head of this file
        Words(unsafe {
            [
                _mm256_srl_epi32(self.0[0], _mm_cvtsi32_si128(count)),
                _mm256_srl_epi32(self.0[1], _mm_cvtsi32_si128(count)),
            ]
        })
    }
    fn set_lane(&mut self, lane: usize, value: u32) {
        self.array_mut()[lane] = value;
    }
}

impl Lanes {
    #[inline(always)]
    fn words(self) -> Words {
        both!(Words, self, _mm256_castps_si256)
    }
}

impl Words {
    #[inline(always)]
    fn lanes(self) -> Lanes {
        both!(Lanes, self, _mm256_castsi256_ps)
    }
    #[inline(always)]
    fn and(self, other: Words) -> Words {
        both!(Words, self, other, _mm256_and_si256)
    }
    /// Signed integers as numbers.
    #[inline(always)]
    fn numbers(self) -> Lanes {
        both!(Lanes, self, _mm256_cvtepi32_ps)
    }
}

impl Mask {
    /// Bit `i` set where lane `i` is true.
    #[inline(always)]
    pub fn bits(self) -> u32 {
        // SAFETY: see the head of this file
        unsafe { _mm256_movemask_ps(self.0[0]) as u32 | (_mm256_movemask_ps(self.0[1]) as u32) << 8 }
    }
    /// Lane `i` is true where bit `i` is set.
    pub fn from_bits(bits: u32) -> Mask {
        let full: [u32; LANES] = std::array::from_fn(|i| if bits >> i & 1 == 1 { u32::MAX } else { 0 });
        // SAFETY: the same size, and every bit pattern is a value of both types
        unsafe { std::mem::transmute::<[u32; LANES], Mask>(full) }
    }
}

/// `v` with its sign flipped in the lanes in which bit 1 of `n` is set.
#[inline(always)]
fn flip(v: Lanes, n: Words) -> Lanes {
    // SAFETY: see the head of this file
    let sign = Words(unsafe { [_mm256_slli_epi32::<30>(n.0[0]), _mm256_slli_epi32::<30>(n.0[1])] });
    (v.words() ^ sign.and(word(0x8000_0000))).lanes()
}

impl Scalar for Lanes {
    type Mask = Mask;
    type Word = Words;
    const SINGLE: bool = true;
    common_operations!();

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        ones((value as f32).to_bits())
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        both!(Lanes, self, _mm256_sqrt_ps)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        both!(Lanes, self, ones(0x7fff_ffff), _mm256_and_ps)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // MINPS gives its second operand where either is NaN
        both!(Lanes, other, self, _mm256_min_ps)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        both!(Lanes, other, self, _mm256_max_ps)
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Mask {
        both!(Mask, self, other, _mm256_cmp_ps::<_CMP_LT_OQ>)
    }
    #[inline(always)]
    fn le(self, other: Self) -> Mask {
        both!(Mask, self, other, _mm256_cmp_ps::<_CMP_LE_OQ>)
    }
    #[inline(always)]
    fn select(mask: Mask, yes: Self, no: Self) -> Self {
        // Bit by bit: of a blend LLVM makes masked stores, which are slow on AMD's processors.
        // SAFETY: see the head of this file
        let pick = |m, y, n| unsafe { _mm256_or_ps(_mm256_and_ps(m, y), _mm256_andnot_ps(m, n)) };
        Lanes([pick(mask.0[0], yes.0[0], no.0[0]), pick(mask.0[1], yes.0[1], no.0[1])])
    }
    #[inline(always)]
    fn nothing() -> Mask {
        Mask(ones(0).0)
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        const SQRT_HALF_BITS: u32 = 0x3f35_04f3;
        let shifted = self.words().add(word(SQRT_HALF_BITS.wrapping_neg()));
        // SAFETY: see the head of this file
        let exponent =
            Words(unsafe { [_mm256_srai_epi32::<23>(shifted.0[0]), _mm256_srai_epi32::<23>(shifted.0[1])] });
        (shifted.and(word(0x007f_ffff)).add(word(SQRT_HALF_BITS)).lanes(), exponent.numbers())
    }
    #[inline(always)]
    fn scale_exponent(self, exponent: Self) -> Self {
        let integer = (exponent + Self::from_f64(ROUND)).words().add(word(127));
        // SAFETY: see the head of this file
        let power =
            Words(unsafe { [_mm256_slli_epi32::<23>(integer.0[0]), _mm256_slli_epi32::<23>(integer.0[1])] });
        self * power.lanes()
    }
    #[inline(always)]
    fn turned(quarter: Self, sin: Self, cos: Self) -> (Self, Self) {
        // the low bits of the integer say it: odd swaps the two, 2 and 3 flip the sine, 1 and 2 the cosine
        let n = (quarter + Self::from_f64(ROUND)).words();
        let odd = Mask(both!(Words, n.and(word(1)), word(1), _mm256_cmpeq_epi32).lanes().0);
        (flip(Self::select(odd, cos, sin), n), flip(Self::select(odd, sin, cos), n.add(word(1))))
    }
}

/// Eight by eight numbers, rows for columns.
#[inline(always)]
fn transpose(r: [__m256; 8]) -> [__m256; 8] {
    // SAFETY: see the head of this file
    unsafe {
        let pairs = |a, b| (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
        let ((a0, a1), (a2, a3), (a4, a5), (a6, a7)) =
            (pairs(r[0], r[1]), pairs(r[2], r[3]), pairs(r[4], r[5]), pairs(r[6], r[7]));
        let fours = |a, b| (_mm256_shuffle_ps::<0x44>(a, b), _mm256_shuffle_ps::<0xee>(a, b));
        let ((b0, b1), (b2, b3), (b4, b5), (b6, b7)) =
            (fours(a0, a2), fours(a1, a3), fours(a4, a6), fours(a5, a7));
        let halves = |a, b| (_mm256_permute2f128_ps::<0x20>(a, b), _mm256_permute2f128_ps::<0x31>(a, b));
        let ((c0, c4), (c1, c5), (c2, c6), (c3, c7)) =
            (halves(b0, b4), halves(b1, b5), halves(b2, b6), halves(b3, b7));
        [c0, c1, c2, c3, c4, c5, c6, c7]
    }
}

/// Lanes as sixteen rows of `N` numbers, `stride` apart: blocks of eight columns through registers, a rest
/// one by one.
///
/// # Panics
/// If `rows` ends before the last of them does.
#[inline(always)]
pub fn write<const N: usize>(values: &[Lanes; N], rows: &mut [f32], stride: usize) {
    assert!(rows.len() >= (LANES - 1) * stride + N);
    let (whole, out) = (N / 8 * 8, rows.as_mut_ptr());
    for first in (0..whole).step_by(8) {
        for half in 0..2 {
            let mut block = [values[first].0[half]; 8];
            for i in 1..8 {
                block[i] = values[first + i].0[half];
            }
            let block = transpose(block);
            for i in 0..8 {
                // SAFETY: lane 8 * half + i < 16 and first + 8 <= N, so the eight numbers lie within what the
                // assertion says is there
                unsafe { _mm256_storeu_ps(out.add((8 * half + i) * stride + first), block[i]) };
            }
        }
    }
    for i in whole..N {
        for lane in 0..LANES {
            rows[lane * stride + i] = values[i].array()[lane];
        }
    }
}

/// Sixteen rows of four numbers as lanes.
///
/// # Panics
/// Unless `rows` has 64 numbers.
#[inline(always)]
pub fn read4(rows: &[f32]) -> [Lanes; 4] {
    assert_eq!(rows.len(), 4 * LANES);
    let mut out = [ones(0); 4];
    for half in 0..2 {
        // SAFETY: 32 numbers from 32 * half on lie within the 64 of the assertion
        let [a, b, c, d] = unsafe {
            let at = rows.as_ptr().add(32 * half);
            [
                _mm256_loadu_ps(at),
                _mm256_loadu_ps(at.add(8)),
                _mm256_loadu_ps(at.add(16)),
                _mm256_loadu_ps(at.add(24)),
            ]
        };
        // SAFETY: see the head of this file
        let columns = unsafe {
            // rows 0|4, 1|5, 2|6, 3|7 side by side, then four by four within each half
            let (r04, r15) = (_mm256_permute2f128_ps::<0x20>(a, c), _mm256_permute2f128_ps::<0x31>(a, c));
            let (r26, r37) = (_mm256_permute2f128_ps::<0x20>(b, d), _mm256_permute2f128_ps::<0x31>(b, d));
            let (x, y) = (_mm256_unpacklo_ps(r04, r15), _mm256_unpacklo_ps(r26, r37));
            let (z, w) = (_mm256_unpackhi_ps(r04, r15), _mm256_unpackhi_ps(r26, r37));
            [
                _mm256_shuffle_ps::<0x44>(x, y),
                _mm256_shuffle_ps::<0xee>(x, y),
                _mm256_shuffle_ps::<0x44>(z, w),
                _mm256_shuffle_ps::<0xee>(z, w),
            ]
        };
        for i in 0..4 {
            out[i].0[half] = columns[i];
        }
    }
    out
}
