//! What the benchmark needs of a database.

use super::error::Result;
use super::record::Stored;

/// A token as the database knows it: its hash.
#[derive(Debug, Clone)]
pub(super) struct StoredToken {
    pub number: i64,
    pub team: String,
    pub hash: Vec<u8>,
    pub created_ms: i64,
    pub revoked_ms: Option<i64>,
}

/// Which attempts.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Filter<'a> {
    pub scenario: Option<&'a str>,
    pub id: Option<&'a str>,
}

/// Durable storage: when a method that changes something returns, the change survives a crash.
pub(super) trait Store: Send {
    /// Adds the row that `make` says of the number it is given, and returns the number.
    fn begin(&mut self, make: &dyn Fn(i64) -> Result<Stored>) -> Result<i64>;
    /// Puts another document, and the actions of a finished attempt, in place of those of a running one; false if it runs no more.
    fn conclude(&mut self, row: &Stored, actions: Option<&[u8]>) -> Result<bool>;
    /// In the order in which they were begun.
    fn attempts(&self, filter: Filter<'_>) -> Result<Vec<Stored>>;
    fn running_since_before(&self, ms: i64) -> Result<Vec<Stored>>;
    fn actions(&self, id: &str) -> Result<Option<Vec<u8>>>;
    /// How many attempts there have ever been.
    fn last_number(&self) -> Result<i64>;
    /// When the attempts that a team began since then were begun, in order.
    fn begun_since(&self, team: &str, since_ms: i64) -> Result<Vec<i64>>;

    fn add_token(&mut self, team: &str, hash: &[u8; 32], now_ms: i64) -> Result<()>;
    fn tokens(&self) -> Result<Vec<StoredToken>>;
    /// Ends all tokens of a team; how many there were.
    fn revoke(&mut self, team: &str, now_ms: i64) -> Result<usize>;
}
