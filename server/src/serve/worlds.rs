//! Every shared world of the server: those that fly, and the newest of those that are over, whose logs can
//! still be had.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use crazyflie_env::task;
use serde::Serialize;
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};

use super::budget::{Payer, Resource};
use super::feed::Feed;
use super::pilot::WorldCommand;
use super::server::Server;
use super::session_registry::lock;
use super::settings::Limits;
use super::world::World;
use crate::protocol::{Code, ProtocolError, WorldInfo, WorldRequest};
use crate::worlds::{ActionSource, WorldFlight, WorldLog, WorldSummary};

/// A world as the server lists it.
pub(crate) struct WorldEntry {
    pub name: String,
    /// Session to watch it by.
    pub session: String,
    since: Instant,
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
    /// Of serde, for numbers that JSON cannot say.
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

    /// Adds the world that `make` creates under this name, which must be free. Of worlds that are over the newest
    /// `remembered` stay.
    fn enter<T>(
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

/// Creates a world, and starts the task that owns it.
///
/// # Errors
/// For plans that cannot be flown, `world_taken` and `too_many`.
pub(crate) fn create_world(
    server: &Arc<Server>,
    payer: Payer,
    id: u64,
    request: &WorldRequest,
) -> Result<WorldInfo, ProtocolError> {
    let limits = &server.settings.limits;
    request.check()?;
    let options = request.plan.options()?;
    let flight = WorldFlight::new(&request.plan)?;
    let (drones, width, tick_s, steps) =
        (flight.drones(), flight.width(), flight.tick_s(), options.max_episode_steps);
    fits(request.pilots, drones, steps, limits)?;
    let take = |resource, amount| {
        let taken = server.budgets.take(resource, payer, amount);
        taken.inspect_err(|refusal| server.budgets.record(refusal, payer))
    };
    let place = take(Resource::Worlds, 1)?;
    let work = take(Resource::WorldWork, WorldFlight::measure_work(&request.plan)?)?;
    let (commands, inbox) = unbounded_channel();
    let (entry, slot) = server.worlds.enter(&request.name, limits.worlds.server, || {
        let feed = Feed::for_world(&options, tick_s, drones, &request.name);
        let slot = server.sessions.enter(
            task::find(&request.plan.mission)?.id.into(),
            server.sessions.reserve_envs(payer, drones)?,
            drones,
            feed,
        )?;
        let (log, by) =
            (WorldLog::new(&request.name, &request.plan, &flight), vec![ActionSource::Autopilot; drones]);
        let (name, session, state) =
            (request.name.clone(), slot.entry.name(), Mutex::new(WorldState { flight, log, by }));
        let entry = WorldEntry {
            name,
            session,
            since: Instant::now(),
            commands,
            over: AtomicBool::new(false),
            state,
        };
        Ok((Arc::new(entry), slot))
    })?;
    let (world, session, mission) =
        (request.name.clone(), entry.session.clone(), request.plan.mission.clone());
    server
        .tasks
        .spawn(World::new(entry, slot, [place, work], inbox, request, limits).run(server.stop.clone()));
    let (deadline_s, pilots) = (request.deadline_s, request.pilots);
    Ok(WorldInfo {
        id,
        world,
        session,
        mission,
        drones,
        width,
        tick_s,
        deadline_s,
        pilots,
        max_episode_steps: steps,
    })
}

/// # Errors
/// `bad_options` for pilots without a drone, and for a log that would take too much.
fn fits(pilots: usize, drones: usize, steps: u32, limits: &Limits) -> Result<(), ProtocolError> {
    let wrong = |message: String| Err(ProtocolError::new(Code::BadOptions, message));
    if !(1..=drones).contains(&pilots) {
        return wrong(format!("pilots is {pilots}, expected 1 to {drones}, the drones of the world"));
    }
    let (bytes, max) = (WorldLog::bytes(drones, steps), limits.world_bytes);
    if bytes > max {
        return wrong(format!(
            "the log of {drones} drones and {steps} steps takes {bytes} bytes, at most {max}"
        ));
    }
    Ok(())
}
