//! Verification of stored attempts: signature, actions, and a replay of the flights, bit by bit.

use serde::Serialize;

use super::attempt::{AttemptScore, score_attempt};
use super::episodes::EpisodeBatch;
use super::error::{Error, Result};
use super::record::{AttemptResult, AttemptRow, Status, numbers, unpack};
use super::secrets::sha256_hex;
use super::store::AttemptFilter;
use super::{BUILD, Bench, Scenario};

/// Outcome of a verification.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Re-run, with the same states, score and metrics to the last bit.
    Confirmed,
    /// Intact, but made by another build of the program, which this one does not reproduce.
    OtherBuild,
    /// Intact; there are no flights to re-run.
    Unfinished,
    /// The row differs from what was signed, or the replay differs from the row.
    Wrong,
}

/// Result of flying an attempt again.
#[derive(Debug, Clone, Serialize)]
pub struct Verification {
    /// Random name of the attempt, in hex.
    pub id: String,
    /// Scenario as `name@version`.
    pub scenario: String,
    /// Name under which it was submitted.
    pub controller: String,
    /// Agreement with the stored result.
    pub verdict: Verdict,
    /// Differences, or the reason that nothing was compared.
    pub findings: Vec<String>,
}

/// The newest attempt that is over, as anybody may note it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NewestRow {
    /// Its number; numbers have no gaps.
    pub number: i64,
    /// SHA-256 of its signed document, in hex. A document of an attempt that is over does not change.
    pub sha256: String,
}

impl std::str::FromStr for NewestRow {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (number, hash) = text.split_once(':').ok_or("expected NUMBER:SHA256")?;
        let number =
            number.parse().map_err(|_| format!("expected a number before the colon, got {number:?}"))?;
        if hash.len() != 64 || !hash.chars().all(|c| c.is_ascii_hexdigit()) {
            return Err("expected 64 hexadecimal digits after the colon".into());
        }
        Ok(NewestRow { number, sha256: hash.to_ascii_lowercase() })
    }
}

impl Bench {
    /// The newest attempt that is over; none before the first.
    pub fn newest(&self) -> Result<Option<NewestRow>> {
        let row = self.store().newest_concluded()?;
        Ok(row.map(|row| NewestRow { number: row.number, sha256: sha256_hex(&row.document) }))
    }

    /// Returns whether a row that somebody has noted is still here unchanged.
    pub fn has_row(&self, noted: &NewestRow) -> Result<bool> {
        let rows = self.store().attempts(AttemptFilter::default())?;
        let row = rows.iter().find(|row| row.number == noted.number);
        Ok(row.is_some_and(|row| sha256_hex(&row.document) == noted.sha256))
    }

    /// # Errors
    /// [`Error::Attempt`] if there is none of this id. That a row is wrong is no error: see [`Verdict`].
    pub fn verify(&self, id: &str) -> Result<Verification> {
        let row = self.attempt_row(id)?;
        self.verify_row(&row)
    }

    /// Verifies every attempt, and returns the numbers of rows that are missing; `progress` gets the number done and
    /// the total.
    pub fn verify_all(&self, progress: &dyn Fn(usize, usize)) -> Result<(Vec<Verification>, Vec<i64>)> {
        let (rows, last) = {
            let store = self.store();
            (store.attempts(AttemptFilter::default())?, store.last_number()?)
        };
        let missing = (1..=last)
            .filter(|number| rows.binary_search_by_key(number, |row| row.number).is_err())
            .collect();
        let verification = |(done, row)| {
            progress(done, rows.len());
            self.verify_row(row)
        };
        Ok((rows.iter().enumerate().map(verification).collect::<Result<_>>()?, missing))
    }

    pub(super) fn verify_row(&self, row: &AttemptRow) -> Result<Verification> {
        let (verdict, findings) = match self.check(row) {
            Ok(found) => found,
            Err(Error::Damaged(problem)) => (Verdict::Wrong, vec![problem]),
            Err(other) => return Err(other),
        };
        Ok(Verification {
            id: row.id.clone(),
            scenario: row.scenario.clone(),
            controller: row.controller.clone(),
            verdict,
            findings,
        })
    }

    fn check(&self, row: &AttemptRow) -> Result<(Verdict, Vec<String>)> {
        let document = row.document(&self.0.secrets)?;
        let actions = self.store().actions(&row.id)?;
        let (Some(result), Some(actions)) = (&document.result, &actions) else {
            let consistent =
                document.result.is_none() && actions.is_none() && document.status != Status::Finished;
            let lost = || {
                Error::Damaged(
                    "the flights of a finished attempt are missing, or there are some of one that is not"
                        .into(),
                )
            };
            return if consistent { Ok((Verdict::Unfinished, Vec::new())) } else { Err(lost()) };
        };
        if sha256_hex(actions) != result.actions_sha256 {
            return Err(Error::Damaged("the actions are not those that were signed".into()));
        }
        let Some((scenario, seeds)) = self.flown(&document)? else {
            return Ok((
                Verdict::OtherBuild,
                vec!["this build does not have the scenario with this hash".into()],
            ));
        };
        let findings = match run_again(&scenario, &seeds, result, actions) {
            Ok(again) => differences(&again, result),
            Err(Error::Over | Error::NotOver { .. }) => {
                vec!["the flights end at other ticks than stored".into()]
            }
            Err(other) => return Err(other),
        };
        match (findings.is_empty(), document.build == BUILD) {
            (true, _) => Ok((Verdict::Confirmed, findings)),
            (false, false) => Ok((
                Verdict::OtherBuild,
                vec![format!("made by build {:.12}, this is {BUILD:.12}", document.build)],
            )),
            (false, true) => Ok((Verdict::Wrong, findings)),
        }
    }
}

fn run_again(
    scenario: &Scenario,
    seeds: &[u64],
    result: &AttemptResult,
    packed: &[u8],
) -> Result<AttemptScore> {
    let mut episodes = EpisodeBatch::begin(scenario, seeds)?;
    let width = episodes.applied_actions().len();
    let actions = numbers(&unpack(packed, result.ticks * width)?);
    for row in actions.chunks_exact(width) {
        episodes.step(row)?;
    }
    score_attempt(scenario, &episodes.finish()?)
}

/// Differences of two results.
fn differences(again: &AttemptScore, stored: &AttemptResult) -> Vec<String> {
    let mut differences = Vec::new();
    if again.episodes.len() != stored.episodes.len() {
        differences.push(format!(
            "{} episodes stored, {} flown",
            stored.episodes.len(),
            again.episodes.len()
        ));
    }
    for (i, (new, old)) in again.episodes.iter().zip(&stored.episodes).enumerate() {
        if new.states_sha256 != old.states_sha256 {
            differences.push(format!("episode {i}: the states differ"));
        } else if new != old {
            differences.push(format!("episode {i}: the figures differ"));
        }
    }
    if again.score != stored.score {
        differences.push(format!("the score is {}, stored is {}", again.score.score, stored.score.score));
    }
    if again.metrics != stored.metrics {
        differences.push("the metrics differ".into());
    }
    differences
}
