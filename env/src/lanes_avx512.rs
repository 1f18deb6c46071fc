//! Sixteen drones at once in one AVX-512 register; operation for operation the same results as
//! [`crate::lanes::Lanes`].
//!
//! SAFETY, for all of this file: the intrinsics need a processor with AVX-512 F and DQ. Values of these types are
//! made only inside tiles, stages and judges that [`crate::vector`] builds for a [`crate::isa::Level`] of AVX-512,
//! and such a level exists only after `is_x86_feature_detected!` was true for both (see `isa.rs`). The types are
//! private to the crate, so nobody else can make one.
#![allow(unsafe_code)]

use std::arch::x86_64::*;
use std::fmt;
use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Neg, Not, Sub};

use crate::lanes::{LANES, ROUND, common_operations, in_registers};
use crate::scalar::{Scalar, Word};

/// [`crate::lanes::Lanes`] in one AVX-512 register.
#[derive(Clone, Copy)]
#[repr(transparent)]
pub struct Lanes(__m512);

/// Bit `i` is set where lane `i` is true.
#[derive(Clone, Copy)]
#[repr(transparent)]
pub struct Mask(__mmask16);

/// A 32-bit word per lane.
#[derive(Clone, Copy)]
#[repr(transparent)]
pub struct Words(__m512i);

in_registers!(Lanes, Words, Mask);

macro_rules! operator {
    ($trait:ident, $method:ident, $type:ident, $intrinsic:ident) => {
        impl $trait for $type {
            type Output = $type;
            #[inline(always)]
            fn $method(self, other: $type) -> $type {
                // SAFETY: see the head of this file
                $type(unsafe { $intrinsic(self.0, other.0) })
            }
        }
    };
}
operator!(Add, add, Lanes, _mm512_add_ps);
operator!(Sub, sub, Lanes, _mm512_sub_ps);
operator!(Mul, mul, Lanes, _mm512_mul_ps);
operator!(Div, div, Lanes, _mm512_div_ps);
operator!(BitXor, bitxor, Words, _mm512_xor_si512);

#[inline(always)]
fn word(value: u32) -> Words {
    // SAFETY: see the head of this file
    Words(unsafe { _mm512_set1_epi32(value as i32) })
}

impl Neg for Lanes {
    type Output = Lanes;
    #[inline(always)]
    fn neg(self) -> Lanes {
        (self.words() ^ word(0x8000_0000)).lanes()
    }
}
impl BitAnd for Mask {
    type Output = Mask;
    #[inline(always)]
    fn bitand(self, other: Mask) -> Mask {
        Mask(self.0 & other.0)
    }
}
impl BitOr for Mask {
    type Output = Mask;
    #[inline(always)]
    fn bitor(self, other: Mask) -> Mask {
        Mask(self.0 | other.0)
    }
}
impl Not for Mask {
    type Output = Mask;
    #[inline(always)]
    fn not(self) -> Mask {
        Mask(!self.0)
    }
}

impl Word for Words {
    #[inline(always)]
    fn from_u32(value: u32) -> Self {
        word(value)
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: see the head of this file
        Words(unsafe { _mm512_add_epi32(self.0, other.0) })
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        // SAFETY: see the head of this file
        Words(unsafe { _mm512_mullo_epi32(self.0, other.0) })
    }
    #[inline(always)]
    fn shr(self, bits: u32) -> Self {
        // SAFETY: see the head of this file
        Words(unsafe { _mm512_srl_epi32(self.0, _mm_cvtsi32_si128(bits as i32)) })
    }
    fn set_lane(&mut self, lane: usize, value: u32) {
        self.array_mut()[lane] = value;
    }
}

impl Lanes {
    #[inline(always)]
    fn words(self) -> Words {
        // SAFETY: see the head of this file
        Words(unsafe { _mm512_castps_si512(self.0) })
    }
}

impl Words {
    #[inline(always)]
    fn lanes(self) -> Lanes {
        // SAFETY: see the head of this file
        Lanes(unsafe { _mm512_castsi512_ps(self.0) })
    }
    #[inline(always)]
    fn and(self, other: Words) -> Words {
        // SAFETY: see the head of this file
        Words(unsafe { _mm512_and_si512(self.0, other.0) })
    }
    /// Signed integers as numbers.
    #[inline(always)]
    fn numbers(self) -> Lanes {
        // SAFETY: see the head of this file
        Lanes(unsafe { _mm512_cvtepi32_ps(self.0) })
    }
}

impl Mask {
    /// Bit `i` set where lane `i` is true.
    #[inline(always)]
    pub fn bits(self) -> u32 {
        u32::from(self.0)
    }
    /// Lane `i` is true where bit `i` is set.
    #[inline(always)]
    pub fn from_bits(bits: u32) -> Mask {
        Mask(bits as u16)
    }
}

