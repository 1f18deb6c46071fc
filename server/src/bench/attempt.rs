//! One attempt at a scenario, from its beginning to its signed row.

use crazyflie_env::vector::StepBuffers;

use super::baselines::Seat;
use super::episodes::{Episode, Episodes};
use super::error::{Error, Result};
use super::metrics::{self, EpisodeMetrics};
use super::record::{Document, EpisodeResult, Outcome, Status, pack};
use super::scenario::Scenario;
use super::secrets::{random, sha256_hex};
use super::teams::{Place, Who};
use super::{BUILD, Bench, now_ms, score};
use crate::flight::{Phase, phase_at};

/// Who has begun must finish within this. What a crash of the server left behind is abandoned from then on.
const LIMIT_MS: i64 = 30 * 60 * 1000;

/// An attempt under way. Dropped before it is finished, it is listed as abandoned.
pub(crate) struct Attempt {
    bench: Bench,
    scenario: Scenario,
    document: Document,
    /// None once it is finished.
    episodes: Option<Episodes>,
    /// As obeyed: ticks of rows of all episodes.
    actions: Vec<f32>,
    _place: Place,
}

impl Bench {
    /// Begins an attempt; from here on it is listed.
    ///
    /// # Errors
    /// [`Error::Scenario`], [`Error::Token`], [`Error::Name`] for the controller, [`Error::TooMany`], [`Error::Busy`].
    pub(crate) fn begin(&self, scenario: &str, who: Who<'_>, controller: &str) -> Result<Attempt> {
        let scenario = self.scenario(scenario)?.clone();
        if !(1..=64).contains(&controller.chars().count()) || controller.chars().any(char::is_control) {
            return Err(Error::Name { what: "controller", name: controller.into(), want: "1 to 64 characters, none of them a control" });
        }
        self.sweep()?;
        let team = self.team(who)?;
        let place = self.admit(&team)?;
        let id = hex::encode(random::<16>()?);
        let seeds = self.0.secrets.seeds(&id, scenario.hash(), scenario.episodes())?;
        let episodes = Episodes::begin(&scenario, &seeds)?;
        let mut document = Document {
            number: 0,
            id,
            scenario: scenario.id(),
            scenario_hash: scenario.hash().into(),
            build: BUILD.into(),
            team,
            controller: controller.into(),
            begun_ms: now_ms(),
            status: Status::Running,
            result: None,
        };
        document.number = self.store().begin(&|number| Document { number, ..document.clone() }.stored(&self.0.secrets))?;
        Ok(Attempt { bench: self.clone(), scenario, document, episodes: Some(episodes), actions: Vec::new(), _place: place })
    }

    /// Calls those attempts abandoned whose time is over.
    pub(super) fn sweep(&self) -> Result<()> {
        let mut store = self.store();
        for row in store.running_since_before(now_ms() - LIMIT_MS)? {
            // a damaged row is left as it is, for verify to find
            let Ok(document) = row.document(&self.0.secrets) else { continue };
            store.conclude(&Document { status: Status::Abandoned, ..document }.stored(&self.0.secrets)?, None)?;
        }
        Ok(())
    }
}

impl Attempt {
    pub(crate) fn id(&self) -> &str {
        &self.document.id
    }

    pub(crate) fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    fn flying(&self) -> Result<&Episodes> {
        self.episodes.as_ref().ok_or(Error::Over)
    }

    /// Rows of actions and observations: the drones of all episodes.
    ///
    /// # Errors
    /// [`Error::Over`].
    pub(crate) fn rows(&self) -> Result<usize> {
        self.flying().map(Episodes::rows)
    }

    /// Numbers in a row of observations.
    ///
    /// # Errors
    /// [`Error::Over`].
    pub(crate) fn width(&self) -> Result<usize> {
        self.flying().map(Episodes::width)
    }

    /// What actions mean, how often they are asked for, and of how many drones.
    ///
    /// # Errors
    /// [`Error::Over`].
    pub(crate) fn seat(&self) -> Result<Seat> {
        self.flying().map(Episodes::seat)
    }

