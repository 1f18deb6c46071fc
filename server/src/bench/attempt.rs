//! One attempt at a scenario, from its beginning to its signed row.

use crazyflie_env::vector::StepBuffers;

use super::baselines::AttemptSpec;
use super::episodes::{Episode, EpisodeBatch};
use super::error::{Error, Result};
use super::metrics::{self, EpisodeMetrics};
use super::record::{AttemptResult, Document, EpisodeResult, Status, pack};
use super::scenario::Scenario;
use super::secrets::{random, sha256_hex};
use super::teams::{AttemptPermit, Submitter};
use super::{BUILD, Bench, now_ms, score};
use crate::flight::{Phase, phase_at};

/// Time limit of an attempt. One that a crash of the server left behind is abandoned from then on.
const LIMIT_MS: i64 = 30 * 60 * 1000;

/// An attempt under way. Dropped before it is finished, it is listed as abandoned.
pub(crate) struct Attempt {
    bench: Bench,
    scenario: Scenario,
    document: Document,
    /// None once it is finished.
    episodes: Option<EpisodeBatch>,
    /// As obeyed: ticks of rows of all episodes.
    actions: Vec<f32>,
    _permit: AttemptPermit,
}

impl Bench {
    /// Begins an attempt; from here on it is listed.
    ///
    /// # Errors
    /// [`Error::Scenario`], [`Error::Token`], [`Error::Name`] for the controller, [`Error::TooMany`],
    /// [`Error::Busy`].
    pub(crate) fn begin(
        &self,
        scenario: &str,
        submitter: Submitter<'_>,
        controller: &str,
    ) -> Result<Attempt> {
        let scenario = self.scenario(scenario)?.clone();
        if !(1..=64).contains(&controller.chars().count()) || controller.chars().any(char::is_control) {
            return Err(Error::Name {
                what: "controller",
                name: controller.into(),
                want: "1 to 64 characters, none of them a control",
            });
        }
        self.sweep()?;
        let team = self.team(submitter)?;
        let permit = self.admit(&team)?;
        let id = hex::encode(random::<16>()?);
        let seeds = self.0.secrets.seeds(&id, scenario.hash(), scenario.episodes())?;
        let episodes = EpisodeBatch::begin(&scenario, &seeds)?;
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
        document.number =
            self.store().begin(&|number| Document { number, ..document.clone() }.to_row(&self.0.secrets))?;
        Ok(Attempt {
            bench: self.clone(),
            scenario,
            document,
            episodes: Some(episodes),
            actions: Vec::new(),
            _permit: permit,
        })
    }

