//! One attempt at a scenario, from its beginning to its signed row.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crazyflie_env::vector::StepBuffers;
use sha2::{Digest, Sha256};

use super::episodes::{AttemptSpec, Episode, EpisodeBatch};
use super::error::{Error, Result};
use super::metrics::{self, EpisodeMetrics};
use super::names::check_controller;
use super::record::{AttemptResult, Document, EpisodeResult, Status, pack};
use super::scenario::Scenario;
use super::seasons::Season;
use super::secrets::{random, sha256_hex};
use super::teams::{AttemptPermit, EntryName, Submitter};
use super::{BUILD, Bench, now_ms, score};
use crazyflie_server::flight::{Phase, phase_at};

/// Time limit of an attempt. One that a crash of the server left behind is abandoned from then on.
const LIMIT: Duration = Duration::from_secs(30 * 60);

/// Time for which a token counts as valid after a look at the database.
const TOKEN_CHECK: Duration = Duration::from_secs(1);

fn too_late() -> Error {
    Error::TooLate { limit_s: LIMIT.as_secs() }
}

/// An attempt under way. Dropped before it is finished, it is listed as abandoned.
pub(crate) struct Attempt {
    bench: Bench,
    scenario: Scenario,
    document: Document,
    /// When it was begun, by a clock that nobody sets.
    begun: Instant,
    /// None once it is finished.
    episodes: Option<EpisodeBatch>,
    /// Applied actions: ticks of rows of all episodes.
    actions: Vec<f32>,
    /// The signed row and its actions, from when it is scored until it is stored.
    finished: Option<(Document, Vec<u8>)>,
    /// Hash of the token that it was begun with.
    token: Option<[u8; 32]>,
    /// When the token was last known to be valid.
    token_seen: Instant,
    _permit: AttemptPermit,
}

