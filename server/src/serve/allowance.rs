//! Limits on how often something may happen within a while: lines of the log, and guesses of a secret.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use super::lock;

/// Keys that are kept before those that are over are dropped.
const KEPT: usize = 1024;

/// A number of times for each key and window of time.
pub(crate) struct Allowance<K> {
    times: u32,
    window: Duration,
    /// When the window of a key began, and how often it has happened since.
    counts: Mutex<HashMap<K, (Instant, u32)>>,
}

impl<K: Eq + Hash> Allowance<K> {
    pub(crate) fn new(times: u32, window: Duration) -> Self {
        Allowance { times, window, counts: Mutex::default() }
    }

    /// Counts one more time. Returns how many of the allowed times are left, this one included; 0 if it is one too
    /// many.
    pub(crate) fn take(&self, key: K) -> u32 {
        let mut counts = lock(&self.counts);
        if counts.len() >= KEPT {
            counts.retain(|_, (since, _)| since.elapsed() < self.window);
        }
        let (since, count) = counts.entry(key).or_insert_with(|| (Instant::now(), 0));
        if since.elapsed() >= self.window {
            (*since, *count) = (Instant::now(), 0);
        }
        *count = count.saturating_add(1);
        (self.times + 1).saturating_sub(*count)
    }

    /// Uncounts one time.
    pub(crate) fn give_back(&self, key: &K) {
        if let Some((_, count)) = lock(&self.counts).get_mut(key) {
            *count = count.saturating_sub(1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_key_has_its_times_in_a_window() {
        let allowance = Allowance::new(2, Duration::from_secs(3600));
        assert_eq!([1, 1, 2, 1, 1, 2].map(|key| allowance.take(key)), [2, 1, 2, 0, 0, 1]);
        let brief = Allowance::new(1, Duration::ZERO);
        assert_eq!([7, 7, 7].map(|key| brief.take(key)), [1, 1, 1]);
        for key in 0..10_000 {
            brief.take(key);
        }
        assert!(lock(&brief.counts).len() <= KEPT, "keys that are over are dropped");
    }
}
