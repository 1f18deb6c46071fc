//! Flights by hand: what pilots of shared worlds have flown, the newest first. They are listed and not ranked:
//! pilots choose their own effects and seeds.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;

use super::lock;
use super::worlds::{WorldEntry, WorldState};
use crate::worlds::{ActionSource, DroneEnd};

/// Flights that are kept, longer than their worlds.
const KEPT: usize = 50;

/// A row of `GET /api/v1/flown`.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct FlownRow {
    world: String,
    /// With `drone` the name of the flight: names of worlds may be taken again.
    session: String,
    drone: usize,
    mission: String,
    /// When the world was founded, seconds since 1970.
    at: f64,
    /// Time by the pilot, in the world.
    duration_s: f64,
    /// Root mean square distance from the set-point, while it had a pilot.
    rms_m: f64,
    /// The same of the drones by autopilot, in the same time.
    autopilot: String,
    autopilot_rms_m: Option<f64>,
    /// None where the pilot left.
    end: Option<DroneEnd>,
    /// Share of the ticks that went without the pilot's action.
    late_share: f64,
    /// Effects that were chosen.
    effects: Vec<String>,
}

#[derive(Default)]
pub(crate) struct FlownList(Mutex<VecDeque<FlownRow>>);

impl FlownList {
    /// Takes in what was flown since, and returns all.
    pub(crate) fn update(&self, worlds: &[Arc<WorldEntry>]) -> Vec<FlownRow> {
        let mut rows = lock(&self.0);
        for row in worlds.iter().flat_map(|entry| flown_rows(entry)) {
            match rows.iter_mut().find(|kept| (&kept.session, kept.drone) == (&row.session, row.drone)) {
                // a pilot who returns continues the row
                Some(kept) => *kept = FlownRow { at: kept.at, ..row },
                None => rows.push_front(row),
            }
        }
        rows.make_contiguous().sort_by(|a, b| b.at.total_cmp(&a.at));
        rows.truncate(KEPT);
        rows.iter().cloned().collect()
    }
}

/// Flights of a world whose pilots are done.
fn flown_rows(entry: &WorldEntry) -> Vec<FlownRow> {
    let state = lock(&entry.state);
    let WorldState { flight, log, by } = &*state;
    let all = &log.figures.drones;
    let drones = || all.iter().enumerate();
    let autopilot_m: Vec<f64> =
        drones().filter(|(_, own)| own.piloted_ticks == 0).filter_map(|(_, own)| own.rms_m()).collect();
    let mean_square_m2 =
        autopilot_m.iter().map(|rms_m| rms_m * rms_m).sum::<f64>() / autopilot_m.len() as f64;
    let is_over = |drone: usize| {
        !flight.batch.flying[drone] || !matches!(by[drone], ActionSource::Pilot | ActionSource::Late)
    };
    let now_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
    let plan = &log.head.plan;
    let chosen = plan.options.get("effects").and_then(|effects| effects.as_object());
    let row = |drone: usize, rms_m: f64| FlownRow {
        world: entry.name.clone(),
        session: entry.session.clone(),
        drone,
        mission: plan.mission.clone(),
        at: now_s - entry.since.elapsed().as_secs_f64(),
        duration_s: all[drone].ticks as f64 * flight.tick_s(),
        rms_m,
        autopilot: plan.autopilot.clone(),
        autopilot_rms_m: (!autopilot_m.is_empty()).then(|| mean_square_m2.sqrt()),
        end: all[drone].end,
        late_share: log.late[drone] as f64 / all[drone].ticks.max(1) as f64,
        effects: chosen.into_iter().flat_map(|effects| effects.keys().cloned()).collect(),
    };
    drones()
        .filter(|(drone, own)| own.piloted_ticks > 0 && is_over(*drone))
        .filter_map(|(drone, own)| own.rms_m().map(|rms_m| row(drone, rms_m)))
        .collect()
}