/// `v` with its sign flipped in the lanes in which bit 1 of `n` is set.
#[inline(always)]
fn flip(v: Lanes, n: Words) -> Lanes {
    // SAFETY: see the head of this file
    let sign = Words(unsafe { _mm512_slli_epi32::<30>(n.0) });
    (v.words() ^ sign.and(word(0x8000_0000))).lanes()
}

impl Scalar for Lanes {
    type Mask = Mask;
    type Word = Words;
    const SINGLE: bool = true;
    common_operations!();

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        // SAFETY: see the head of this file
        Lanes(unsafe { _mm512_set1_ps(value as f32) })
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: see the head of this file
        Lanes(unsafe { _mm512_sqrt_ps(self.0) })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        self.words().and(word(0x7fff_ffff)).lanes()
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // MINPS gives its second operand where either is NaN
        // SAFETY: see the head of this file
        Lanes(unsafe { _mm512_min_ps(other.0, self.0) })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: see the head of this file
        Lanes(unsafe { _mm512_max_ps(other.0, self.0) })
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Mask {
        // SAFETY: see the head of this file
        Mask(unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) })
    }
    #[inline(always)]
    fn le(self, other: Self) -> Mask {
        // SAFETY: see the head of this file
        Mask(unsafe { _mm512_cmp_ps_mask::<_CMP_LE_OQ>(self.0, other.0) })
    }
    #[inline(always)]
    fn select(mask: Mask, yes: Self, no: Self) -> Self {
        // SAFETY: see the head of this file
        Lanes(unsafe { _mm512_mask_blend_ps(mask.0, no.0, yes.0) })
    }
    #[inline(always)]
    fn nothing() -> Mask {
        Mask(0)
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        const SQRT_HALF_BITS: u32 = 0x3f35_04f3;
        let shifted = self.words().add(word(SQRT_HALF_BITS.wrapping_neg()));
        // SAFETY: see the head of this file
        let exponent = Words(unsafe { _mm512_srai_epi32::<23>(shifted.0) });
        (shifted.and(word(0x007f_ffff)).add(word(SQRT_HALF_BITS)).lanes(), exponent.numbers())
    }
    #[inline(always)]
    fn scale_exponent(self, exponent: Self) -> Self {
        let integer = (exponent + Self::from_f64(ROUND)).words().add(word(127));
        // SAFETY: see the head of this file
        let power = Words(unsafe { _mm512_slli_epi32::<23>(integer.0) });
        self * power.lanes()
    }
    #[inline(always)]
    fn turned(quarter: Self, sin: Self, cos: Self) -> (Self, Self) {
        // the low bits of the integer say it: odd swaps the two, 2 and 3 flip the sine, 1 and 2 the cosine
        let n = (quarter + Self::from_f64(ROUND)).words();
        // SAFETY: see the head of this file
        let odd = Mask(unsafe { _mm512_test_epi32_mask(n.0, word(1).0) });
        (flip(Self::select(odd, cos, sin), n), flip(Self::select(odd, sin, cos), n.add(word(1))))
    }
}

/// Four columns of sixteen rows: number `i` of the result has the rows `i`, `i` + 4, `i` + 8 and `i` + 12,
/// one in each quarter.
#[inline(always)]
fn quarters(values: &[Lanes]) -> [Lanes; 4] {
    let (a, b, c, d) = (values[0].0, values[1].0, values[2].0, values[3].0);
    // SAFETY: see the head of this file
    unsafe {
        let (x, y) = (_mm512_unpacklo_ps(a, b), _mm512_unpacklo_ps(c, d));
        let (z, w) = (_mm512_unpackhi_ps(a, b), _mm512_unpackhi_ps(c, d));
        [
            Lanes(_mm512_shuffle_ps::<0x44>(x, y)),
            Lanes(_mm512_shuffle_ps::<0xee>(x, y)),
            Lanes(_mm512_shuffle_ps::<0x44>(z, w)),
            Lanes(_mm512_shuffle_ps::<0xee>(z, w)),
        ]
    }
}

/// Lanes as sixteen rows of `N` numbers, `stride` apart: blocks of sixteen columns, then of eight, then of
/// four, through registers. (Wide stores, because of narrow ones the compiler makes narrow shuffles, and of
/// those the processor does one per cycle.)
///
/// # Panics
/// If `rows` ends before the last of them does. It does not compile unless `N` is divisible by four.
#[inline(always)]
pub fn write<const N: usize>(values: &[Lanes; N], rows: &mut [f32], stride: usize) {
    const { assert!(N.is_multiple_of(4)) };
    assert!(rows.len() >= (LANES - 1) * stride + N);
    let out = rows.as_mut_ptr();
    let mut first = 0;
    // SAFETY: each call writes the columns from `first` on, of which there are as many as the condition says,
    // in sixteen rows of N numbers, of which the assertion says that they are there
    unsafe {
        while first + 16 <= N {
            write16(&values[first..first + 16], out.add(first), stride);
            first += 16;
        }
        if first + 8 <= N {
            write8(&values[first..first + 8], out.add(first), stride);
            first += 8;
        }
        if first + 4 <= N {
            write4(&values[first..first + 4], out.add(first), stride);
        }
    }
}

