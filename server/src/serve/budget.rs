//! Budgets: the server's amount of each resource, and the limits of one address and one token.

use std::collections::HashMap;
use std::hash::Hash;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex};

use prometheus_client::encoding::EncodeLabelValue;
use sha2::{Digest, Sha256};

use super::lock;
use super::metrics::Metrics;
use super::settings::{Limits, Shares};
use crate::protocol::{Code, ProtocolError};

/// Limited resources.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, EncodeLabelValue)]
pub(crate) enum Resource {
    Connections,
    Environments,
    ParkedSessions,
    ReplyBytes,
    RequestBytes,
    ReservedEnvironments,
    ReservedWorlds,
    Worlds,
    WorldWork,
}

/// A resource with its limits, its name after a number, and its limit as the metrics name it.
type ResourceEntry = (Resource, fn(&Limits) -> Shares, &'static str, &'static str);

/// Every resource, in the order of [`Resource`].
const RESOURCES: [ResourceEntry; 9] = [
    (Resource::Connections, |l| l.connections, "connections", "too many connections"),
    (Resource::Environments, |l| l.envs, "environments", "too many environments"),
    (
        Resource::ParkedSessions,
        |l| l.parked,
        "sessions that wait for their clients",
        "too many parked sessions",
    ),
    (Resource::ReplyBytes, |l| l.reply_bytes, "bytes of replies", "too many reply bytes"),
    (Resource::RequestBytes, |l| l.request_bytes, "bytes of requests", "too many request bytes"),
    (Resource::ReservedEnvironments, |l| l.reserved_envs, "environments", "too many environments"),
    (Resource::ReservedWorlds, |l| l.reserved_worlds, "shared worlds", "too many worlds"),
    (Resource::Worlds, |l| l.worlds, "shared worlds", "too many worlds"),
    (
        Resource::WorldWork,
        |l| l.world_work,
        "thousandths of a core for the autopilots of shared worlds",
        "too much world work",
    ),
];

impl Resource {
    /// The part for small requests, which they get when the rest is used up.
    fn reserve(self) -> Option<Resource> {
        match self {
            Resource::Environments => Some(Resource::ReservedEnvironments),
            Resource::Worlds => Some(Resource::ReservedWorlds),
            _ => None,
        }
    }
}

/// The client that pays: the address, and the token if the client has shown one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Payer {
    pub address: IpAddr,
    pub token: Option<[u8; 32]>,
    /// The token is known here. Then it pays, and the address does not: an address may have many people.
    pub known: bool,
}

impl Payer {
    /// A client that has shown no token.
    pub(crate) fn without_token(address: IpAddr) -> Payer {
        Payer { address: address_group(address), token: None, known: false }
    }
}

/// Level whose share was exceeded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Scope {
    Server,
    Address,
    Token,
}

/// A request for more than there is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Refusal {
    pub resource: Resource,
    pub scope: Scope,
    /// The amounts requested, in use, and allowed.
    amounts: [usize; 3],
}

impl Refusal {
    /// The limit, as the metrics name it.
    pub(crate) fn reason(&self) -> &'static str {
        RESOURCES[self.resource as usize].3
    }
}

impl From<Refusal> for ProtocolError {
    fn from(refusal: Refusal) -> Self {
        let Refusal { resource, scope, amounts: [asked, held, limit] } = refusal;
        let whose = match scope {
            Scope::Server => "the server",
            Scope::Address => "your address",
            Scope::Token => "your token",
        };
        let message = format!(
            "{asked} more {} would be too many: {whose} has {held} of at most {limit}; close what you do not need, or try again later",
            RESOURCES[resource as usize].2
        );
        ProtocolError::new(Code::TooMany, message)
    }
}

#[derive(Default)]
struct Held {
    server: usize,
    addresses: HashMap<IpAddr, usize>,
    tokens: HashMap<[u8; 32], usize>,
}

/// The budget of one resource.
struct Budget {
    shares: Shares,
    held: Mutex<Held>,
}

/// The budgets of all resources.
pub(crate) struct Budgets {
    /// In the order of [`RESOURCES`].
    all: Vec<Budget>,
    metrics: Arc<Metrics>,
}

/// An amount in use, given back when dropped.
pub(crate) struct Share {
    budgets: Arc<Budgets>,
    resource: Resource,
    payer: Payer,
    amount: usize,
}

impl std::fmt::Debug for Share {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {:?}", self.amount, self.resource)
    }
}

/// Bytes that a connection or a session has in memory; the first ones are free. Every byte in and out is counted by
/// one of these, in every dialect.
#[derive(Debug)]
pub(crate) struct Buffer {
    share: Share,
    free_bytes: usize,
}

impl Buffer {
    /// Makes it as large as this.
    ///
    /// # Errors
    /// The errors of [`Budgets::take`]; the buffer is then as before.
    pub(crate) fn try_fit(&mut self, bytes: usize) -> Result<(), Refusal> {
        self.share.resize(bytes.saturating_sub(self.free_bytes))
    }

