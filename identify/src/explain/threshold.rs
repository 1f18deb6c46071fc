//! Numbers that decide what counts as found. To see what depends on one of them, a run may scale it.

use std::sync::atomic::{AtomicU64, Ordering};

use super::calibration::thresholds;

/// A number that decides: its declared value, times the factor of this process.
#[derive(Debug)]
pub struct Threshold {
    module: &'static str,
    name: &'static str,
    declared: f64,
    /// Bits of the value in use. Set between runs, never within one.
    value: AtomicU64,
}

impl Threshold {
    /// A threshold with its declared value. `module` is the path of the module that declares it.
    pub(super) const fn new(module: &'static str, name: &'static str, declared: f64) -> Self {
        Threshold { module, name, declared, value: AtomicU64::new(declared.to_bits()) }
    }

    /// Value in use.
    pub(super) fn get(&self) -> f64 {
        f64::from_bits(self.value.load(Ordering::Relaxed))
    }

    /// Stage and name, as "verdict.WORTH_FIT".
    #[must_use]
    pub fn path(&self) -> String {
        let stage = self.module.rsplit("::").next().unwrap_or(self.module);
        format!("{stage}.{}", self.name)
    }

    /// Declared value.
    #[must_use]
    pub fn declared(&self) -> f64 {
        self.declared
    }

    /// Uses `factor` times the declared value from now on, in the whole process.
    pub fn scale(&self, factor: f64) {
        self.value.store((factor * self.declared).to_bits(), Ordering::Relaxed);
    }
}

/// All thresholds of a search for effects.
pub fn all() -> impl Iterator<Item = &'static Threshold> {
    thresholds().into_iter().flatten().copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_have_names_of_their_own_and_scale() {
        let names: Vec<String> = all().map(Threshold::path).collect();
        assert!(names.contains(&"verdict.WORTH_FIT".to_owned()), "{names:?}");
        assert!(names.iter().enumerate().all(|(i, name)| !names[..i].contains(name)), "{names:?}");
        let own = Threshold::new("a::b", "X", 4.0);
        own.scale(0.5);
        assert_eq!((own.get(), own.declared(), own.path().as_str()), (2.0, 4.0, "b.X"));
    }
}