    /// Marks running attempts as abandoned whose time is over.
    pub(super) fn sweep(&self) -> Result<()> {
        let mut store = self.store();
        for row in store.running_since_before(now_ms() - LIMIT_MS)? {
            // a damaged row is left as it is, for verify to find
            let Ok(document) = row.document(&self.0.secrets) else { continue };
            store.conclude(
                &Document { status: Status::Abandoned, ..document }.to_row(&self.0.secrets)?,
                None,
            )?;
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

    fn flying(&self) -> Result<&EpisodeBatch> {
        self.episodes.as_ref().ok_or(Error::Over)
    }

    /// Rows of actions and observations: the drones of all episodes.
    ///
    /// # Errors
    /// [`Error::Over`].
    pub(crate) fn rows(&self) -> Result<usize> {
        self.flying().map(EpisodeBatch::rows)
    }

    /// Numbers in a row of observations.
    ///
    /// # Errors
    /// [`Error::Over`].
    pub(crate) fn width(&self) -> Result<usize> {
        self.flying().map(EpisodeBatch::width)
    }

    /// Action ranges, rate, and the numbers of episodes and drones.
    ///
    /// # Errors
    /// [`Error::Over`].
    pub(crate) fn spec(&self) -> Result<AttemptSpec> {
        self.flying().map(EpisodeBatch::spec)
    }

    /// The part of the flight that the next action is for.
    ///
    /// # Errors
    /// [`Error::Over`].
    pub(crate) fn phase(&self) -> Result<&Phase> {
        self.flying()
            .map(|episodes| phase_at(&self.scenario.phases, episodes.tick() as f64 * episodes.tick_s()))
    }

    /// The latest observations, rows of all episodes; a flight that is over keeps its last.
    ///
    /// # Errors
    /// [`Error::Over`].
    pub(crate) fn observations(&self) -> Result<&[f32]> {
        self.flying().map(EpisodeBatch::observations)
    }

    /// One tick of all episodes. Flights that are over stay as they ended, with no reward, and their actions
    /// are ignored. True when the last one is over.
    ///
    /// # Errors
    /// Before anything moves: [`Error::Over`]; [`Error::Env`] for wrong lengths and actions that are not from
    /// -1 to 1.
    pub(crate) fn step(&mut self, actions: &[f32], out: StepBuffers<'_>) -> Result<bool> {
        let episodes = self.episodes.as_mut().ok_or(Error::Over)?;
        episodes.check(&out)?;
        let over = episodes.step(actions)?;
        self.actions.extend_from_slice(episodes.applied_actions());
        episodes.copy_results(out);
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

    fn conclude(&mut self, episodes: EpisodeBatch, ticks: usize) -> Result<Document> {
        let finished_ms = now_ms();
        let too_late = Error::TooLate { limit_s: LIMIT_MS.unsigned_abs() / 1000 };
        if finished_ms - self.document.begun_ms > LIMIT_MS {
            return Err(too_late);
        }
        let packed = pack(&self.actions)?;
        let result = score_attempt(&self.scenario, &episodes.finish()?)?.outcome(finished_ms, ticks, &packed);
        let document = Document { status: Status::Finished, result: Some(result), ..self.document.clone() };
        let row = document.to_row(&self.bench.0.secrets)?;
        if self.bench.store().conclude(&row, Some(&packed))? { Ok(document) } else { Err(too_late) }
    }

    /// Marks the attempt as abandoned in the database. If that fails, `sweep` does it after the time limit.
    fn abandon(&self) {
        let document = Document { status: Status::Abandoned, ..self.document.clone() };
        let _ =
            document.to_row(&self.bench.0.secrets).and_then(|row| self.bench.store().conclude(&row, None));
    }
}

impl Drop for Attempt {
    fn drop(&mut self) {
        if self.episodes.is_some() {
            self.abandon();
        }
    }
}

/// Scores and metrics of the flights of an attempt, without dates.
#[derive(PartialEq)]
pub struct AttemptScore {
    pub score: score::Score,
    pub metrics: metrics::Metrics,
    pub episodes: Vec<EpisodeResult>,
}

pub(super) fn score_attempt(scenario: &Scenario, flights: &[Episode]) -> Result<AttemptScore> {
    let episode_result = |flight: &Episode| {
        let metrics = metrics::episode_metrics(scenario, flight)?;
        Ok(EpisodeResult {
            score: scenario.plan.cost.score(&metrics)?,
            states_sha256: flight.state_hash(),
            metrics,
        })
    };
    let episodes = flights.iter().map(episode_result).collect::<Result<Vec<_>>>()?;
    let scores: Vec<(f64, bool)> = episodes.iter().map(|e| (e.score, e.metrics.failed.is_some())).collect();
    let all: Vec<EpisodeMetrics> = episodes.iter().map(|e| e.metrics.clone()).collect();
    Ok(AttemptScore {
        score: score::attempt_score(&scores)?,
        metrics: metrics::attempt_metrics(&all)?,
        episodes,
    })
}

impl AttemptScore {
    fn outcome(self, finished_ms: i64, ticks: usize, packed: &[u8]) -> AttemptResult {
        let AttemptScore { score, metrics, episodes } = self;
        AttemptResult { finished_ms, ticks, actions_sha256: sha256_hex(packed), score, metrics, episodes }
    }
}
