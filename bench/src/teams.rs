//! Teams and their tokens, and how often, how many at once and under how many names they may try.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use serde::Serialize;
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

use super::error::{Error, Result};
use super::names::{LOCAL, check_team};
use super::secrets::random;
use super::{Bench, Scenario, now_ms};

const MINUTE_MS: i64 = 60_000;
const DAY_MS: i64 = 24 * 60 * MINUTE_MS;
/// Time for which a token that was valid counts as valid while the database is away.
const TOKEN_HOLDS: Duration = Duration::from_secs(60);
/// Prefix of tokens, so that a leaked one is recognised.
const PREFIX: &str = "cft_";

/// Limits for each team.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TeamLimits {
    pub attempts_per_minute: u32,
    pub at_once: u32,
    /// At one scenario, within 24 hours.
    pub attempts_per_day: u32,
    /// Names at one scenario that are used for the first time within 24 hours.
    pub entries_per_day: u32,
}

impl Default for TeamLimits {
    fn default() -> Self {
        TeamLimits { attempts_per_minute: 30, at_once: 4, attempts_per_day: 100, entries_per_day: 3 }
    }
}

/// The account that begins an attempt.
#[derive(Clone, Copy)]
pub(crate) enum Submitter<'a> {
    /// The command line beside the database: it could write there anyway.
    Local,
    Token(&'a str),
}

/// The name under which an attempt counts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct EntryName<'a> {
    pub controller: &'a str,
    /// It may take the place of the team's entry, if that has another name.
    pub is_new: bool,
}

impl<'a> From<&'a str> for EntryName<'a> {
    /// The name of the team's entry, or of its first.
    fn from(controller: &'a str) -> Self {
        EntryName { controller, is_new: false }
    }
}

/// A token without its secret: the database keeps its hash.
#[derive(Debug, Clone, Serialize)]
pub struct Token {
    pub number: i64,
    pub team: String,
    #[serde(skip)]
    pub(super) hash: Vec<u8>,
    pub created_ms: i64,
    pub revoked_ms: Option<i64>,
}

/// Permission for one running attempt of a team, given back when dropped.
pub(super) struct AttemptPermit {
    bench: Bench,
    team: String,
}

impl Bench {
    /// A new token for a team, shown this once: the database keeps its hash.
    ///
    /// # Errors
    /// [`Error::Name`] for a team's name.
    pub fn create_token(&self, team: &str) -> Result<String> {
        check_team(team)?;
        let token = format!("{PREFIX}{}", hex::encode(random::<32>()?));
        self.store().add_token(team, &Sha256::digest(&token).into(), now_ms())?;
        Ok(token)
    }

    /// Lists all tokens, revoked ones too, without their secrets.
    pub fn tokens(&self) -> Result<Vec<Token>> {
        self.store().tokens()
    }

    /// Ends all tokens of a team; how many there were.
    pub fn revoke_tokens(&self, team: &str) -> Result<usize> {
        self.store().revoke(team, now_ms())
    }

    /// The team of a token.
    ///
    /// # Errors
    /// [`Error::Token`], whatever is wrong with it.
    pub(crate) fn team(&self, who: Submitter<'_>) -> Result<String> {
        let Submitter::Token(token) = who else { return Ok(LOCAL.into()) };
        self.team_of(&Sha256::digest(token).into())?.ok_or(Error::Token)
    }

    /// The team that a token of this hash opens, now. Every stored hash is compared, each in constant time. While the
    /// database is away, its answers of the last minute count.
    pub(super) fn team_of(&self, hash: &[u8; 32]) -> Result<Option<String>> {
        let asked = self.store().tokens();
        let mut teams = self.0.teams.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let tokens = match asked {
            Ok(tokens) => tokens,
            Err(problem) => {
                let known = teams.get(hash).filter(|(_, at)| problem.is_away() && at.elapsed() < TOKEN_HOLDS);
                return known.map(|(team, _)| Some(team.clone())).ok_or(problem);
            }
        };
        teams.remove(hash);
        for token in tokens {
            if bool::from(token.hash.ct_eq(hash)) && token.revoked_ms.is_none() {
                teams.insert(*hash, (token.team, Instant::now()));
            }
        }
        Ok(teams.get(hash).map(|(team, _)| team.clone()))
    }

