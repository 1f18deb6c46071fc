//! The benchmark: fixed scenarios, attempts that can be verified, a leaderboard. Only [`serve`] knows of a
//! server; the rest has no sockets, and a clock only for dates.

#![forbid(unsafe_code)]

pub mod api;
mod archive;
mod attempt;
pub mod baselines;
pub mod conditions;
mod database_file;
mod episodes;
mod error;
#[cfg(any(test, fuzzing))]
pub mod fuzzed;
mod leaderboard;
mod levels;
mod metrics;
mod mystery;
mod names;
#[cfg(feature = "postgres")]
mod postgres;
mod record;
mod replay;
pub mod robustness;
mod scenario;
mod score;
mod seasons;
mod secrets;
pub mod serve;
mod sql;
mod sqlite;
mod store;
mod teams;
#[cfg(test)]
mod tests;
mod verify;

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

pub(crate) use attempt::Attempt;
pub use baselines::Entrant;
pub use episodes::AttemptSpec;
pub use error::{Error, Result};
pub use leaderboard::{FormerEntry, LeaderboardRow};
pub use levels::{LEVELS, Level};
pub use record::Document;
pub use scenario::{PlannedPhase, Scenario};
pub use seasons::{SeasonDocument, SeasonRow};
pub use sqlite::default_path;
pub(crate) use teams::{EntryName, Submitter, TeamLimits};
pub use verify::{NewestRow, Verdict, Verification};

#[cfg(feature = "postgres")]
use self::postgres::Postgres;
use archive::Archive;
use record::AttemptRow;
use secrets::Secrets;
use sql::{Database, SqlStore};
use sqlite::Sqlite;
pub use store::AttemptPage;
pub(crate) use store::Revision;
use store::{AttemptFilter, Store};

/// Fingerprint of the sources that decide results, see `build.rs`.
pub(crate) const BUILD: &str = env!("CRAZYFLIE_BUILD");

/// A benchmark with its database. Clones are the same benchmark.
#[derive(Clone)]
pub struct Bench(Arc<Inner>);

struct Inner {
    store: Mutex<Box<dyn Store>>,
    secrets: Secrets,
    /// Those of the files first, then their other levels.
    scenarios: Vec<Scenario>,
    limits: TeamLimits,
    /// Attempts under way by team, of this process.
    running: Mutex<HashMap<String, u32>>,
    /// The season that was requested last.
    season: Mutex<Option<Arc<seasons::Season>>>,
    /// Teams by the hash of a token, and when the database last confirmed them.
    teams: Mutex<HashMap<[u8; 32], (String, Instant)>>,
    /// When it was opened, by both clocks.
    opened: (i64, Instant),
}

/// An attempt in the list of attempts.
#[derive(Debug, Clone)]
pub struct AttemptEntry {
    /// Random name of the attempt, in hex.
    pub id: String,
    number: i64,
    pub(crate) signature: Vec<u8>,
    /// The document, or the problem of a row that was tampered with.
    pub document: std::result::Result<Document, String>,
}

impl Bench {
    /// Opens the database, made on first use: a file, a season's archive, or the URL of a PostgreSQL database
    /// (`postgresql://...`), which several servers may share.
    ///
    /// # Errors
    /// [`Error::Newer`], [`Error::Foreign`], [`Error::Exposed`], [`Error::File`] and the errors of SQLite.
    pub fn open(path: &Path) -> Result<Bench> {
        Bench::open_with(path, TeamLimits::default())
    }

    fn open_with(path: &Path, limits: TeamLimits) -> Result<Bench> {
        if Archive::is_season_file(path) {
            return Bench::with_archive(Archive::open(path)?, limits);
        }
        if let Some(url) = database_url(path) {
            return Bench::open_url(url, limits);
        }
        Bench::with_database(Sqlite::open(path)?, limits)
    }

    #[cfg(feature = "postgres")]
    fn open_url(url: &str, limits: TeamLimits) -> Result<Bench> {
        Bench::with_database(Postgres::open(url)?, limits)
    }

    #[cfg(not(feature = "postgres"))]
    fn open_url(_: &str, _: TeamLimits) -> Result<Bench> {
        Err(Error::NoPostgres)
    }

    /// A benchmark that is gone with this program.
    ///
    /// # Errors
    /// The errors of SQLite.
    pub fn in_memory() -> Result<Bench> {
        Bench::with_database(Sqlite::in_memory()?, TeamLimits::default())
    }

    fn with_database(database: impl Database + 'static, limits: TeamLimits) -> Result<Bench> {
        let secrets = sql::secrets(&database)?;
        Bench::with_store(Box::new(SqlStore::new(database)), secrets, limits)
    }

