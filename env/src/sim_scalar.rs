//! The number types that the simulator is compiled for, and what a tile of each must be able to do.

use crate::dual::{Dual, Mean};
use crate::effects::{Build, Entry, Stage};
use crate::lanes::{LANES, LaneMask, Lanes};
use crate::scalar::Scalar;
#[cfg(feature = "recording")]
use crate::symbol::Symbol;

/// A number type that a world can be made of.
pub trait SimScalar: Scalar {
    /// The end of a lone drone's tick is inlined into every task: fast, and long to compile.
    const INLINED: bool = false;
    #[doc(hidden)]
    fn stage(entry: &Entry, build: Build) -> Box<dyn Stage<Self>>;
    /// Runs `code` compiled for the instruction set that this type is written for.
    #[inline(always)]
    fn run<T>(code: impl FnOnce() -> T) -> T {
        code()
    }
    /// Attributes the following to a part of the simulator, for number types that keep account.
    #[inline(always)]
    fn enter(_part: &'static str) {}
}

/// A number type of sixteen lanes, which a batch of environments can be made of.
pub(crate) trait BatchScalar: SimScalar {
    fn bits(mask: Self::Mask) -> u32;
    fn mask(bits: u32) -> Self::Mask;
    fn array(&self) -> &[f32; LANES];
    /// Sixteen rows of four numbers.
    fn read4(rows: &[f32]) -> [Self; 4];
    /// Sixteen rows of `N` numbers, `stride` apart.
    fn write<const N: usize>(values: &[Self; N], rows: &mut [f32], stride: usize);
}

impl SimScalar for f64 {
    fn stage(entry: &Entry, build: Build) -> Box<dyn Stage<Self>> {
        (entry.double)(build)
    }
}

#[cfg(feature = "recording")]
impl SimScalar for Symbol {
    fn stage(entry: &Entry, build: Build) -> Box<dyn Stage<Self>> {
        (entry.symbol)(build)
    }
    fn enter(part: &'static str) {
        crate::symbol::enter(part);
    }
}

impl SimScalar for Dual {
    fn stage(entry: &Entry, build: Build) -> Box<dyn Stage<Self>> {
        (entry.dual)(build)
    }
    #[inline(always)]
    #[allow(unsafe_code)]
    fn run<T>(code: impl FnOnce() -> T) -> T {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: just asked
            return unsafe { crate::isa::with_avx2(code) };
        }
        code()
    }
}

impl SimScalar for Mean {
    fn stage(entry: &Entry, build: Build) -> Box<dyn Stage<Self>> {
        (entry.mean)(build)
    }
}

impl SimScalar for Lanes {
    fn stage(entry: &Entry, build: Build) -> Box<dyn Stage<Self>> {
        (entry.lanes)(build)
    }
}

impl BatchScalar for Lanes {
    #[inline(always)]
    fn bits(mask: LaneMask) -> u32 {
        mask.bits()
    }
    fn mask(bits: u32) -> LaneMask {
        LaneMask::from(std::array::from_fn(|lane| bits >> lane & 1 == 1))
    }
    #[inline(always)]
    fn array(&self) -> &[f32; LANES] {
        Lanes::array(self)
    }
    #[inline(always)]
    fn read4(rows: &[f32]) -> [Self; 4] {
        let mut out = [Lanes::zero(); 4];
        for (lane, row) in rows.chunks_exact(4).enumerate() {
            for (slot, value) in out.iter_mut().zip(row) {
                slot.array_mut()[lane] = *value;
            }
        }
        out
    }
    #[inline(always)]
    fn write<const N: usize>(values: &[Self; N], rows: &mut [f32], stride: usize) {
        for (lane, row) in rows.chunks_mut(stride).enumerate() {
            for (slot, value) in row.iter_mut().zip(values) {
                *slot = value.array()[lane];
            }
        }
    }
}

/// Lanes in registers: `$level` names the module's level, the registry's builder for it and the function that
/// compiles for it.
#[cfg(all(target_arch = "x86_64", not(test)))]
macro_rules! in_registers {
    ($level:ident, $lanes:ident, $with:ident) => {
        mod $level {
            use super::{BatchScalar, Build, Entry, LANES, SimScalar, Stage};
            use crate::$lanes::{self, Lanes, Mask};

            impl SimScalar for Lanes {
                const INLINED: bool = true;
                fn stage(entry: &Entry, build: Build) -> Box<dyn Stage<Self>> {
                    (entry.$level)(build)
                }
                #[inline(always)]
                #[allow(unsafe_code)]
                fn run<T>(code: impl FnOnce() -> T) -> T {
                    // SAFETY: this type is used only on a processor with its instruction set, see the head of
                    // the file of the lanes
                    unsafe { crate::isa::$with(code) }
                }
            }

            impl BatchScalar for Lanes {
                #[inline(always)]
                fn bits(mask: Mask) -> u32 {
                    mask.bits()
                }
                fn mask(bits: u32) -> Mask {
                    Mask::from_bits(bits)
                }
                #[inline(always)]
                fn array(&self) -> &[f32; LANES] {
                    Lanes::array(self)
                }
                #[inline(always)]
                fn read4(rows: &[f32]) -> [Self; 4] {
                    $lanes::read4(rows)
                }
                #[inline(always)]
                fn write<const N: usize>(values: &[Self; N], rows: &mut [f32], stride: usize) {
                    $lanes::write(values, rows, stride);
                }
            }
        }
    };
}
#[cfg(all(target_arch = "x86_64", not(test)))]
in_registers!(avx2, lanes_avx2, with_avx2);
#[cfg(all(target_arch = "x86_64", not(test)))]
in_registers!(avx512, lanes_avx512, with_avx512);
