//! Every shared world of the server: those that fly, and the newest of those that are over, whose logs can
//! still be had.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use serde::Serialize;
use tokio::sync::mpsc::UnboundedSender;

use super::lock;
use super::pilot::WorldCommand;
use crate::protocol::{Code, ProtocolError};
use crate::worlds::{ActionSource, WorldFlight, WorldLog, WorldSummary};

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
        let (plan, drones, by) = (state.log.plan(), state.flight.drones(), state.by.clone());
        let (mission, seed, end) = (plan.mission.clone(), plan.seed, state.end());
        let (world, session) = (self.name.clone(), self.session.clone());
        WorldRow {
            world,
            session,
            mission,
            seed,
            drones,
            by,
            since_s: self.since.elapsed().as_secs_f64(),
            end,
        }
    }

    /// The log's text, up to now.
    ///
    /// # Errors
    /// The errors of serde, for numbers that JSON cannot represent.
    pub(crate) fn log(&self) -> std::io::Result<Vec<u8>> {
        // the pilots do not wait while it is written
        let (log, end) = {
            let state = lock(&self.state);
            (state.log.clone(), state.end())
        };
        let mut text = Vec::new();
        log.write(&end, &mut text)?;
        Ok(text)
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
        entry.ok_or_else(|| {
            ProtocolError::new(
                Code::UnknownWorld,
                format!("there is no world {name:?}: found it with the message world"),
            )
        })
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
        if all.get(name).is_some_and(|before| !over(before)) {
            return Err(ProtocolError::new(
                Code::WorldTaken,
                format!("there is a world {name:?} already: join it, or take another name"),
            ));
        }
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
