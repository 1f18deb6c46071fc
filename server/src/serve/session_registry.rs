//! Registry of all sessions: their public data, those that wait for their clients, and how each ended.

use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use subtle::ConstantTimeEq;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use tracing::info;

use super::feed::Feed;
use super::metrics::Metrics;
use super::session::Session;
use crate::protocol::{Code, ProtocolError};

/// Reason that a session ended.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Hash,
    PartialOrd,
    Ord,
    prometheus_client::encoding::EncodeLabelValue,
    serde::Serialize,
)]
#[serde(rename_all = "snake_case")]
pub enum SessionEnd {
    /// By its client.
    Closed,
    /// Its client went away and did not come back.
    Expired,
    /// The server stopped.
    Stopped,
    /// By a bug: no other end was recorded.
    Broken,
}

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

/// A share of the server's environments, given back when dropped.
pub(crate) struct EnvReservation {
    num_envs: usize,
    sessions: Arc<SessionRegistry>,
}

impl Drop for EnvReservation {
    fn drop(&mut self) {
        self.sessions.envs.fetch_sub(self.num_envs, Ordering::Relaxed);
    }
}

/// A session's place in the registry, until the session is over.
pub(crate) struct SessionSlot {
    pub entry: Arc<SessionEntry>,
    pub end: SessionEnd,
    reservation: EnvReservation,
}

impl SessionSlot {
    pub(crate) fn count_steps(&self, steps: usize) {
        self.entry.steps.fetch_add(steps as u64, Ordering::Relaxed);
        self.reservation.sessions.metrics.env_steps.inc_by((steps * self.entry.num_envs) as u64);
    }
}

impl Drop for SessionSlot {
    fn drop(&mut self) {
        let SessionEntry { id, steps, since, .. } = &*self.entry;
        lock(&self.reservation.sessions.entries).remove(id);
        self.reservation.sessions.metrics.record_session_end(self.end);
        info!(session = id, end = ?self.end, steps = steps.load(Ordering::Relaxed), lasted_s = since.elapsed().as_secs_f64(), "session ended");
    }
}

pub(crate) struct SessionRegistry {
    entries: Mutex<BTreeMap<u64, Arc<SessionEntry>>>,
    parked: Mutex<HashMap<u64, Session>>,
    next: AtomicU64,
    envs: AtomicUsize,
    max_envs: usize,
    metrics: Arc<Metrics>,
}

/// Locks a mutex, poisoned or not: every change is one call, so the data are whole after a panic.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl SessionRegistry {
    pub(crate) fn new(max_envs: usize, metrics: Arc<Metrics>) -> Self {
        let (entries, parked) = (Mutex::default(), Mutex::default());
        SessionRegistry {
            entries,
            parked,
            next: AtomicU64::new(1),
            envs: AtomicUsize::new(0),
            max_envs,
            metrics,
        }
    }

    /// Reserves `num_envs` environments. Their number bounds the memory, so this comes before they are made.
    ///
    /// # Errors
    /// `too_many` if all sessions together would have more environments than the server may carry.
    pub(crate) fn reserve_envs(self: &Arc<Self>, num_envs: usize) -> Result<EnvReservation, ProtocolError> {
        let in_use = self.envs.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |in_use| {
            in_use.checked_add(num_envs).filter(|in_use| *in_use <= self.max_envs)
        });
        match in_use {
            Ok(_) => Ok(EnvReservation { num_envs, sessions: self.clone() }),
            Err(in_use) => {
                let max = self.max_envs;
                Err(ProtocolError::new(
                    Code::TooMany,
                    format!("{num_envs} environments on top of {in_use} are more than the server's {max}"),
                ))
            }
        }
    }

    /// Adds a session that has reserved its environments.
    ///
    /// # Errors
    /// `unavailable` without randomness for a token.
    pub(crate) fn enter(
        self: &Arc<Self>,
        env: String,
        reservation: EnvReservation,
        feed: Feed,
    ) -> Result<SessionSlot, ProtocolError> {
        let mut secret = [0; 16];
        getrandom::fill(&mut secret)
            .map_err(|e| ProtocolError::new(Code::Unavailable, format!("no randomness for a token: {e}")))?;
        let (id, num_envs) = (self.next.fetch_add(1, Ordering::Relaxed), reservation.num_envs);
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
        info!(session = id, env = entry.env, num_envs, "session began");
        Ok(SessionSlot { entry, end: SessionEnd::Broken, reservation })
    }

    pub(crate) fn all(&self) -> Vec<Arc<SessionEntry>> {
        lock(&self.entries).values().cloned().collect()
    }

    pub(crate) fn find(&self, name: &str) -> Option<Arc<SessionEntry>> {
        lock(&self.entries).get(&name.parse().ok()?).cloned()
    }

    /// Keeps a session whose connection is lost until its client comes back or the time is over.
    pub(crate) async fn park(self: Arc<Self>, session: Session, keep: Duration, stop: CancellationToken) {
        let entry = session.entry().clone();
        info!(session = entry.id, keep_s = keep.as_secs_f64(), "session waits for its client");
        *lock(&entry.held_by) = None;
        lock(&self.parked).insert(entry.id, session);
        entry.parked.notify_waiters();
        let end = tokio::select! {
            () = tokio::time::sleep(keep) => SessionEnd::Expired,
            () = stop.cancelled() => SessionEnd::Stopped,
            () = self.wait_until_resumed(&entry) => return,
        };
        let left = lock(&self.parked).remove(&entry.id);
        if let Some(session) = left {
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
            if let Some(session) = lock(&self.parked).remove(&entry.id) {
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
