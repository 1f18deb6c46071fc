//! Replay of a stored flight: seed and actions are stored, the rest is simulated again.

use crazyflie_env::action::ACTION;

use super::Bench;
use super::episodes::{DronePath, Episode, EpisodeBatch};
use super::error::{Error, Result};
use super::record::{AttemptResult, EpisodeResult, numbers, unpack};
use super::scenario::Scenario;
use crazyflie_server::flight::{self, Trace};
use crazyflie_server::frames::{self, ALL_COLUMNS, COLUMNS};
use serde_json::Value;

/// One flight of an attempt.
pub(crate) struct Replay {
    scenario: Scenario,
    episode: Episode,
    result: EpisodeResult,
}

/// All that the flights of an attempt are simulated again from.
struct StoredFlights {
    scenario: Scenario,
    seeds: Vec<u64>,
    result: AttemptResult,
    /// Little-endian f32: rows of all episodes, tick by tick.
    actions: Vec<u8>,
}

impl Bench {
    /// # Errors
    /// [`Error::Attempt`], [`Error::Episode`], [`Error::Unfinished`], [`Error::Damaged`] if the result is different
    /// now.
    pub(crate) fn replay(&self, id: &str, episode: usize) -> Result<Replay> {
        let StoredFlights { scenario, seeds, result, actions } = self.stored_flights(id)?;
        let all = result.episodes.len();
        let Some(stored) = result.episodes.get(episode) else {
            return Err(Error::Episode { id: id.into(), episode, last: all.saturating_sub(1) });
        };
        let mut flight = EpisodeBatch::begin(&scenario, &seeds[episode..=episode])?;
        let own = flight.rows() * ACTION;
        for row in numbers(&actions).chunks_exact(all * own) {
            if flight.step(&row[episode * own..(episode + 1) * own])? {
                break;
            }
        }
        let replayed = flight.finish().ok().and_then(|mut all| all.pop());
        let same = replayed.filter(|replayed| replayed.state_hash() == stored.states_sha256);
        let differs = || {
            Error::Damaged(format!(
                "attempt {id}: the flight comes out differently by this build; see verify"
            ))
        };
        let episode = same.ok_or_else(differs)?;
        Ok(Replay { scenario, episode, result: stored.clone() })
    }

    /// The actions of an attempt as little-endian f32: rows of all episodes, tick by tick.
    ///
    /// # Errors
    /// The errors of [`Bench::replay`].
    pub(crate) fn actions(&self, id: &str) -> Result<Vec<u8>> {
        self.stored_flights(id).map(|flights| flights.actions)
    }

    fn stored_flights(&self, id: &str) -> Result<StoredFlights> {
        let row = self.attempt_row(id)?;
        let document = row.document(&self.0.secrets)?;
        let packed = self.store().actions(id)?;
        let (Some(result), Some(packed)) = (&document.result, packed) else {
            return Err(Error::Unfinished { id: id.into(), status: document.status.name() });
        };
        let lost = || {
            Error::Damaged(format!(
                "attempt {id}: this build does not have its scenario {}",
                document.scenario
            ))
        };
        let (scenario, seeds) = self.flown(&document)?.ok_or_else(lost)?;
        let actions = unpack(&packed, result.ticks * result.episodes.len() * scenario.drones() * ACTION)?;
        Ok(StoredFlights { scenario, seeds, result: result.clone(), actions })
    }
}

impl Replay {
    /// For the page: header, with what it is shown as, and rows.
    pub(crate) fn frames(&self, showcase: Option<Value>) -> Result<Vec<u8>> {
        let paths = &self.episode.paths;
        let lead = longest(paths)?;
        let shares_air = self.episode.world_metrics.is_some();
        let columns: &[&str] = if shares_air { &ALL_COLUMNS } else { &COLUMNS };
        let mut header = frames::header(&self.scenario.plan.effects, columns, paths.len(), lead.tick_s);
        header["rows"] = lead.rows.len().into();
        let to_the_end = if self.scenario.lands() { "landed" } else { "time" };
        header["end"] = self.result.metrics.failed.as_deref().unwrap_or(to_the_end).into();
        if let Some(showcase) = showcase {
            header["showcase"] = showcase;
        }
        let mut bytes = frames::header_bytes(&header).map_err(|e| Error::Internal(e.to_string()))?;
        let mut least_m = f32::INFINITY;
        for i in 0..lead.rows.len() {
            // a drone that is down keeps its last row
            let now: Vec<usize> = paths.iter().map(|path| i.min(path.trace.rows.len() - 1)).collect();
            let flying: Vec<bool> = paths.iter().map(|path| i < path.trace.rows.len()).collect();
            let states: Vec<f32> =
                paths.iter().zip(&now).flat_map(|(path, at)| path.trace.rows[*at].state).collect();
            let apart_m: Vec<f32> = frames::separations_m(&states, &flying).collect();
            least_m = apart_m.iter().copied().fold(least_m, f32::min);
            for (drone, (path, at)) in paths.iter().zip(&now).enumerate() {
                let DronePath { trace, rewards, .. } = path;
                let row = &trace.rows[*at];
                let row = frames::row(
                    lead.t_s(i),
                    &row.observation,
                    &row.state,
                    &row.action,
                    &trace.interface,
                    rewards[*at],
                );
                let shared = [f32::from(u8::from(flying[drone])), apart_m[drone], least_m];
                let shared = if shares_air { &shared[..] } else { &[] };
                bytes.extend(row.iter().chain(shared).flat_map(|number| number.to_le_bytes()));
            }
        }
        Ok(bytes)
    }

    /// Returns one drone's log in the format that `crazyflie replay` reads.
    ///
    /// # Errors
    /// [`Error::Drone`].
    pub(crate) fn csv(&self, drone: usize) -> Result<Vec<u8>> {
        let paths = &self.episode.paths;
        let path =
            paths.get(drone).ok_or_else(|| Error::Drone { drone, last: paths.len().saturating_sub(1) })?;
        let mut out = Vec::new();
        flight::log(&path.trace).write_csv(&mut out).map_err(|e| Error::Internal(e.to_string()))?;
        Ok(out)
    }
}

/// The flight of the drone that flew to the end.
fn longest(paths: &[DronePath]) -> Result<&Trace> {
    let traces = paths.iter().map(|path| &path.trace).filter(|trace| !trace.rows.is_empty());
    traces
        .max_by_key(|trace| trace.rows.len())
        .ok_or_else(|| Error::Internal("an episode without rows".into()))
}
