//! A stored flight once more: what was kept are seed and actions, the rest is simulated again.

use crazyflie_env::observation::ACTION;

use super::Bench;
use super::episodes::{Episode, Episodes};
use super::error::{Error, Result};
use super::record::{EpisodeResult, Outcome, numbers, unpack};
use super::scenario::Scenario;
use crate::flight;
use crate::frames::{self, COLUMNS, Camera, Header};

/// One flight of an attempt.
pub(crate) struct Replay {
    scenario: Scenario,
    episode: Episode,
    result: EpisodeResult,
}

impl Bench {
    /// # Errors
    /// [`Error::Attempt`], [`Error::Episode`], [`Error::Unfinished`], [`Error::Damaged`] if it comes out differently now.
    pub(crate) fn replay(&self, id: &str, episode: usize) -> Result<Replay> {
        let (scenario, result, actions) = self.flown(id)?;
        let all = result.episodes.len();
        let Some(stored) = result.episodes.get(episode) else {
            return Err(Error::Episode { id: id.into(), episode, last: all.saturating_sub(1) });
        };
        let seeds = self.0.secrets.seeds(id, scenario.hash(), all)?;
        let mut flight = Episodes::begin(&scenario, &seeds[episode..=episode])?;
        for row in numbers(&actions).chunks_exact(all * ACTION) {
            if flight.step(&row[episode * ACTION..(episode + 1) * ACTION])? {
                break;
            }
        }
        let flown = flight.finish().ok().and_then(|mut all| all.pop());
        let same = flown.filter(|flown| flown.state_hash() == stored.states_sha256);
        let differs = || Error::Damaged(format!("attempt {id}: the flight comes out differently by this build; see verify"));
        let episode = same.ok_or_else(differs)?;
        Ok(Replay { scenario, episode, result: stored.clone() })
    }

    /// The actions of an attempt as little-endian f32: rows of all episodes, tick by tick.
    ///
    /// # Errors
    /// As [`Bench::replay`].
    pub(crate) fn actions(&self, id: &str) -> Result<Vec<u8>> {
        self.flown(id).map(|(_, _, actions)| actions)
    }

    fn flown(&self, id: &str) -> Result<(Scenario, Outcome, Vec<u8>)> {
        let row = self.stored(id)?;
        let document = row.document(&self.0.secrets)?;
        let packed = self.store().actions(id)?;
        let (Some(result), Some(packed)) = (document.result, packed) else {
            return Err(Error::Unfinished { id: id.into(), status: document.status.name() });
        };
        let same = |s: &&Scenario| s.id() == document.scenario && s.hash() == document.scenario_hash;
        let lost = || Error::Damaged(format!("attempt {id}: this build does not have its scenario {}", document.scenario));
        let scenario = self.scenarios().iter().find(same).ok_or_else(lost)?.clone();
        let actions = unpack(&packed, result.ticks * result.episodes.len() * ACTION)?;
        Ok((scenario, result, actions))
    }
}

impl Replay {
    /// For the page: header and rows.
    pub(crate) fn frames(&self) -> Result<Vec<u8>> {
        let trace = &self.episode.trace;
        let header = Header {
            columns: &COLUMNS,
            drones: 1,
            rows: trace.rows.len(),
            tick_s: trace.tick_s,
            marker: markers(&self.scenario),
            camera: Camera {
                fov_deg: self.scenario.declared("camera_fov", "diagonal_deg").unwrap_or(0.0),
                offset_m: self.scenario.declared("camera_fov", "lens_below_m").unwrap_or(0.0),
            },
            end: self.result.metrics.failed.clone().unwrap_or_else(|| if self.scenario.lands() { "landed" } else { "time" }.into()),
        };
        let mut bytes = header.bytes().map_err(|e| Error::Internal(e.to_string()))?;
        for (i, (row, reward)) in trace.rows.iter().zip(&self.episode.rewards).enumerate() {
            let row = frames::row(trace.t_s(i), &row.observation, &row.state, &row.action, &trace.interface, *reward);
            bytes.extend(row.iter().flat_map(|number| number.to_le_bytes()));
        }
        Ok(bytes)
    }

    /// As a log that `crazyflie replay` reads.
    pub(crate) fn csv(&self) -> Result<Vec<u8>> {
        let mut out = Vec::new();
        flight::log(&self.episode.trace).write_csv(&mut out).map_err(|e| Error::Internal(e.to_string()))?;
        Ok(out)
    }
}

/// As the effect `markers` lays them out: a grid about the origin.
fn markers(scenario: &Scenario) -> Vec<[f64; 3]> {
    let of = |param: &str, off: f64| scenario.declared("markers", param).unwrap_or(off);
    let (columns, rows, pitch_m) = (of("columns", 1.0) as usize, of("rows", 1.0) as usize, of("pitch_m", 0.5));
    let at = |i: usize, n: usize| (i as f64 - 0.5 * (n as f64 - 1.0)) * pitch_m;
    (0..columns).flat_map(|i| (0..rows).map(move |j| [at(i, columns), at(j, rows), 0.0])).collect()
}
