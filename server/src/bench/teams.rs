//! Teams and their tokens, and how often and how many at once they may try.

use serde::Serialize;
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

use super::error::{Error, Result};
use super::secrets::random;
use super::{Bench, now_ms};

/// The team of attempts from this machine's own command line.
pub(super) const LOCAL: &str = "local";
const MINUTE_MS: i64 = 60_000;
/// Prefix of tokens, so that a leaked one is recognised.
const PREFIX: &str = "cft_";

/// Limits for each team.
#[derive(Debug, Clone, Copy)]
pub struct TeamLimits {
    pub(crate) attempts_per_minute: u32,
    pub(crate) at_once: u32,
}

impl Default for TeamLimits {
    fn default() -> Self {
        TeamLimits { attempts_per_minute: 30, at_once: 4 }
    }
}

/// The account that begins an attempt.
#[derive(Clone, Copy)]
pub(crate) enum Submitter<'a> {
    /// The command line beside the database: it could write there anyway.
    Local,
    Token(&'a str),
}

/// A token without its secret.
#[derive(Debug, Clone, Serialize)]
pub struct Token {
    pub number: i64,
    pub team: String,
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
        let letters = team.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.'));
        if !letters || !(1..=32).contains(&team.len()) || team == LOCAL {
            let want = "1 to 32 letters, digits, '-', '_' or '.', and not \"local\"";
            return Err(Error::Name { what: "team", name: team.into(), want });
        }
        let token = format!("{PREFIX}{}", hex::encode(random::<32>()?));
        self.store().add_token(team, &Sha256::digest(&token).into(), now_ms())?;
        Ok(token)
    }

    /// Lists all tokens, revoked ones too, without their secrets.
    pub fn tokens(&self) -> Result<Vec<Token>> {
        let all = self.store().tokens()?;
        let token = |t: super::store::StoredToken| Token {
            number: t.number,
            team: t.team,
            created_ms: t.created_ms,
            revoked_ms: t.revoked_ms,
        };
        Ok(all.into_iter().map(token).collect())
    }

    /// Ends all tokens of a team; how many there were.
    pub fn revoke_tokens(&self, team: &str) -> Result<usize> {
        self.store().revoke(team, now_ms())
    }

    /// The team of a token. Every stored hash is compared, each in constant time.
    ///
    /// # Errors
    /// [`Error::Token`], whatever is wrong with it.
    pub(crate) fn team(&self, who: Submitter<'_>) -> Result<String> {
        let Submitter::Token(token) = who else { return Ok(LOCAL.into()) };
        let hash = Sha256::digest(token);
        let mut team = None;
        for stored in self.store().tokens()? {
            if bool::from(stored.hash.ct_eq(&hash)) && stored.revoked_ms.is_none() {
                team = Some(stored.team);
            }
        }
        team.ok_or(Error::Token)
    }

    /// Lets a team begin an attempt, or says when it may.
    pub(super) fn admit(&self, team: &str) -> Result<AttemptPermit> {
        let limits = self.0.limits;
        let mut running = self.0.running.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let now = now_ms();
        if team != LOCAL {
            let begun = self.store().begun_since(team, now - MINUTE_MS)?;
            let limit = limits.attempts_per_minute as usize;
            if let Some(oldest) = begun.len().checked_sub(limit).and_then(|first| begun.get(first)) {
                let retry_after_s = (oldest + MINUTE_MS - now).max(0).unsigned_abs().div_ceil(1000).max(1);
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