    /// The part of the flight that the next action is for.
    ///
    /// # Errors
    /// [`Error::Over`].
    pub(crate) fn phase(&self) -> Result<&Phase> {
        self.flying().map(|episodes| phase_at(&self.scenario.phases, episodes.tick() as f64 * episodes.tick_s()))
    }

    /// The latest observations, rows of all episodes; a flight that is over keeps its last.
    ///
    /// # Errors
    /// [`Error::Over`].
    pub(crate) fn observations(&self) -> Result<&[f32]> {
        self.flying().map(Episodes::observations)
    }

    /// One tick of all episodes. Flights that are over stay as they ended, with no reward, and their actions are ignored. True when the last
    /// one is over.
    ///
    /// # Errors
    /// Before anything moves: [`Error::Over`]; [`Error::Env`] for wrong lengths and actions that are not from -1 to 1.
    pub(crate) fn step(&mut self, actions: &[f32], out: StepBuffers<'_>) -> Result<bool> {
        let episodes = self.episodes.as_mut().ok_or(Error::Over)?;
        episodes.check(&out)?;
        let over = episodes.step(actions)?;
        self.actions.extend_from_slice(episodes.obeyed());
        episodes.show(out);
        Ok(over)
    }

    /// Scores, signs and stores. The row is on the disk when this returns.
    ///
    /// # Errors
    /// [`Error::NotOver`] (the attempt is then abandoned), [`Error::TooLate`], and what the database says.
    pub(crate) fn finish(mut self) -> Result<Document> {
        let episodes = self.episodes.take().ok_or(Error::Over)?;
        let ticks = episodes.tick();
        match self.conclude(episodes, ticks) {
            Ok(document) => Ok(document),
            Err(error) => {
                self.abandon();
                Err(error)
            }
        }
    }

    fn conclude(&mut self, episodes: Episodes, ticks: usize) -> Result<Document> {
        let finished_ms = now_ms();
        let too_late = Error::TooLate { limit_s: LIMIT_MS.unsigned_abs() / 1000 };
        if finished_ms - self.document.begun_ms > LIMIT_MS {
            return Err(too_late);
        }
        let packed = pack(&self.actions)?;
        let result = judge(&self.scenario, &episodes.finish()?)?.outcome(finished_ms, ticks, &packed);
        let document = Document { status: Status::Finished, result: Some(result), ..self.document.clone() };
        let row = document.stored(&self.bench.0.secrets)?;
        if self.bench.store().conclude(&row, Some(&packed))? { Ok(document) } else { Err(too_late) }
    }

    /// Says in the database that nothing came of it. Where even that fails, it is said when its time is over.
    fn abandon(&self) {
        let document = Document { status: Status::Abandoned, ..self.document.clone() };
        let _ = document.stored(&self.bench.0.secrets).and_then(|row| self.bench.store().conclude(&row, None));
    }
}

impl Drop for Attempt {
    fn drop(&mut self) {
        if self.episodes.is_some() {
            self.abandon();
        }
    }
}

/// What came of flights, but for dates.
#[derive(PartialEq)]
pub struct AttemptScore {
    pub score: score::Score,
    pub metrics: metrics::Metrics,
    pub episodes: Vec<EpisodeResult>,
}

pub(super) fn judge(scenario: &Scenario, flights: &[Episode]) -> Result<AttemptScore> {
    let of = |flight: &Episode| {
        let metrics = metrics::of_episode(scenario, flight)?;
        Ok(EpisodeResult { score: scenario.plan.cost.score(&metrics)?, states_sha256: flight.state_hash(), metrics })
    };
    let episodes = flights.iter().map(of).collect::<Result<Vec<_>>>()?;
    let scores: Vec<(f64, bool)> = episodes.iter().map(|e| (e.score, e.metrics.failed.is_some())).collect();
    let all: Vec<EpisodeMetrics> = episodes.iter().map(|e| e.metrics.clone()).collect();
    Ok(AttemptScore { score: score::of_attempt(&scores)?, metrics: metrics::of_attempt(&all)?, episodes })
}

impl AttemptScore {
    fn outcome(self, finished_ms: i64, ticks: usize, packed: &[u8]) -> Outcome {
        let AttemptScore { score, metrics, episodes } = self;
        Outcome { finished_ms, ticks, actions_sha256: sha256_hex(packed), score, metrics, episodes }
    }
}
