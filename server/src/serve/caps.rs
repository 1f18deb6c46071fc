//! How many of something one key holds: connections per address, per token.

use std::collections::HashMap;
use std::hash::Hash;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex};

use sha2::{Digest, Sha256};

use super::listed::lock;

pub(crate) struct Counts<K> {
    held: Mutex<HashMap<K, usize>>,
    most: usize,
}

/// One of a key's places; given back when dropped.
pub(crate) struct Slot<K: Eq + Hash> {
    counts: Arc<Counts<K>>,
    key: K,
}

impl<K: Eq + Hash + Clone> Counts<K> {
    pub(crate) fn new(most: usize) -> Arc<Self> {
        Arc::new(Counts { held: Mutex::default(), most })
    }

    /// A place for `key`, unless it has as many as it may.
    pub(crate) fn enter(self: &Arc<Self>, key: K) -> Option<Slot<K>> {
        let mut held = lock(&self.held);
        let count = held.entry(key.clone()).or_insert(0);
        if *count >= self.most {
            return None;
        }
        *count += 1;
        Some(Slot { counts: self.clone(), key })
    }
}

impl<K: Eq + Hash> Drop for Slot<K> {
    fn drop(&mut self) {
        let mut held = lock(&self.counts.held);
        if let Some(count) = held.get_mut(&self.key) {
            *count -= 1;
            if *count == 0 {
                held.remove(&self.key);
            }
        }
    }
}

/// Who an address belongs to: with IPv6 everyone has a network of 64 bits to choose from.
pub(crate) fn household(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) => Ipv6Addr::from_bits(v6.to_bits() & !u128::from(u64::MAX)).into(),
        v4 => v4,
    }
}

/// Tokens are kept and compared only so: what is looked up tells nothing of the token.
pub(crate) fn digest(token: &str) -> [u8; 32] {
    Sha256::digest(token.as_bytes()).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_counted_and_given_back() {
        let counts = Counts::new(2);
        let (a, b) = (counts.enter("x"), counts.enter("x"));
        assert!(a.is_some() && b.is_some() && counts.enter("x").is_none() && counts.enter("y").is_some());
        drop(a);
        assert!(counts.enter("x").is_some());
        drop(b);
        assert!(lock(&counts.held).is_empty(), "a key without places must not take memory");
    }

    #[test]
    fn an_ipv6_network_is_one_household() {
        let [a, b, c] = ["2001:db8:1:2::1", "2001:db8:1:2:ffff::9", "2001:db8:1:3::1"].map(|s| household(s.parse().unwrap()));
        assert!(a == b && b != c);
        assert_eq!(household("::ffff:10.0.0.1".parse().unwrap()), household("10.0.0.1".parse().unwrap()));
    }
}
