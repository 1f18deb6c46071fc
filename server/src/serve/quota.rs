//! Quotas: connections per address, per token.

use std::collections::HashMap;
use std::hash::Hash;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex};

use sha2::{Digest, Sha256};

use super::session_registry::lock;

/// Number of slots in use by each key, with a limit.
pub(crate) struct Quota<K> {
    held: Mutex<HashMap<K, usize>>,
    max: usize,
}

/// One of a key's slots; given back when dropped.
pub(crate) struct QuotaSlot<K: Eq + Hash> {
    quota: Arc<Quota<K>>,
    key: K,
}

impl<K: Eq + Hash + Clone> Quota<K> {
    pub(crate) fn new(max: usize) -> Arc<Self> {
        Arc::new(Quota { held: Mutex::default(), max })
    }

    /// A slot for `key`, unless it is at its limit.
    pub(crate) fn enter(self: &Arc<Self>, key: K) -> Option<QuotaSlot<K>> {
        let mut held = lock(&self.held);
        let count = held.entry(key.clone()).or_insert(0);
        if *count >= self.max {
            return None;
        }
        *count += 1;
        Some(QuotaSlot { quota: self.clone(), key })
    }
}

impl<K: Eq + Hash> Drop for QuotaSlot<K> {
    fn drop(&mut self) {
        let mut held = lock(&self.quota.held);
        if let Some(count) = held.get_mut(&self.key) {
            *count -= 1;
            if *count == 0 {
                held.remove(&self.key);
            }
        }
    }
}

/// The address that is counted: with IPv6 a client can choose from a network of 64 bits, so the network.
pub(crate) fn address_group(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) => Ipv6Addr::from_bits(v6.to_bits() & !u128::from(u64::MAX)).into(),
        v4 => v4,
    }
}

/// Hash of a token. Only hashes are kept and compared, so a look-up reveals nothing of the token.
pub(crate) fn token_digest(token: &str) -> [u8; 32] {
    Sha256::digest(token.as_bytes()).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_counted_and_given_back() {
        let quota = Quota::new(2);
        let (a, b) = (quota.enter("x"), quota.enter("x"));
        assert!(a.is_some() && b.is_some() && quota.enter("x").is_none() && quota.enter("y").is_some());
        drop(a);
        assert!(quota.enter("x").is_some());
        drop(b);
        assert!(lock(&quota.held).is_empty(), "a key without places must not take memory");
    }

    #[test]
    fn an_ipv6_network_is_one_household() {
        let [a, b, c] = ["2001:db8:1:2::1", "2001:db8:1:2:ffff::9", "2001:db8:1:3::1"]
            .map(|s| address_group(s.parse().unwrap()));
        assert!(a == b && b != c);
        assert_eq!(
            address_group("::ffff:10.0.0.1".parse().unwrap()),
            address_group("10.0.0.1".parse().unwrap())
        );
    }
}
