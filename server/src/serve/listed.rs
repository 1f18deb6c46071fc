//! Every session of the server: what is told about it, where it waits for its client, how it ended.

use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use subtle::ConstantTimeEq;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use tracing::info;

use super::fault::{Code, Fault};
use super::feed::Feed;
use super::metrics::Metrics;
use super::session::Session;

/// How a session ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, prometheus_client::encoding::EncodeLabelValue, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// By its client.
    Closed,
    /// Its client went away and did not come back.
    Expired,
    /// The server stopped.
    Stopped,
    /// By a bug: nobody said how.
    Broken,
}

/// What others may know of a session, and how they reach it.
pub(crate) struct Listed {
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

impl Listed {
    pub(crate) fn name(&self) -> String {
        self.id.to_string()
    }

    /// What can be watched one by one: environments; the drones of a shared world are watched together.
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

/// Room for environments, given back when dropped.
pub(crate) struct Room {
    num_envs: usize,
    sessions: Arc<Sessions>,
}

impl Drop for Room {
    fn drop(&mut self) {
        self.sessions.envs.fetch_sub(self.num_envs, Ordering::Relaxed);
    }
}

/// A place among the sessions, until the session is over.
pub(crate) struct Place {
    pub listed: Arc<Listed>,
    pub end: End,
    room: Room,
}

impl Place {
    pub(crate) fn stepped(&self, steps: usize) {
        self.listed.steps.fetch_add(steps as u64, Ordering::Relaxed);
        self.room.sessions.metrics.env_steps.inc_by((steps * self.listed.num_envs) as u64);
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let Listed { id, steps, since, .. } = &*self.listed;
        lock(&self.room.sessions.listed).remove(id);
        self.room.sessions.metrics.session_ended(self.end);
        info!(session = id, end = ?self.end, steps = steps.load(Ordering::Relaxed), lasted_s = since.elapsed().as_secs_f64(), "session ended");
    }
}

pub(crate) struct Sessions {
    listed: Mutex<BTreeMap<u64, Arc<Listed>>>,
    parked: Mutex<HashMap<u64, Session>>,
    next: AtomicU64,
    envs: AtomicUsize,
    most_envs: usize,
    metrics: Arc<Metrics>,
}

/// What a bug left locked is still whole: every change is one call.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Sessions {
    pub(crate) fn new(most_envs: usize, metrics: Arc<Metrics>) -> Self {
        let (listed, parked) = (Mutex::default(), Mutex::default());
        Sessions { listed, parked, next: AtomicU64::new(1), envs: AtomicUsize::new(0), most_envs, metrics }
    }

    /// Room for `num_envs` more environments: what bounds the memory, so it is asked for before they are made.
    ///
    /// # Errors
    /// `too_many` if all sessions together would have more environments than the server may carry.
    pub(crate) fn room(self: &Arc<Self>, num_envs: usize) -> Result<Room, Fault> {
        let taken = self.envs.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |taken| {
            taken.checked_add(num_envs).filter(|taken| *taken <= self.most_envs)
        });
        match taken {
            Ok(_) => Ok(Room { num_envs, sessions: self.clone() }),
            Err(taken) => {
                let most = self.most_envs;
                Err(Fault::new(Code::TooMany, format!("{num_envs} environments on top of {taken} are more than the server's {most}")))
            }
        }
    }

    /// A place for a session in its room.
    ///
    /// # Errors
    /// `unavailable` without randomness for a token.
    pub(crate) fn enter(self: &Arc<Self>, env: String, room: Room, feed: Feed) -> Result<Place, Fault> {
        let mut secret = [0; 16];
        getrandom::fill(&mut secret).map_err(|e| Fault::new(Code::Unavailable, format!("no randomness for a token: {e}")))?;
        let (id, num_envs) = (self.next.fetch_add(1, Ordering::Relaxed), room.num_envs);
        let (steps, since) = (AtomicU64::new(0), Instant::now());
        let listed = Arc::new(Listed { id, env, num_envs, steps, since, feed, secret, held_by: Mutex::new(None), parked: Notify::new() });
        lock(&self.listed).insert(id, listed.clone());
        self.metrics.session_began();
        info!(session = id, env = listed.env, num_envs, "session began");
        Ok(Place { listed, end: End::Broken, room })
    }

    pub(crate) fn all(&self) -> Vec<Arc<Listed>> {
        lock(&self.listed).values().cloned().collect()
    }

    pub(crate) fn find(&self, name: &str) -> Option<Arc<Listed>> {
        lock(&self.listed).get(&name.parse().ok()?).cloned()
    }

    /// Keeps a session whose connection is lost until its client comes back or the time is over.
    pub(crate) async fn park(self: Arc<Self>, session: Session, keep: Duration, stop: CancellationToken) {
        let listed = session.listed().clone();
        info!(session = listed.id, keep_s = keep.as_secs_f64(), "session waits for its client");
        *lock(&listed.held_by) = None;
        lock(&self.parked).insert(listed.id, session);
        listed.parked.notify_waiters();
        let end = tokio::select! {
            () = tokio::time::sleep(keep) => End::Expired,
            () = stop.cancelled() => End::Stopped,
            () = self.taken(&listed) => return,
        };
        let left = lock(&self.parked).remove(&listed.id);
        if let Some(session) = left {
            session.finish(end);
        }
    }

    /// Until the session is not parked any more.
    async fn taken(&self, listed: &Listed) {
        loop {
            let changed = listed.parked.notified();
            if !lock(&self.parked).contains_key(&listed.id) {
                return;
            }
            changed.await;
        }
    }

    /// The session `name`, from where it waits or from the connection that still has it.
    ///
    /// # Errors
    /// `unknown_session` without such a session, or with another token.
    pub(crate) async fn resume(&self, name: &str, token: &str) -> Result<Session, Fault> {
        let unknown = || Fault::new(Code::UnknownSession, "no session of this name and token waits here");
        let listed = self.find(name).ok_or_else(unknown)?;
        if !bool::from(listed.token().as_bytes().ct_eq(token.as_bytes())) {
            return Err(unknown());
        }
        let patience = tokio::time::sleep(Duration::from_secs(5));
        tokio::pin!(patience);
        loop {
            let changed = listed.parked.notified();
            tokio::pin!(changed);
            changed.as_mut().enable();
            if let Some(session) = lock(&self.parked).remove(&listed.id) {
                listed.parked.notify_waiters();
                return Ok(session);
            }
            // the old connection may not know yet that it is dead
            if let Some(connection) = lock(&listed.held_by).take() {
                connection.cancel();
            }
            tokio::select! { () = &mut changed => {} () = &mut patience => return Err(unknown()) }
        }
    }
}