    /// Makes it as large as this, and logs a refusal.
    ///
    /// # Errors
    /// The errors of [`Budgets::take`].
    pub(crate) fn fit(&mut self, bytes: usize) -> Result<(), Refusal> {
        self.try_fit(bytes).inspect_err(|refusal| self.share.budgets.record(refusal, self.share.payer))
    }
}

impl Budgets {
    pub(crate) fn new(limits: &Limits, metrics: Arc<Metrics>) -> Arc<Self> {
        let all = RESOURCES.map(|(_, shares, ..)| Budget { shares: shares(limits), held: Mutex::default() });
        Arc::new(Budgets { all: all.into(), metrics })
    }

    /// A share of a resource.
    ///
    /// # Errors
    /// [`Refusal`] if the server, the address or the token would then exceed its limit.
    pub(crate) fn take(
        self: &Arc<Self>,
        resource: Resource,
        payer: Payer,
        amount: usize,
    ) -> Result<Share, Refusal> {
        let mut share = Share { budgets: self.clone(), resource, payer, amount: 0 };
        share.resize(amount)?;
        Ok(share)
    }

    /// Takes a share like [`Budgets::take`]. A refusal is counted and logged.
    ///
    /// # Errors
    /// The errors of [`Budgets::take`].
    pub(crate) fn charge(
        self: &Arc<Self>,
        resource: Resource,
        payer: Payer,
        amount: usize,
    ) -> Result<Share, Refusal> {
        self.take(resource, payer, amount).inspect_err(|refusal| self.record(refusal, payer))
    }

    /// A share of a resource; for a small request, of what is reserved for these if the rest is used up.
    ///
    /// # Errors
    /// The errors of [`Budgets::take`].
    pub(crate) fn take_for(
        self: &Arc<Self>,
        resource: Resource,
        payer: Payer,
        amount: usize,
        small: bool,
    ) -> Result<Share, Refusal> {
        self.take(resource, payer, amount).or_else(|refusal| {
            let reserve = resource.reserve().filter(|_| small);
            reserve.and_then(|reserve| self.take(reserve, payer, amount).ok()).ok_or(refusal)
        })
    }

    /// A buffer that has no more than its free bytes so far.
    pub(crate) fn buffer(self: &Arc<Self>, resource: Resource, payer: Payer, free_bytes: usize) -> Buffer {
        let share = Share { budgets: self.clone(), resource, payer, amount: 0 };
        Buffer { share, free_bytes }
    }

    /// A refusal, counted and logged.
    pub(crate) fn record(&self, refusal: &Refusal, payer: Payer) {
        self.metrics.record_limit(refusal.reason(), payer.address);
    }

    fn budget(&self, resource: Resource) -> &Budget {
        &self.all[resource as usize]
    }
}

impl Budget {
    fn refusal(&self, held: &Held, resource: Resource, payer: Payer, more: usize) -> Option<Refusal> {
        let Shares { server, address, token } = self.shares;
        let amount = |found: Option<&usize>| found.copied().unwrap_or(0);
        let scopes = [
            (Scope::Token, payer.token.map(|token| amount(held.tokens.get(&token))), token),
            (Scope::Address, (!payer.known).then(|| amount(held.addresses.get(&payer.address))), address),
            (Scope::Server, Some(held.server), server),
        ];
        scopes.into_iter().find_map(|(scope, held, limit)| {
            held.filter(|held| held.saturating_add(more) > limit).map(|held| Refusal {
                resource,
                scope,
                amounts: [more, held, limit],
            })
        })
    }
}

impl Share {
    pub(crate) fn payer(&self) -> Payer {
        self.payer
    }

    /// Counts it under a token, in place of the one before; a known one pays in place of the address, from now on.
    ///
    /// # Errors
    /// [`Refusal`] if the token would then exceed its limit.
    pub(crate) fn show_token(&mut self, token: [u8; 32], known: bool) -> Result<(), Refusal> {
        if self.payer.token == Some(token) || self.payer.known && !known {
            return Ok(());
        }
        let (budget, amount) = (self.budgets.budget(self.resource), self.amount);
        let mut held = lock(&budget.held);
        let (token_held, limit) = (held.tokens.get(&token).copied().unwrap_or(0), budget.shares.token);
        if token_held.saturating_add(amount) > limit {
            let amounts = [amount, token_held, limit];
            return Err(Refusal { resource: self.resource, scope: Scope::Token, amounts });
        }
        if let Some(before) = self.payer.token {
            change_entry(&mut held.tokens, before, |count| count.saturating_sub(amount));
        }
        change_entry(&mut held.tokens, token, |count| count + amount);
        if known && !self.payer.known {
            change_entry(&mut held.addresses, self.payer.address, |count| count.saturating_sub(amount));
        }
        (self.payer.token, self.payer.known) = (Some(token), known);
        Ok(())
    }

