//! Every shared world of the server: those that fly, and the newest of those that are over, whose logs can still be had.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use crazyflie_env::task;
use serde::Serialize;
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};

use super::fault::{Code, Fault};
use super::feed::Feed;
use super::listed::lock;
use super::pilot::Order;
use super::server::Server;
use super::settings::Limits;
use super::shared::{Founded, Founding};
use super::world::World;
use crate::worlds::{By, End, Flight, Log};

/// A world as everybody may know it.
pub(crate) struct Known {
    pub name: String,
    /// To watch it by.
    pub session: String,
    since: Instant,
    /// What is asked of the task that flies it.
    pub orders: UnboundedSender<Order>,
    pub over: AtomicBool,
    /// Held while a tick is flown.
    pub flown: Mutex<Flown>,
}

/// The flight and what led to it.
pub(crate) struct Flown {
    pub flight: Flight,
    pub log: Log,
    /// Who flies each drone now.
    pub by: Vec<By>,
}

impl Flown {
    pub(crate) fn end(&self) -> End {
        End::of(&self.flight, &self.log.late)
    }
}

/// A world as `GET /api/v1/worlds` tells of it.
#[derive(Serialize)]
pub(crate) struct Row {
    world: String,
    session: String,
    mission: String,
    seed: u64,
    drones: usize,
    /// Who flies each drone.
    by: Vec<By>,
    since_s: f64,
    #[serde(flatten)]
    end: End,
}

impl Known {
    pub(crate) fn row(&self) -> Row {
        let flown = lock(&self.flown);
        let (plan, drones, by) = (flown.log.plan(), flown.flight.drones(), flown.by.clone());
        let (mission, seed, end) = (plan.mission.clone(), plan.seed, flown.end());
        let (world, session) = (self.name.clone(), self.session.clone());
        Row { world, session, mission, seed, drones, by, since_s: self.since.elapsed().as_secs_f64(), end }
    }

    /// The log's text, up to now.
    ///
    /// # Errors
    /// Of serde, for numbers that JSON cannot say.
    pub(crate) fn log(&self) -> std::io::Result<Vec<u8>> {
        // the pilots do not wait while it is written
        let (log, end) = {
            let flown = lock(&self.flown);
            (flown.log.clone(), flown.end())
        };
        let mut text = Vec::new();
        log.write(&end, &mut text)?;
        Ok(text)
    }
}

#[derive(Default)]
pub(crate) struct Worlds {
    all: Mutex<BTreeMap<String, Arc<Known>>>,
}

impl Worlds {
    pub(crate) fn all(&self) -> Vec<Arc<Known>> {
        lock(&self.all).values().cloned().collect()
    }

    /// # Errors
    /// `unknown_world`.
    pub(crate) fn find(&self, name: &str) -> Result<Arc<Known>, Fault> {
        let found = lock(&self.all).get(name).cloned();
        found.ok_or_else(|| Fault::new(Code::UnknownWorld, format!("there is no world {name:?}: found it with the message world")))
    }

    /// What `make` makes, under this name, which must be free; of those that are over the oldest make room.
    fn enter<T>(&self, name: &str, most: usize, make: impl FnOnce() -> Result<(Arc<Known>, T), Fault>) -> Result<(Arc<Known>, T), Fault> {
        let mut all = lock(&self.all);
        let over = |known: &Known| known.over.load(Ordering::Acquire);
        if all.get(name).is_some_and(|before| !over(before)) {
            return Err(Fault::new(Code::WorldTaken, format!("there is a world {name:?} already: join it, or take another name")));
        }
        let flying = all.values().filter(|known| !over(known)).count();
        if flying >= most {
            return Err(Fault::new(Code::TooMany, format!("{flying} worlds are flown here, the server carries {most}")));
        }
        let mut ended: Vec<_> = all.values().filter(|known| over(known)).map(|known| (known.since, known.name.clone())).collect();
        ended.sort_unstable();
        let too_many = (ended.len() + 1).saturating_sub(most);
        ended.iter().take(too_many).for_each(|(_, name)| drop(all.remove(name)));
        let made = make()?;
        all.insert(name.to_owned(), made.0.clone());
        Ok(made)
    }
}

/// Founds a world, and begins the task that owns it.
///
/// # Errors
/// For what cannot be flown, `world_taken` and `too_many`.
pub(crate) fn found(server: &Arc<Server>, id: u64, asked: &Founding) -> Result<Founded, Fault> {
    let limits = &server.settings.limits;
    asked.check()?;
    let options = asked.plan.options()?;
    let flight = Flight::new(&asked.plan)?;
    let (drones, width, tick_s, steps) = (flight.drones(), flight.width(), flight.tick_s(), options.max_episode_steps);
    fits(asked.pilots, drones, steps, limits)?;
    let (orders, inbox) = unbounded_channel();
    let (known, place) = server.worlds.enter(&asked.name, limits.worlds, || {
        let feed = Feed::shared(&options, tick_s, drones, &asked.name);
        let place = server.sessions.enter(task::find(&asked.plan.mission)?.id.into(), server.sessions.room(drones)?, feed)?;
        let (log, by) = (Log::new(&asked.name, &asked.plan, &flight), vec![By::Autopilot; drones]);
        let (name, session, flown) = (asked.name.clone(), place.listed.name(), Mutex::new(Flown { flight, log, by }));
        let known = Known { name, session, since: Instant::now(), orders, over: AtomicBool::new(false), flown };
        Ok((Arc::new(known), place))
    })?;
    let (world, session, mission) = (asked.name.clone(), known.session.clone(), asked.plan.mission.clone());
    server.tasks.spawn(World::new(known, place, inbox, asked, limits.world_waits).run(server.stop.clone()));
    let (deadline_s, pilots) = (asked.deadline_s, asked.pilots);
    Ok(Founded { id, world, session, mission, drones, width, tick_s, deadline_s, pilots, max_episode_steps: steps })
}

/// # Errors
/// `bad_options` for pilots without a drone, and for a log that would take too much.
fn fits(pilots: usize, drones: usize, steps: u32, limits: &Limits) -> Result<(), Fault> {
    let wrong = |message: String| Err(Fault::new(Code::BadOptions, message));
    if !(1..=drones).contains(&pilots) {
        return wrong(format!("pilots is {pilots}, expected 1 to {drones}, the drones of the world"));
    }
    let (bytes, most) = (Log::bytes(drones, steps), limits.world_bytes);
    if bytes > most {
        return wrong(format!("the log of {drones} drones and {steps} steps takes {bytes} bytes, at most {most}"));
    }
    Ok(())
}
