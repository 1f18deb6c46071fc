//! Registry of all sessions: their public data, those that wait for their clients, and how each ended.

use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use subtle::ConstantTimeEq;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use tracing::info;

use super::budget::{Budgets, Payer, Refusal, Resource, Scope, Share};
use super::feed::Feed;
use super::metrics::{Metrics, SessionEnd};
use super::moment;
use super::session::Session;
use super::{lock, random_secret};
use crate::protocol::{Code, ProtocolError};

/// A session as others see it, and the means to reach it.
pub(crate) struct SessionEntry {
    pub id: u64,
    pub env: String,
    pub num_envs: usize,
    /// Steps so far.
    pub steps: AtomicU64,
    pub since: Instant,
    pub feed: Feed,
    secret: [u8; 16],
    /// The connection that has it now, if one has.
    held_by: Mutex<Option<CancellationToken>>,
    parked: Notify,
}

impl SessionEntry {
    pub(crate) fn name(&self) -> String {
        self.id.to_string()
    }

    /// Number of environments that can be watched one by one. The drones of a shared world are watched
    /// together.
    pub(crate) fn batch(&self) -> usize {
        self.num_envs / self.feed.drones
    }

    pub(crate) fn token(&self) -> String {
        hex::encode(self.secret)
    }

    pub(crate) fn hold(&self, connection: &CancellationToken) {
        *lock(&self.held_by) = Some(connection.clone());
    }
}

/// A session's place in the registry, until the session is over.
pub(crate) struct SessionSlot {
    pub entry: Arc<SessionEntry>,
    pub end: SessionEnd,
    /// Its environments.
    share: Share,
    pub sessions: Arc<SessionRegistry>,
}

impl SessionSlot {
    pub(crate) fn count_steps(&self, steps: usize) {
        self.entry.steps.fetch_add(steps as u64, Ordering::Relaxed);
        self.sessions.metrics.env_steps.inc_by((steps * self.entry.num_envs) as u64);
    }

    pub(crate) fn payer(&self) -> Payer {
        self.share.payer()
    }
}

impl Drop for SessionSlot {
    fn drop(&mut self) {
        let SessionEntry { id, steps, since, .. } = &*self.entry;
        lock(&self.sessions.entries).remove(id);
        self.sessions.metrics.record_session_end(self.end);
        if self.sessions.metrics.may_log("session ended", self.payer().address) {
            info!(session = id, end = ?self.end, steps = steps.load(Ordering::Relaxed), lasted_s = since.elapsed().as_secs_f64(), "session ended");
        }
    }
}

/// A session that waits for its client.
struct ParkedSession {
    session: Session,
    since: Instant,
    _share: Share,
}

pub(crate) struct SessionRegistry {
    entries: Mutex<BTreeMap<u64, Arc<SessionEntry>>>,
    parked: Mutex<HashMap<u64, ParkedSession>>,
    next: AtomicU64,
    budgets: Arc<Budgets>,
    metrics: Arc<Metrics>,
    small_envs: usize,
}

impl SessionRegistry {
    pub(crate) fn new(budgets: Arc<Budgets>, metrics: Arc<Metrics>, small_envs: usize) -> Self {
        let (entries, parked) = (Mutex::default(), Mutex::default());
        SessionRegistry { entries, parked, next: AtomicU64::new(1), budgets, metrics, small_envs }
    }

    /// Reserves environments. Their number bounds the memory, so this precedes their construction.
    ///
    /// # Errors
    /// `too_many` if the server, the address or the token would have more environments than it may.
    pub(crate) fn reserve_envs(&self, payer: Payer, num_envs: usize) -> Result<Share, ProtocolError> {
        let small = num_envs <= self.small_envs;
        self.make_room(payer, || self.budgets.take_for(Resource::Environments, payer, num_envs, small))
    }

    /// Tries again after each session that had to give its place up; sessions that wait for their clients do, the
    /// oldest first.
    ///
    /// # Errors
    /// `too_many` when none is left that waits.
    pub(crate) fn make_room<T>(
        &self,
        payer: Payer,
        mut attempt: impl FnMut() -> Result<T, Refusal>,
    ) -> Result<T, ProtocolError> {
        loop {
            match attempt() {
                Ok(taken) => return Ok(taken),
                Err(refusal) if self.evict(refusal.scope, payer) => {}
                Err(refusal) => {
                    self.budgets.record(&refusal, payer);
                    return Err(refusal.into());
                }
            }
        }
    }