    /// Takes more, or gives back.
    ///
    /// # Errors
    /// The errors of [`Budgets::take`]; the share is then unchanged.
    pub(crate) fn resize(&mut self, amount: usize) -> Result<(), Refusal> {
        if amount == self.amount {
            return Ok(());
        }
        let budget = self.budgets.budget(self.resource);
        let mut held = lock(&budget.held);
        if amount > self.amount
            && let Some(refusal) = budget.refusal(&held, self.resource, self.payer, amount - self.amount)
        {
            return Err(refusal);
        }
        let before = std::mem::replace(&mut self.amount, amount);
        let change = |count: usize| (count + amount).saturating_sub(before);
        let server = change(held.server);
        held.server = server;
        if !self.payer.known {
            change_entry(&mut held.addresses, self.payer.address, change);
        }
        if let Some(token) = self.payer.token {
            change_entry(&mut held.tokens, token, change);
        }
        self.budgets.metrics.set_held(self.resource, held.server);
        Ok(())
    }
}

/// Changes a count. One that is 0 takes no memory.
fn change_entry<K: Eq + Hash>(counts: &mut HashMap<K, usize>, key: K, change: impl Fn(usize) -> usize) {
    let count = change(counts.get(&key).copied().unwrap_or(0));
    if count == 0 {
        counts.remove(&key);
    } else {
        counts.insert(key, count);
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        // giving back is never refused
        let _ = self.resize(0);
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

    fn budgets(server: usize, address: usize, token: usize) -> Arc<Budgets> {
        let limits = Limits { envs: Shares { server, address, token }, ..Limits::default() };
        Budgets::new(&limits, Arc::new(Metrics::new(None)))
    }

    fn payer(last: u8, token: Option<u8>) -> Payer {
        Payer { token: token.map(|token| [token; 32]), ..Payer::without_token([10, 0, 0, last].into()) }
    }

    #[test]
    fn every_resource_has_its_place() {
        for (place, (resource, ..)) in RESOURCES.into_iter().enumerate() {
            assert_eq!(resource as usize, place);
        }
    }

    #[test]
    fn shares_are_counted_and_given_back() {
        let budgets = budgets(10, 6, 4);
        let take = |payer, amount| budgets.take(Resource::Environments, payer, amount);
        let a = take(payer(1, None), 6).unwrap();
        assert_eq!(take(payer(1, None), 1).unwrap_err().scope, Scope::Address);
        let mut b = take(payer(2, Some(7)), 4).unwrap();
        assert_eq!(take(payer(3, Some(7)), 1).unwrap_err().scope, Scope::Token);
        assert_eq!(take(payer(3, None), 1).unwrap_err().scope, Scope::Server);
        b.resize(1).unwrap();
        drop(take(payer(3, None), 3).unwrap());
        assert_eq!(b.resize(9).unwrap_err().scope, Scope::Token);
        assert_eq!(lock(&budgets.budget(Resource::Environments).held).server, 7);
        drop((a, b));
        let held = lock(&budgets.budget(Resource::Environments).held);
        assert!(held.server == 0 && held.addresses.is_empty() && held.tokens.is_empty(), "nothing must stay");
    }

    #[test]
    fn a_token_that_is_known_pays_in_place_of_the_address() {
        let budgets = budgets(10, 3, 4);
        let take = |payer, amount| budgets.take(Resource::Environments, payer, amount);
        let mut pupil = take(payer(1, None), 2).unwrap();
        pupil.show_token([7; 32], true).unwrap();
        assert!(pupil.payer().known);
        let mates = take(payer(1, None), 3).unwrap();
        pupil.resize(4).unwrap();
        assert_eq!(pupil.resize(5).unwrap_err().scope, Scope::Token);
        // a token that anybody can invent changes nothing
        pupil.show_token([8; 32], false).unwrap();
        assert_eq!(pupil.payer().token, Some([7; 32]));
        drop((pupil, mates));
        let held = lock(&budgets.budget(Resource::Environments).held);
        assert!(held.server == 0 && held.addresses.is_empty() && held.tokens.is_empty(), "nothing must stay");
    }

    #[test]
    fn small_requests_have_a_reserve() {
        let budgets = budgets(10, 6, 6);
        let take = |payer, amount, small| budgets.take_for(Resource::Environments, payer, amount, small);
        let hog = take(payer(1, None), 6, false).unwrap();
        assert_eq!(take(payer(1, None), 2, false).unwrap_err().amounts, [2, 6, 6]);
        assert_eq!(take(payer(1, None), 2, true).unwrap().resource, Resource::ReservedEnvironments);
        drop(hog);
        assert_eq!(take(payer(1, None), 2, true).unwrap().resource, Resource::Environments);
    }

    #[test]
    fn a_refusal_says_whose_limit_it_is() {
        let budgets = budgets(10, 6, 4);
        let error = ProtocolError::from(budgets.take(Resource::Environments, payer(1, None), 7).unwrap_err());
        assert!(
            error.message.contains("7 more environments")
                && error.message.contains("your address has 0 of at most 6"),
            "{error}"
        );
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
