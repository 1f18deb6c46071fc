//! State that all connections share, and the client of each.

use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::http::HeaderMap;
use tokio::sync::{OnceCell, Semaphore};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::allowance::Allowance;
use super::answers::TaggedBody;
use super::budget::{Budgets, Payer, Refusal, Resource, Share, token_digest};
use super::flown::FlownList;
use super::lock;
use super::metrics::Metrics;
use super::session::Session;
use super::session_registry::SessionRegistry;
use super::settings::{Limits, Settings};
use super::turns::{Queue, Turns};
use super::worlds::WorldRegistry;
use crate::protocol::ProtocolError;

/// Answers that flights are simulated for, at a time.
pub(super) const FLIGHTS_AT_ONCE: u32 = 2;

/// Logs of one address in a minute.
pub(super) const UPLOADS: u32 = 60;

/// Wrong invitations of one address in a minute, and tokens that are looked up.
const GUESSES: u32 = 30;

/// State that all connections share.
pub(crate) struct Server {
    pub settings: Settings,
    pub address: SocketAddr,
    /// Turns of whoever simulates flights for an answer over HTTP.
    pub flights: Arc<Semaphore>,
    pub sessions: Arc<SessionRegistry>,
    pub worlds: WorldRegistry,
    pub flown: FlownList,
    /// The flight that the page shows while nobody flies, once it has been requested.
    pub showcase: OnceCell<TaggedBody>,
    /// Invitations that fitted no world.
    pub guesses: Allowance<IpAddr>,
    /// Logs that were uploaded.
    pub uploads: Allowance<IpAddr>,
    /// Tokens that were not known.
    token_guesses: Allowance<IpAddr>,
    pub metrics: Arc<Metrics>,
    pub stop: CancellationToken,
    pub tasks: TaskTracker,
    pub budgets: Arc<Budgets>,
    pub turns: Arc<Turns>,
}

/// The client of a connection, its share of the connections, and its place in the queue.
pub(crate) struct Peer {
    pub address: SocketAddr,
    pub queue: Queue,
    share: Mutex<Share>,
    /// None for a proxy: its clients have theirs.
    connections: usize,
    pub server: Arc<Server>,
}

impl Server {
    pub(super) fn new(settings: Settings, address: SocketAddr) -> Arc<Self> {
        let limits = settings.limits.clone();
        let metrics = Arc::new(Metrics::new(settings.extension.as_ref()));
        let budgets = Budgets::new(&limits, metrics.clone());
        let sessions = Arc::new(SessionRegistry::new(budgets.clone(), metrics.clone(), limits.small_envs));
        let (stop, tasks) = (CancellationToken::new(), TaskTracker::new());
        let flights = Arc::new(Semaphore::new(FLIGHTS_AT_ONCE as usize));
        Arc::new(Server {
            settings,
            address,
            flights,
            sessions,
            worlds: WorldRegistry::default(),
            flown: FlownList::default(),
            showcase: OnceCell::new(),
            guesses: Allowance::new(GUESSES, Duration::from_secs(60)),
            uploads: Allowance::new(UPLOADS, Duration::from_secs(60)),
            token_guesses: Allowance::new(GUESSES, Duration::from_secs(60)),
            metrics,
            stop,
            tasks,
            budgets,
            turns: Turns::new(),
        })
    }

    /// Returns whether an address is a proxy's whose word counts.
    pub(super) fn is_proxy(&self, address: SocketAddr) -> bool {
        self.settings.trusted_proxies.contains(&address.ip().to_canonical())
    }

    /// Keeps the session for its client, for as long as the limits allow.
    pub(crate) fn park(self: &Arc<Self>, session: Session) {
        let (keep, stop) = (self.settings.limits.resume_for, self.stop.clone());
        self.tasks.spawn(self.sessions.clone().park(session, keep, stop));
    }
}

impl Peer {
    /// The client at `address`, which has so many connections more.
    ///
    /// # Errors
    /// A refusal, counted and logged.
    pub(super) fn new(
        server: &Arc<Server>,
        address: SocketAddr,
        connections: usize,
    ) -> Result<Arc<Peer>, Refusal> {
        let payer = Payer::without_token(address.ip());
        let taken = server.budgets.charge(Resource::Connections, payer, connections);
        let share = taken.inspect_err(|_| server.metrics.record_refusal("too many connections"))?;
        server.metrics.connections_total.inc_by(connections as u64);
        server.metrics.connections.inc_by(connections as i64);
        let (queue, share) = (server.turns.queue(payer.address), Mutex::new(share));
        Ok(Arc::new(Peer { address, queue, share, connections, server: server.clone() }))
    }

    /// The client of a request: the peer, or the one that a trusted proxy names. A proxy adds the address that it sees
    /// at the end, so only the last one is believed.
    ///
    /// # Errors
    /// The errors of [`Peer::new`].
    pub(super) fn behind(self: &Arc<Self>, headers: &HeaderMap) -> Result<Arc<Peer>, Refusal> {
        if !self.server.is_proxy(self.address) {
            return Ok(self.clone());
        }
        let named = headers.get_all("x-forwarded-for").iter().next_back().and_then(|line| line.to_str().ok());
        let client = named.and_then(|line| line.rsplit(',').next()?.trim().parse().ok());
        client.map_or_else(|| Ok(self.clone()), |ip| Peer::new(&self.server, SocketAddr::new(ip, 0), 1))
    }

    pub(crate) fn limits(&self) -> &Limits {
        &self.server.settings.limits
    }

    /// Returns the payer of the client's requests.
    pub(crate) fn payer(&self) -> Payer {
        lock(&self.share).payer()
    }

    /// Counts the connection among those of a token.
    ///
    /// # Errors
    /// `too_many`.
    pub(crate) fn count_token(&self, token: &str) -> Result<(), ProtocolError> {
        let digest = token_digest(token);
        let known = self.payer().token != Some(digest) && self.is_known(token);
        let shown = lock(&self.share).show_token(digest, known);
        shown.map_err(|refusal| {
            self.server.budgets.record(&refusal, self.payer());
            refusal.into()
        })
    }

    /// Returns whether the extension knows a token. An address that has shown too many others is not looked up.
    fn is_known(&self, token: &str) -> bool {
        let Some(extension) = &self.server.settings.extension else { return false };
        let (guesses, address) = (&self.server.token_guesses, self.payer().address);
        let known = guesses.take(address) > 0 && extension.knows_token(token);
        if known {
            guesses.give_back(&address);
        }
        known
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.server.metrics.connections.dec_by(self.connections as i64);
    }
}