impl Bench {
    /// Begins an attempt; from here on it is listed.
    ///
    /// # Errors
    /// [`Error::Scenario`], [`Error::Token`], [`Error::Name`] for the controller, [`Error::OtherEntry`],
    /// [`Error::TooMany`], [`Error::Busy`].
    pub(crate) fn begin<'a>(
        &self,
        scenario: &str,
        submitter: Submitter<'_>,
        entry: impl Into<EntryName<'a>>,
    ) -> Result<Attempt> {
        let entry = entry.into();
        loop {
            // again if a season has begun or was closed meanwhile
            if let Some(attempt) = self.begin_in(self.open_season()?, scenario, submitter, &entry)? {
                return Ok(attempt);
            }
        }
    }

    /// None if by now another season is open.
    fn begin_in(
        &self,
        open: Option<Arc<Season>>,
        scenario: &str,
        submitter: Submitter<'_>,
        entry: &EntryName<'_>,
    ) -> Result<Option<Attempt>> {
        let scenario = self.scenario(scenario)?;
        let open_name = open.as_ref().map(|season| season.document.name.clone());
        // in a season the same scenario hides something else
        let season = open.filter(|season| season.takes(&scenario.id(), now_ms()));
        let in_season = season
            .as_ref()
            .and_then(|season| season.scenarios.iter().find(|other| other.id() == scenario.id()));
        let scenario = in_season.unwrap_or(scenario).clone();
        check_controller(entry.controller)?;
        self.sweep()?;
        let team = self.team(submitter)?;
        let permit = self.admit(&team, &scenario, entry)?;
        let token = match submitter {
            Submitter::Local => None,
            Submitter::Token(token) => Some(Sha256::digest(token).into()),
        };
        let id = hex::encode(random::<16>()?);
        let secrets = season.as_ref().map_or(&self.0.secrets, |season| &season.secrets);
        let seeds = secrets.seeds(&id, scenario.hash(), scenario.episodes())?;
        let episodes = EpisodeBatch::begin(&scenario, &seeds)?;
        let mut document = Document {
            number: 0,
            id,
            scenario: scenario.id(),
            scenario_hash: scenario.hash().into(),
            build: BUILD.into(),
            team,
            controller: entry.controller.into(),
            begun_ms: now_ms(),
            season: season.map(|season| season.document.name.clone()),
            status: Status::Running,
            result: None,
        };
        let make = |number| Document { number, ..document.clone() }.to_row(&self.0.secrets);
        let begun = self.store().begin(open_name.as_deref(), &make)?;
        let Some(number) = begun else { return Ok(None) };
        document.number = number;
        Ok(Some(Attempt {
            bench: self.clone(),
            scenario,
            document,
            begun: Instant::now(),
            episodes: Some(episodes),
            actions: Vec::new(),
            finished: None,
            token,
            token_seen: Instant::now(),
            _permit: permit,
        }))
    }

    /// Marks running attempts as abandoned whose time is over: by both clocks, so that to set one ends none.
    pub(super) fn sweep(&self) -> Result<()> {
        let (opened_ms, opened) = self.0.opened;
        let now_ms = now_ms().min(opened_ms + opened.elapsed().as_millis() as i64);
        let mut store = self.store();
        for row in store.running_since_before(now_ms - LIMIT.as_millis() as i64)? {
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

    /// One tick of all episodes. Flights that are over stay as they ended, and their actions are ignored. Rewards are
    /// 0: a reward without noise would reveal the vehicle's true position. True when the last one is over.
    ///
    /// # Errors
    /// Before anything moves: [`Error::Over`]; [`Error::Token`] once the token was revoked; [`Error::Env`] for wrong
    /// lengths and actions that are not from -1 to 1.
    pub(crate) fn step(&mut self, actions: &[f32], out: StepBuffers<'_>) -> Result<bool> {
        if self.is_closed() {
            return Err(Error::Over);
        }
        if self.token_seen.elapsed() >= TOKEN_CHECK {
            self.check_token()?;
        }
        let episodes = self.episodes.as_mut().ok_or(Error::Over)?;
        episodes.check(&out)?;
        let over = episodes.step(actions)?;
        self.actions.extend_from_slice(episodes.applied_actions());
        episodes.copy_results(out);
        Ok(over)
    }

    /// # Errors
    /// [`Error::Token`] if the token was revoked since; the attempt is then abandoned.
    fn check_token(&mut self) -> Result<()> {
        let Some(hash) = &self.token else { return Ok(()) };
        if self.bench.team_of(hash)?.is_some() {
            self.token_seen = Instant::now();
            return Ok(());
        }
        self.end();
        Err(Error::Token)
    }

    /// Scores, signs and stores. The row is on the disk when this returns. It can be called again if, for example,
    /// the disk is full: the flights are not lost.
    ///
    /// # Errors
    /// [`Error::NotOver`], [`Error::TooLate`] and [`Error::Token`], with which the attempt is abandoned;
    /// [`Error::Over`] from then on; the errors of the database.
    pub(crate) fn finish(&mut self) -> Result<Document> {
        if self.is_closed() {
            return Err(Error::Over);
        }
        self.check_token()?;
        if self.finished.is_none() {
            let episodes = self.episodes.take().ok_or(Error::Over)?;
            match self.score(episodes) {
                Ok(scored) => self.finished = Some(scored),
                Err(error) => {
                    self.abandon();
                    return Err(error);
                }
            }
        }
        let Some((document, packed)) = &self.finished else { return Err(Error::Over) };
        let row = document.to_row(&self.bench.0.secrets)?;
        let is_stored = self.bench.store().conclude(&row, Some(packed))?;
        let document = self.finished.take().map(|(document, _)| document).ok_or(Error::Over)?;
        if is_stored { Ok(document) } else { Err(too_late()) }
    }

    fn score(&self, episodes: EpisodeBatch) -> Result<(Document, Vec<u8>)> {
        let (finished_ms, ticks) = (now_ms(), episodes.tick());
        if self.begun.elapsed() > LIMIT {
            return Err(too_late());
        }
        let packed = pack(&self.actions)?;
        let result = score_attempt(&self.scenario, &episodes.finish()?)?.outcome(finished_ms, ticks, &packed);
        let document = Document { status: Status::Finished, result: Some(result), ..self.document.clone() };
        Ok((document, packed))
    }

    /// Returns whether it was stored or abandoned.
    pub(crate) fn is_closed(&self) -> bool {
        self.episodes.is_none() && self.finished.is_none()
    }

    /// Ends it unfinished.
    fn end(&mut self) {
        if self.episodes.take().is_some() || self.finished.take().is_some() {
            self.abandon();
        }
    }

    fn abandon(&self) {
        let document = Document { status: Status::Abandoned, ..self.document.clone() };
        let _ =
            document.to_row(&self.bench.0.secrets).and_then(|row| self.bench.store().conclude(&row, None));
    }
}

impl Drop for Attempt {
    fn drop(&mut self) {
        self.end();
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