    /// Ends the oldest session that waits: of the payer's own where its share is used up, else of the address that
    /// has most of them. False if there is none.
    fn evict(&self, scope: Scope, payer: Payer) -> bool {
        let evicted = {
            let mut parked = lock(&self.parked);
            let mut counts = HashMap::new();
            for waiting in parked.values() {
                *counts.entry(waiting.session.slot.payer().address).or_insert(0_usize) += 1;
            }
            let most = counts.into_iter().max_by_key(|(address, count)| (*count, *address));
            let fits = |whose: Payer| match scope {
                Scope::Token => whose.token == payer.token,
                Scope::Address => whose.address == payer.address,
                Scope::Server => most.is_some_and(|(address, _)| address == whose.address),
            };
            let waiting = parked.iter().filter(|(_, waiting)| fits(waiting.session.slot.payer()));
            let oldest = waiting.min_by_key(|(id, waiting)| (waiting.since, **id)).map(|(id, _)| *id);
            oldest.and_then(|id| parked.remove(&id))
        };
        let Some(ParkedSession { session, .. }) = evicted else { return false };
        let entry = session.slot.entry.clone();
        session.finish(SessionEnd::Evicted);
        entry.parked.notify_waiters();
        true
    }

    /// Adds a session that has reserved its environments.
    ///
    /// # Errors
    /// `unavailable` without randomness for a token.
    pub(crate) fn enter(
        self: &Arc<Self>,
        env: String,
        share: Share,
        num_envs: usize,
        feed: Feed,
    ) -> Result<SessionSlot, ProtocolError> {
        let secret = random_secret()?;
        let id = self.next.fetch_add(1, Ordering::Relaxed);
        let (steps, since) = (AtomicU64::new(0), Instant::now());
        let entry = Arc::new(SessionEntry {
            id,
            env,
            num_envs,
            steps,
            since,
            feed,
            secret,
            held_by: Mutex::new(None),
            parked: Notify::new(),
        });
        lock(&self.entries).insert(id, entry.clone());
        self.metrics.record_session_start();
        if self.metrics.may_log("session began", share.payer().address) {
            info!(session = id, env = entry.env, num_envs, "session began");
        }
        Ok(SessionSlot { entry, end: SessionEnd::Broken, share, sessions: self.clone() })
    }

    pub(crate) fn all(&self) -> Vec<Arc<SessionEntry>> {
        lock(&self.entries).values().cloned().collect()
    }

    pub(crate) fn find(&self, name: &str) -> Option<Arc<SessionEntry>> {
        lock(&self.entries).get(&name.parse().ok()?).cloned()
    }

    /// Keeps a session whose connection is lost until its client returns or the time is over.
    pub(crate) async fn park(self: Arc<Self>, session: Session, keep: Duration, stop: CancellationToken) {
        let entry = session.slot.entry.clone();
        let payer = session.slot.payer();
        *lock(&entry.held_by) = None;
        let place = self.make_room(payer, || self.budgets.take(Resource::ParkedSessions, payer, 1));
        let Ok(share) = place else { return session.finish(SessionEnd::Evicted) };
        if self.metrics.may_log("session waits", payer.address) {
            info!(session = entry.id, keep_s = keep.as_secs_f64(), "session waits for its client");
        }
        let parked = ParkedSession { session, since: Instant::now(), _share: share };
        lock(&self.parked).insert(entry.id, parked);
        entry.parked.notify_waiters();
        let end = tokio::select! {
            () = moment::sleep(keep) => SessionEnd::Expired,
            () = stop.cancelled() => SessionEnd::Stopped,
            () = self.wait_until_resumed(&entry) => return,
        };
        let left = lock(&self.parked).remove(&entry.id);
        if let Some(ParkedSession { session, .. }) = left {
            session.finish(end);
        }
    }

    /// Waits until the session is not parked any more.
    async fn wait_until_resumed(&self, entry: &SessionEntry) {
        loop {
            let changed = entry.parked.notified();
            if !lock(&self.parked).contains_key(&entry.id) {
                return;
            }
            changed.await;
        }
    }

    /// The session `name`, from where it waits or from the connection that still has it.
    ///
    /// # Errors
    /// `unknown_session` without such a session, or with another token.
    pub(crate) async fn resume(&self, name: &str, token: &str) -> Result<Session, ProtocolError> {
        let unknown =
            || ProtocolError::new(Code::UnknownSession, "no session of this name and token waits here");
        let entry = self.find(name).ok_or_else(unknown)?;
        if !bool::from(entry.token().as_bytes().ct_eq(token.as_bytes())) {
            return Err(unknown());
        }
        let patience = tokio::time::sleep(Duration::from_secs(5));
        tokio::pin!(patience);
        loop {
            let changed = entry.parked.notified();
            tokio::pin!(changed);
            changed.as_mut().enable();
            if let Some(ParkedSession { session, .. }) = lock(&self.parked).remove(&entry.id) {
                entry.parked.notify_waiters();
                return Ok(session);
            }
            // the old connection may not know yet that it is dead
            if let Some(connection) = lock(&entry.held_by).take() {
                connection.cancel();
            }
            tokio::select! { () = &mut changed => {} () = &mut patience => return Err(unknown()) }
        }
    }
}