    /// Opens a part of a season's archive: its first line, and the lines of some attempts.
    ///
    /// # Errors
    /// [`Error::Damaged`] with the line.
    pub fn open_part(archive: &str) -> Result<Bench> {
        Bench::with_archive(Archive::read_part(archive.as_bytes())?, TeamLimits::default())
    }

    fn with_archive(archive: Archive, limits: TeamLimits) -> Result<Bench> {
        let (store, keys) = archive.into_store()?;
        Bench::with_store(Box::new(store), keys, limits)
    }

    fn with_store(store: Box<dyn Store>, secrets: Secrets, limits: TeamLimits) -> Result<Bench> {
        let scenarios = scenario::read_all(&secrets)?;
        let (store, running, season) = (Mutex::new(store), Mutex::default(), Mutex::default());
        let (teams, opened) = (Mutex::default(), (now_ms(), Instant::now()));
        let bench =
            Bench(Arc::new(Inner { store, secrets, scenarios, limits, running, season, teams, opened }));
        if !bench.store().is_archive()? {
            bench.sweep()?;
        }
        Ok(bench)
    }

    /// Opens a database that must be there, for those who only look.
    ///
    /// # Errors
    /// [`Error::Missing`], and as [`Bench::open`].
    pub fn open_existing(path: &Path) -> Result<Bench> {
        if !path.exists() && database_url(path).is_none() {
            return Err(Error::Missing { path: path.to_owned() });
        }
        Bench::open(path)
    }

    /// Lists the scenarios in the order of their files, as declared.
    pub fn scenarios(&self) -> &[Scenario] {
        &self.0.scenarios[..scenario::files()]
    }

    /// Lists the scenarios at every level.
    pub fn all_scenarios(&self) -> &[Scenario] {
        &self.0.scenarios
    }

    /// By `name@version`, or by name alone.
    ///
    /// # Errors
    /// [`Error::Scenario`] with the names that there are.
    pub fn scenario(&self, name: &str) -> Result<&Scenario> {
        let scenario =
            self.all_scenarios().iter().find(|s| s.id() == name || s.id().split('@').next() == Some(name));
        scenario.ok_or_else(|| Error::Scenario {
            name: name.into(),
            known: self.scenarios().iter().map(Scenario::id).collect::<Vec<_>>().join(", "),
        })
    }

    /// The key that signatures are checked with, in hex.
    pub fn public_key(&self) -> String {
        hex::encode(self.0.secrets.public_key().as_bytes())
    }

    /// Returns every attempt, of one scenario if given, in the order in which they were begun.
    pub fn attempts(&self, scenario: Option<&str>) -> Result<Vec<AttemptEntry>> {
        self.attempts_of(scenario, AttemptPage::default())
    }

    /// A page of the attempts.
    fn attempts_of(&self, scenario: Option<&str>, page: AttemptPage) -> Result<Vec<AttemptEntry>> {
        let rows = self.store().attempts(AttemptFilter { scenario, id: None, page })?;
        Ok(rows.into_iter().map(|row| self.entry(row)).collect())
    }

    /// One attempt.
    ///
    /// # Errors
    /// [`Error::Attempt`] if there is none of this id.
    pub(crate) fn attempt(&self, id: &str) -> Result<AttemptEntry> {
        self.attempt_row(id).map(|row| self.entry(row))
    }

    /// Another one after each attempt that is begun or ends.
    ///
    /// # Errors
    /// The errors of the database.
    pub(crate) fn revision(&self) -> Result<Revision> {
        self.store().revision()
    }

    fn attempt_row(&self, id: &str) -> Result<AttemptRow> {
        let rows = self.store().attempts(AttemptFilter { id: Some(id), ..AttemptFilter::default() })?;
        rows.into_iter().next().ok_or_else(|| Error::Attempt(id.into()))
    }

    fn entry(&self, row: AttemptRow) -> AttemptEntry {
        let document = row.document(&self.0.secrets).map_err(|e| e.to_string());
        AttemptEntry { id: row.id, number: row.number, signature: row.signature, document }
    }

    fn store(&self) -> MutexGuard<'_, Box<dyn Store>> {
        // SQLite rolls a transaction back that a panic cut short
        self.0.store.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns the URL of a database in place of a file.
fn database_url(path: &Path) -> Option<&str> {
    let schemes = ["postgresql://", "postgres://"];
    path.to_str().filter(|url| schemes.iter().any(|scheme| url.starts_with(scheme)))
}

/// Milliseconds since 1970, UTC.
pub(crate) fn now_ms() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis() as i64)
}
