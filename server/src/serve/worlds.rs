//! Every shared world of the server: those that fly, and the newest of those that are over, whose logs can
//! still be had.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use bytes::Bytes;
use futures_util::Stream;
use futures_util::stream::unfold;
use serde::Serialize;
use tokio::sync::mpsc::UnboundedSender;

use super::budget::Share;
use super::lock;
use super::pilot::WorldCommand;
use super::server::Peer;
use crate::protocol::{Code, ProtocolError};
use crate::worlds::{ActionSource, WorldFlight, WorldLog, WorldSummary};

/// Size of the parts in which a log is sent, about.
pub(crate) const LOG_PART_BYTES: usize = 64 << 10;

/// A world as the server lists it.
pub(crate) struct WorldEntry {
    pub name: String,
    /// Session to watch it by.
    pub session: String,
    pub since: Instant,
    /// Commands for the task that flies it.
    pub commands: UnboundedSender<WorldCommand>,
    pub over: AtomicBool,
    /// Locked while a tick is flown.
    pub state: Mutex<WorldState>,
}

/// The flight and its log.
pub(crate) struct WorldState {
    pub flight: WorldFlight,
    pub log: WorldLog,
    /// Source of the actions of each drone now.
    pub by: Vec<ActionSource>,
}

impl WorldState {
    pub(crate) fn end(&self) -> WorldSummary {
        WorldSummary::from_flight(&self.flight, &self.log.late)
    }
}

/// A row of `GET /api/v1/worlds`.
#[derive(Serialize)]
pub(crate) struct WorldRow {
    world: String,
    session: String,
    mission: String,
    seed: u64,
    drones: usize,
    /// Source of the actions of each drone.
    by: Vec<ActionSource>,
    since_s: f64,
    #[serde(flatten)]
    end: WorldSummary,
}

impl WorldEntry {
    pub(crate) fn row(&self) -> WorldRow {
        let state = lock(&self.state);
        WorldRow {
            world: self.name.clone(),
            session: self.session.clone(),
            mission: state.log.head.plan.mission.clone(),
            seed: state.log.head.plan.seed,
            drones: state.flight.drones(),
            by: state.by.clone(),
            since_s: self.since.elapsed().as_secs_f64(),
            end: state.end(),
        }
    }

    /// The log's text, up to now, in parts. Each is written when the client has taken the one before, in a turn of the
    /// client's.
    pub(crate) fn log(
        self: Arc<Self>,
        peer: Arc<Peer>,
        room: Share,
    ) -> impl Stream<Item = serde_json::Result<Bytes>> {
        let end = lock(&self.state).end();
        unfold(Some((0, room)), move |at| {
            let (entry, peer, end) = (self.clone(), peer.clone(), end.clone());
            async move {
                let (from, room) = at?;
                let turn = peer.queue.download_turn().await;
                // the pilots wait only while the numbers are copied
                let part = lock(&entry.state).log.part(from, LOG_PART_BYTES, end.ticks);
                let text = part.text(&end);
                drop(turn);
                tokio::task::yield_now().await;
                let next = part.next.filter(|_| text.is_ok()).map(|next| (next, room));
                Some((text.map(Bytes::from), next))
            }
        })
    }
}

#[derive(Default)]
pub(crate) struct WorldRegistry {
    all: Mutex<BTreeMap<String, Arc<WorldEntry>>>,
}

impl WorldRegistry {
    pub(crate) fn all(&self) -> Vec<Arc<WorldEntry>> {
        lock(&self.all).values().cloned().collect()
    }

    /// # Errors
    /// `unknown_world`.
    pub(crate) fn find(&self, name: &str) -> Result<Arc<WorldEntry>, ProtocolError> {
        let entry = lock(&self.all).get(name).cloned();
        let problem = || format!("there is no world {name:?}: found it with the message world");
        entry.ok_or_else(|| ProtocolError::new(Code::UnknownWorld, problem()))
    }

    /// Adds the world that `make` creates under this name, which must be free. The newest `remembered` worlds that
    /// are over stay.
    pub(crate) fn enter<T>(
        &self,
        name: &str,
        remembered: usize,
        make: impl FnOnce() -> Result<(Arc<WorldEntry>, T), ProtocolError>,
    ) -> Result<(Arc<WorldEntry>, T), ProtocolError> {
        let mut all = lock(&self.all);
        let over = |entry: &WorldEntry| entry.over.load(Ordering::Acquire);
        ProtocolError::unless(all.get(name).is_none_or(|before| over(before)), Code::WorldTaken, || {
            format!("there is a world {name:?} already: join it, or take another name")
        })?;
        let mut ended: Vec<_> =
            all.values().filter(|entry| over(entry)).map(|entry| (entry.since, entry.name.clone())).collect();
        ended.sort_unstable();
        let too_many = (ended.len() + 1).saturating_sub(remembered);
        ended.iter().take(too_many).for_each(|(_, name)| drop(all.remove(name)));
        let created = make()?;
        all.insert(name.to_owned(), created.0.clone());
        Ok(created)
    }
}
