//! The network server: environments over WebSocket, pages and metrics over HTTP, on one port.
//! `docs/protocol.md` is its contract.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

mod allowance;
mod answers;
mod batch_session;
mod budget;
mod connection;
mod create_session;
mod create_world;
mod echo;
mod extension;
mod feed;
mod flown;
#[cfg(any(test, fuzzing))]
pub(crate) mod fuzzed;
mod http;
mod live;
mod metrics;
mod moment;
mod openenv;
mod page;
mod pilot;
mod proxied;
mod replies;
mod server;
mod service;
mod session;
mod session_registry;
mod session_requests;
mod settings;
mod showcase;
mod shown;
mod socket;
mod stream;
mod turns;
mod upgrade;
mod upload;
mod wire;
mod world;
mod worlds;

pub use answers::{PathOf, QueryOf, TaggedBody, as_attachment, error_response, not_allowed};
pub use extension::{Batch, Begun, Extension};
pub use metrics::SessionEnd;
pub use replies::Reply;
pub use showcase::eight_drones;

pub use service::{Report, Service};
pub use settings::{Limits, ServeError, Settings, Shares, tls};
pub use shown::{DroneView, FleetView};

use crate::protocol::{Code, ProtocolError};

/// Counts itself for as long as it lives.
pub(crate) struct CountGuard<'a>(&'a AtomicUsize);

impl<'a> CountGuard<'a> {
    pub(crate) fn new(count: &'a AtomicUsize) -> Self {
        count.fetch_add(1, Ordering::Relaxed);
        CountGuard(count)
    }
}

impl Drop for CountGuard<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A secret that nobody guesses.
///
/// # Errors
/// `unavailable` without randomness.
pub(crate) fn random_secret() -> Result<[u8; 16], ProtocolError> {
    let mut secret = [0; 16];
    let failed = |e| ProtocolError::new(Code::Unavailable, format!("no randomness for a token: {e}"));
    getrandom::fill(&mut secret).map_err(failed)?;
    Ok(secret)
}

/// Locks a mutex, poisoned or not: every change is one call, so the data are whole after a panic.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
