//! Interface of the benchmark to its database.

use super::error::Result;
use super::record::AttemptRow;
use super::seasons::StoredSeason;
use super::teams::Token;

/// Selection of attempts.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct AttemptFilter<'a> {
    pub scenario: Option<&'a str>,
    pub id: Option<&'a str>,
    pub page: AttemptPage,
}

/// A page of the attempts.
#[derive(Debug, Clone, Copy)]
pub struct AttemptPage {
    /// Number of the attempt after which it begins.
    pub after: i64,
    /// The most attempts.
    pub limit: i64,
}

impl Default for AttemptPage {
    /// All attempts.
    fn default() -> Self {
        AttemptPage { after: 0, limit: i64::MAX }
    }
}

/// An attempt of a team, in short.
#[derive(Debug, Clone)]
pub(super) struct TeamAttempt {
    pub controller: String,
    pub begun_ms: i64,
}

/// Progress of the attempts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Revision {
    /// Attempts, those under way too.
    pub all: i64,
    /// Attempts that are over.
    pub over: i64,
}

/// Durable storage: when a method that changes something returns, the change survives a crash.
pub(super) trait Store: Send {
    /// Returns whether nothing in it can change.
    fn is_archive(&self) -> Result<bool>;
    /// Adds the row that `make` returns for its number, and returns the number; none if by now another season than
    /// `season` is the one that is open.
    fn begin(
        &mut self,
        season: Option<&str>,
        make: &(dyn Fn(i64) -> Result<AttemptRow> + Sync),
    ) -> Result<Option<i64>>;
    /// Puts another document, and the actions of a finished attempt, in place of those of a running one;
    /// false if it runs no more. The same row may be stored twice.
    fn conclude(&mut self, row: &AttemptRow, actions: Option<&[u8]>) -> Result<bool>;
    /// In the order in which they were begun.
    fn attempts(&self, filter: AttemptFilter<'_>) -> Result<Vec<AttemptRow>>;
    fn running_since_before(&self, ms: i64) -> Result<Vec<AttemptRow>>;
    fn actions(&self, id: &str) -> Result<Option<Vec<u8>>>;
    /// The newest attempt that runs no more.
    fn newest_concluded(&self) -> Result<Option<AttemptRow>>;
    fn revision(&self) -> Result<Revision>;
    /// Number of the newest attempt; the first is 1.
    fn last_number(&self) -> Result<i64>;
    /// When the attempts that a team began between two times were begun, in order.
    fn begun_between(&self, team: &str, from_ms: i64, to_ms: i64) -> Result<Vec<i64>>;
    /// Every attempt of a team at a scenario, in the order in which they were begun.
    fn team_attempts(&self, team: &str, scenario: &str) -> Result<Vec<TeamAttempt>>;

    fn add_token(&mut self, team: &str, hash: &[u8; 32], now_ms: i64) -> Result<()>;
    fn tokens(&self) -> Result<Vec<Token>>;
    /// Ends all tokens of a team; how many there were.
    fn revoke(&mut self, team: &str, now_ms: i64) -> Result<usize>;

    fn add_season(&mut self, name: &str, season: &StoredSeason) -> Result<()>;
    /// From then on no attempt begins as a part of it.
    fn close_season(&mut self, name: &str, now_ms: i64) -> Result<()>;
    /// In the order in which they were begun.
    fn seasons(&self) -> Result<Vec<StoredSeason>>;
}
