//! The instruction set is chosen at run time; the results are the same bits on each. The only `unsafe` of the crate is here.

use crate::error::{Result, unknown};

/// What the machine is asked to use. Opaque, so that one which the machine lacks cannot be made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Level(Kind);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// What every machine of the target has (SSE2 on x86-64).
    Baseline,
    /// 256-bit registers.
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl Level {
    /// The widest that this machine has.
    pub fn best() -> Level {
        *Level::available().last().unwrap_or(&Level(Kind::Baseline))
    }

    /// All that this machine has, narrowest first.
    pub fn available() -> Vec<Level> {
        let mut levels = vec![Level(Kind::Baseline)];
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            levels.push(Level(Kind::Avx2));
        }
        levels
    }

    /// "baseline", "avx2"; `None` asks for the best.
    ///
    /// # Errors
    /// [`crate::Error::Unknown`] for a name that this machine does not have.
    pub fn named(name: Option<&str>) -> Result<Level> {
        let Some(name) = name else { return Ok(Level::best()) };
        let levels = Level::available();
        let found = levels.iter().find(|l| l.name() == name).copied();
        found.ok_or_else(|| unknown("instruction set of this machine", name, levels.iter().map(|l| l.name())))
    }

    pub fn name(self) -> &'static str {
        match self.0 {
            Kind::Baseline => "baseline",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
        }
    }

    pub(crate) fn kind(self) -> Kind {
        self.0
    }
}

/// Runs a piece of code compiled for an instruction set. No fused multiply-add is ever enabled: it would change the bits.
pub(crate) trait Isa: Send + 'static {
    fn run<T>(code: impl FnOnce() -> T) -> T;
}

pub(crate) struct Baseline;

impl Isa for Baseline {
    #[inline(always)]
    fn run<T>(code: impl FnOnce() -> T) -> T {
        code()
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) struct Avx2;

#[cfg(target_arch = "x86_64")]
impl Isa for Avx2 {
    #[inline(always)]
    #[allow(unsafe_code)]
    fn run<T>(code: impl FnOnce() -> T) -> T {
        #[target_feature(enable = "avx2")]
        fn with_avx2<T>(code: impl FnOnce() -> T) -> T {
            code()
        }
        // SAFETY: calling a function that enables AVX2 needs a processor that has it. `Avx2::run` is reached only through
        // a `Level` of `Kind::Avx2`; the field is private to this file, and the one place that makes such a value,
        // `Level::available`, does so only after `is_x86_feature_detected!("avx2")` said yes.
        unsafe { with_avx2(code) }
    }
}
