//! State that all connections share, and the client of each.

use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::{OnceCell, Semaphore};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::allowance::Allowance;
use super::answers::TaggedBody;
use super::budget::{Budgets, Payer, Share, token_digest};
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
const FLIGHTS_AT_ONCE: usize = 2;

/// Wrong invitations of one address in a minute.
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
    server: Arc<Server>,
}

impl Server {
    pub(super) fn new(settings: Settings, address: SocketAddr) -> Arc<Self> {
        let limits = settings.limits.clone();
        let metrics = Arc::new(Metrics::new(settings.extension.as_ref()));
        let budgets = Budgets::new(&limits, metrics.clone());
        let sessions = Arc::new(SessionRegistry::new(budgets.clone(), metrics.clone()));
        let (stop, tasks) = (CancellationToken::new(), TaskTracker::new());
        let flights = Arc::new(Semaphore::new(FLIGHTS_AT_ONCE));
        Arc::new(Server {
            settings,
            address,
            flights,
            sessions,
            worlds: WorldRegistry::default(),
            flown: FlownList::default(),
            showcase: OnceCell::new(),
            guesses: Allowance::new(GUESSES, Duration::from_secs(60)),
            metrics,
            stop,
            tasks,
            budgets,
            turns: Turns::new(),
        })
    }

    /// Keeps the session for its client, for as long as the limits allow.
    pub(crate) fn park(self: &Arc<Self>, session: Session) {
        let (keep, stop) = (self.settings.limits.resume_for, self.stop.clone());
        self.tasks.spawn(self.sessions.clone().park(session, keep, stop));
    }
}

impl Peer {
    /// The client at `address`, whose connection `payer` pays for.
    pub(super) fn new(server: &Arc<Server>, address: SocketAddr, share: Share, payer: Payer) -> Self {
        let (queue, share) = (server.turns.queue(payer.address), Mutex::new(share));
        Peer { address, queue, share, server: server.clone() }
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
        let shown = lock(&self.share).show_token(token_digest(token));
        shown.map_err(|refusal| {
            self.server.budgets.record(&refusal, self.payer());
            refusal.into()
        })
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.server.metrics.connections.dec();
    }
}
