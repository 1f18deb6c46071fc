//! Drones that somebody else in this program flies, for the page: a session without a client.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::config::Options;
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::vector::STATE;
use tokio::sync::watch;
use tracing::warn;

use super::budget::Payer;
use super::feed::{Feed, MultiDroneRows};
use super::metrics::SessionEnd;
use super::server::Server;

/// One drone at a moment.
#[derive(Debug, Clone, Copy)]
pub struct DroneView {
    /// Since the start.
    pub time_s: f64,
    /// Observation like an environment's: set-point, measured place and last action are drawn.
    pub observation: [f32; OBSERVATION],
    /// The true state.
    pub state: [f32; STATE],
    /// Command in force.
    pub action: [f32; ACTION],
    /// True while its motors turn.
    pub flying: bool,
}

/// Drones that are shown as they fly.
#[derive(Debug, Clone)]
pub struct FleetView {
    /// Name in the list of sessions.
    pub name: String,
    /// Their effects, for markers and camera.
    pub options: Options,
    /// Seconds between moments.
    pub tick_s: f64,
    /// Ranges of their commands.
    pub interface: Interface,
    /// The newest moment, all drones in order; as many of them from the first on.
    pub drones: watch::Receiver<Vec<DroneView>>,
}

/// Shows them until they end or the server does.
pub(super) async fn show(server: Arc<Server>, mut fleet: FleetView) {
    let drones = fleet.drones.borrow().len();
    let feed = Feed::for_multi_drone(&fleet.options, fleet.tick_s, drones);
    let entered = server
        .sessions
        .reserve_envs(Payer::without_token(server.address.ip()), drones)
        .and_then(|share| server.sessions.enter(fleet.name.clone(), share, drones, feed));
    let mut slot = match entered {
        Ok(slot) => slot,
        Err(error) => return warn!(%error, "the drones cannot be shown"),
    };
    let interfaces = vec![fleet.interface; drones];
    let mut least_separation_m = f32::INFINITY;
    slot.end = loop {
        tokio::select! {
            () = server.stop.cancelled() => break SessionEnd::Stopped,
            changed = fleet.drones.changed() => if changed.is_err() { break SessionEnd::Closed },
        }
        slot.entry.steps.fetch_add(1, Ordering::Relaxed);
        if slot.entry.feed.watchers() == 0 {
            continue;
        }
        let now = fleet.drones.borrow_and_update().clone();
        if now.len() != drones {
            continue;
        }
        let observations: Vec<f32> = now.iter().flat_map(|drone| drone.observation).collect();
        let states: Vec<f32> = now.iter().flat_map(|drone| drone.state).collect();
        let actions: Vec<f32> = now.iter().flat_map(|drone| drone.action).collect();
        let flying: Vec<bool> = now.iter().map(|drone| drone.flying).collect();
        let nearest = crate::frames::separations_m(&states, &flying).fold(f32::INFINITY, f32::min);
        least_separation_m = least_separation_m.min(nearest);
        slot.entry.feed.show_all_drones(&MultiDroneRows {
            t_s: now.first().map_or(0.0, |drone| drone.time_s),
            width: OBSERVATION,
            observations: &observations,
            states: &states,
            actions: &actions,
            rewards: None,
            flying: &flying,
            interfaces: &interfaces,
            least_separation_m,
        });
    };
}
