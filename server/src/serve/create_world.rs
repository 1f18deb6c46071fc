//! Creation of a shared world, within the limits.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use crazyflie_env::task;
use tokio::sync::mpsc::unbounded_channel;

use super::budget::{Payer, Resource};
use super::feed::Feed;
use super::server::Server;
use super::settings::Limits;
use super::world::World;
use super::worlds::{WorldEntry, WorldState};
use crate::protocol::{Code, ProtocolError, WorldInfo, WorldRequest};
use crate::worlds::{ActionSource, WorldFlight, WorldLog};

/// Creates a world, and starts the task that owns it.
///
/// # Errors
/// For plans that cannot be flown, `world_taken` and `too_many`.
pub(crate) fn create_world(
    server: &Arc<Server>,
    payer: Payer,
    id: u64,
    request: WorldRequest,
) -> Result<WorldInfo, ProtocolError> {
    let limits = &server.settings.limits;
    request.check()?;
    let options = request.plan.options()?;
    let flight = WorldFlight::new(&request.plan)?;
    let (drones, width, tick_s, steps) =
        (flight.drones(), flight.batch.env.width(), flight.tick_s(), options.max_episode_steps);
    fits(request.pilots, drones, steps, limits)?;
    let small = WorldLog::bytes(drones, steps) <= limits.world_bytes / 8;
    let take = |resource, amount| {
        let taken = server.budgets.take_for(resource, payer, amount, small);
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
        let log = WorldLog::new(&request.name, &request.plan, &flight);
        let state = WorldState { flight, log, by: vec![ActionSource::Autopilot; drones] };
        let entry = WorldEntry {
            name: request.name.clone(),
            session: slot.entry.name(),
            since: Instant::now(),
            commands,
            over: AtomicBool::new(false),
            state: Mutex::new(state),
        };
        Ok((Arc::new(entry), slot))
    })?;
    let info = WorldInfo {
        id,
        world: request.name.clone(),
        session: entry.session.clone(),
        mission: request.plan.mission.clone(),
        drones,
        width,
        tick_s,
        deadline_s: request.deadline_s,
        pilots: request.pilots,
        max_episode_steps: steps,
    };
    let world = World::new(entry, slot, [place, work], inbox, request, limits);
    server.tasks.spawn(world.run(server.stop.clone()));
    Ok(info)
}

/// # Errors
/// `bad_options` for pilots without a drone, and for a log that would take too much.
fn fits(pilots: usize, drones: usize, steps: u32, limits: &Limits) -> Result<(), ProtocolError> {
    ProtocolError::unless((1..=drones).contains(&pilots), Code::BadOptions, || {
        format!("pilots is {pilots}, expected 1 to {drones}, the drones of the world")
    })?;
    let (bytes, max) = (WorldLog::bytes(drones, steps), limits.world_bytes);
    ProtocolError::unless(bytes <= max, Code::BadOptions, || {
        format!("the log of {drones} drones and {steps} steps takes {bytes} bytes, at most {max}")
    })
}