    /// Lets a team begin an attempt, or returns when it may.
    pub(super) fn admit(
        &self,
        team: &str,
        scenario: &Scenario,
        entry: &EntryName<'_>,
    ) -> Result<AttemptPermit> {
        let limits = self.0.limits;
        let mut running = self.0.running.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if team != LOCAL {
            self.check_daily_budget(team, scenario, entry)?;
            let now = now_ms();
            let begun = self.store().begun_between(team, now - MINUTE_MS, now)?;
            if let Some(retry_after_s) = wait_s(&begun, limits.attempts_per_minute, MINUTE_MS, now) {
                return Err(Error::TooMany {
                    team: team.into(),
                    limit: limits.attempts_per_minute,
                    retry_after_s,
                });
            }
            if running.get(team).is_some_and(|n| *n >= limits.at_once) {
                // the slowest scenario, flown in real time
                let retry_after_s =
                    self.scenarios().iter().map(|s| s.seconds().ceil() as u64).max().unwrap_or(1);
                return Err(Error::Busy { team: team.into(), limit: limits.at_once, retry_after_s });
            }
        }
        *running.entry(team.to_owned()).or_default() += 1;
        Ok(AttemptPermit { bench: self.clone(), team: team.to_owned() })
    }

    /// Attempts and new names of a day. A team that could try without end, or under ever new names, would be ranked
    /// by its luck. Dates in the future are of a clock that was wrong, and do not count.
    fn check_daily_budget(&self, team: &str, scenario: &Scenario, entry: &EntryName<'_>) -> Result<()> {
        let (limits, now) = (self.0.limits, now_ms());
        let all = self.store().team_attempts(team, &scenario.id())?;
        let mut firsts = BTreeMap::new();
        for attempt in &all {
            firsts.entry(&attempt.controller).or_insert(attempt.begun_ms);
        }
        let today = |ms: &i64| (now - DAY_MS + 1..=now).contains(ms);
        let mut attempts: Vec<i64> = all.iter().map(|attempt| attempt.begun_ms).filter(today).collect();
        attempts.sort_unstable();
        if let Some(retry_after_s) = wait_s(&attempts, limits.attempts_per_day, DAY_MS, now) {
            let (team, scenario, limit) = (team.into(), scenario.id(), limits.attempts_per_day);
            return Err(Error::DayOver { team, scenario, limit, retry_after_s });
        }
        let is_new = !firsts.contains_key(&entry.controller.to_owned());
        let newest = all.last().map(|attempt| &attempt.controller);
        if let Some(newest) = newest.filter(|newest| *newest != entry.controller && !entry.is_new) {
            let (team, scenario, controller) = (team.into(), scenario.id(), entry.controller.into());
            return Err(Error::OtherEntry { team, scenario, entry: newest.clone(), controller });
        }
        let mut new_today: Vec<i64> = firsts.into_values().filter(today).collect();
        new_today.sort_unstable();
        match wait_s(&new_today, limits.entries_per_day, DAY_MS, now).filter(|_| is_new) {
            Some(retry_after_s) => {
                let (team, scenario, limit) = (team.into(), scenario.id(), limits.entries_per_day);
                Err(Error::TooManyEntries { team, scenario, limit, retry_after_s })
            }
            None => Ok(()),
        }
    }
}

/// Time until one more is within the limit of a period; none if it is now. `begun` is in order.
fn wait_s(begun_ms: &[i64], limit: u32, period_ms: i64, now_ms: i64) -> Option<u64> {
    let oldest = begun_ms.len().checked_sub(limit as usize).and_then(|first| begun_ms.get(first))?;
    Some((oldest + period_ms - now_ms).max(0).unsigned_abs().div_ceil(1000).max(1))
}

impl Drop for AttemptPermit {
    fn drop(&mut self) {
        let mut running = self.bench.0.running.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(n) = running.get_mut(&self.team) {
            *n -= 1;
            if *n == 0 {
                running.remove(&self.team);
            }
        }
    }
}