/// # Safety
/// There must be 16 numbers in each of 16 rows at `out`, `stride` apart.
#[inline(always)]
unsafe fn write16(values: &[Lanes], out: *mut f32, stride: usize) {
    let (a, b, c, d) =
        (quarters(&values[..4]), quarters(&values[4..8]), quarters(&values[8..12]), quarters(&values[12..]));
    for i in 0..4 {
        // SAFETY: row i + 12 is at most the last; and see the head of this file
        unsafe {
            // quarters of even and of odd rows, then row by row
            let (ab, cd) =
                (_mm512_shuffle_f32x4::<0x88>(a[i].0, b[i].0), _mm512_shuffle_f32x4::<0x88>(c[i].0, d[i].0));
            let (ef, gh) =
                (_mm512_shuffle_f32x4::<0xdd>(a[i].0, b[i].0), _mm512_shuffle_f32x4::<0xdd>(c[i].0, d[i].0));
            _mm512_storeu_ps(out.add(i * stride), _mm512_shuffle_f32x4::<0x88>(ab, cd));
            _mm512_storeu_ps(out.add((i + 4) * stride), _mm512_shuffle_f32x4::<0x88>(ef, gh));
            _mm512_storeu_ps(out.add((i + 8) * stride), _mm512_shuffle_f32x4::<0xdd>(ab, cd));
            _mm512_storeu_ps(out.add((i + 12) * stride), _mm512_shuffle_f32x4::<0xdd>(ef, gh));
        }
    }
}

/// # Safety
/// Writes 8 numbers like [`write16`].
#[inline(always)]
unsafe fn write8(values: &[Lanes], out: *mut f32, stride: usize) {
    let (a, b) = (quarters(&values[..4]), quarters(&values[4..]));
    for i in 0..4 {
        // SAFETY: row i + 12 is at most the last; and see the head of this file
        unsafe {
            let (low, high) =
                (_mm512_setr_epi64(0, 1, 8, 9, 2, 3, 10, 11), _mm512_setr_epi64(4, 5, 12, 13, 6, 7, 14, 15));
            let (x, y) = (_mm512_castps_pd(a[i].0), _mm512_castps_pd(b[i].0));
            let (low, high) = (_mm512_permutex2var_pd(x, low, y), _mm512_permutex2var_pd(x, high, y));
            _mm256_storeu_pd(out.add(i * stride).cast(), _mm512_castpd512_pd256(low));
            _mm256_storeu_pd(out.add((i + 4) * stride).cast(), _mm512_extractf64x4_pd::<1>(low));
            _mm256_storeu_pd(out.add((i + 8) * stride).cast(), _mm512_castpd512_pd256(high));
            _mm256_storeu_pd(out.add((i + 12) * stride).cast(), _mm512_extractf64x4_pd::<1>(high));
        }
    }
}

/// # Safety
/// Writes 4 numbers like [`write16`].
#[inline(always)]
unsafe fn write4(values: &[Lanes], out: *mut f32, stride: usize) {
    let a = quarters(values);
    for i in 0..4 {
        // SAFETY: row i + 12 is at most the last; and see the head of this file
        unsafe {
            _mm_storeu_ps(out.add(i * stride), _mm512_castps512_ps128(a[i].0));
            _mm_storeu_ps(out.add((i + 4) * stride), _mm512_extractf32x4_ps::<1>(a[i].0));
            _mm_storeu_ps(out.add((i + 8) * stride), _mm512_extractf32x4_ps::<2>(a[i].0));
            _mm_storeu_ps(out.add((i + 12) * stride), _mm512_extractf32x4_ps::<3>(a[i].0));
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
    // SAFETY: four times sixteen numbers lie within the 64 of the assertion
    unsafe {
        let at = rows.as_ptr();
        let [a, b, c, d] = [
            _mm512_loadu_ps(at),
            _mm512_loadu_ps(at.add(16)),
            _mm512_loadu_ps(at.add(32)),
            _mm512_loadu_ps(at.add(48)),
        ];
        // eight rows of two columns, one in each half
        let first = _mm512_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28, 1, 5, 9, 13, 17, 21, 25, 29);
        let third = _mm512_setr_epi32(2, 6, 10, 14, 18, 22, 26, 30, 3, 7, 11, 15, 19, 23, 27, 31);
        let (ab01, cd01) = (_mm512_permutex2var_ps(a, first, b), _mm512_permutex2var_ps(c, first, d));
        let (ab23, cd23) = (_mm512_permutex2var_ps(a, third, b), _mm512_permutex2var_ps(c, third, d));
        [
            Lanes(_mm512_shuffle_f32x4::<0x44>(ab01, cd01)),
            Lanes(_mm512_shuffle_f32x4::<0xee>(ab01, cd01)),
            Lanes(_mm512_shuffle_f32x4::<0x44>(ab23, cd23)),
            Lanes(_mm512_shuffle_f32x4::<0xee>(ab23, cd23)),
        ]
    }
}
