//! The instruction set is chosen at run time; the results are the same bits on each.

use crate::error::{Result, find_named};

/// Instruction set that the program uses. Opaque, so that one which the machine lacks cannot be made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Level(Kind);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// The instructions of every machine of the target (SSE2 on x86-64).
    Baseline,
    /// 256-bit registers.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// 512-bit registers.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Level {
    /// The widest that this machine has.
    pub fn best() -> Level {
        *Level::available().last().unwrap_or(&Level(Kind::Baseline))
    }

    /// All that this machine has, narrowest first. The one place where a level is made.
    pub fn available() -> Vec<Level> {
        let kinds = [
            (Kind::Baseline, true),
            #[cfg(target_arch = "x86_64")]
            (Kind::Avx2, std::arch::is_x86_feature_detected!("avx2")),
            #[cfg(target_arch = "x86_64")]
            (Kind::Avx512, {
                std::arch::is_x86_feature_detected!("avx512f")
                    && std::arch::is_x86_feature_detected!("avx512dq")
            }),
        ];
        kinds.into_iter().filter(|(_, has)| *has).map(|(kind, _)| Level(kind)).collect()
    }

    /// Returns the level named "baseline", "avx2" or "avx512"; the best for `None`.
    ///
    /// # Errors
    /// [`crate::Error::Unknown`] for a name that this machine does not have.
    pub fn named(name: Option<&str>) -> Result<Level> {
        let Some(name) = name else { return Ok(Level::best()) };
        find_named("instruction set of this machine", name, Level::available(), |level| level.name())
    }

    /// Returns the name that [`Level::named`] reads.
    pub fn name(self) -> &'static str {
        match self.0 {
            Kind::Baseline => "baseline",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => "avx512",
        }
    }

    pub(crate) fn kind(self) -> Kind {
        self.0
    }
}

/// Functions that run a piece of code compiled for an instruction set. The compiler does not fuse
/// multiplications with additions on its own, also where the instruction set would have it (AVX-512 does):
/// that would change the bits.
#[cfg(target_arch = "x86_64")]
macro_rules! compiled_for {
    ($name:ident, $features:literal) => {
        /// # Safety
        /// The processor must have the instruction set.
        #[allow(unsafe_code)]
        #[inline(always)]
        pub(crate) unsafe fn $name<T>(code: impl FnOnce() -> T) -> T {
            #[target_feature(enable = $features)]
            fn compiled<T>(code: impl FnOnce() -> T) -> T {
                code()
            }
            // SAFETY: the caller's promise
            unsafe { compiled(code) }
        }
    };
}
#[cfg(target_arch = "x86_64")]
compiled_for!(with_avx2, "avx2");
#[cfg(all(target_arch = "x86_64", not(test)))]
compiled_for!(with_avx512, "avx512f,avx512dq");
