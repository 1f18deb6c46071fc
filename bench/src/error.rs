//! Errors of the benchmark.

use std::path::PathBuf;

/// Names the wrong input, and a right one.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "each variant's message says what went wrong")]
pub enum Error {
    #[error("unknown scenario {name:?}; known: {known}")]
    Scenario { name: String, known: String },
    #[error("no attempt {0:?}")]
    Attempt(String),
    #[error("attempt {id} is {status}: it has no flights to show")]
    Unfinished { id: String, status: &'static str },
    #[error("attempt {id} has episodes 0 to {last}, not {episode}")]
    Episode { id: String, episode: usize, last: usize },
    #[error("an episode has drones 0 to {last}, not {drone}")]
    Drone { drone: usize, last: usize },
    #[error("this token is not valid (any more): ask whoever runs this server for one")]
    Token,
    #[error("the {what} {name:?} is no good: expected {want}")]
    Name { what: &'static str, name: String, want: &'static str },
    #[error(
        "team {team} has begun {limit} attempts within a minute, which is the limit: try again in {retry_after_s} s"
    )]
    TooMany { team: String, limit: u32, retry_after_s: u64 },
    #[error(
        "team {team} has {limit} attempts under way, which is the limit: finish or close one first, or try again in {retry_after_s} s"
    )]
    Busy { team: String, limit: u32, retry_after_s: u64 },
    #[error(
        "team {team} has begun {limit} attempts at {scenario} within a day, which is the limit: try again in {retry_after_s} s"
    )]
    DayOver { team: String, scenario: String, limit: u32, retry_after_s: u64 },
    #[error(
        "team {team} has entered {limit} new names at {scenario} within a day, which is the limit: go on with the newest, or try again in {retry_after_s} s"
    )]
    TooManyEntries { team: String, scenario: String, limit: u32, retry_after_s: u64 },
    #[error(
        "the entry of team {team} at {scenario} is {entry:?}: {controller:?} would take its place on the leaderboard; ask for a new entry (--new-entry, \"new_entry\": true) to do that"
    )]
    OtherEntry { team: String, scenario: String, entry: String, controller: String },
    #[error("the attempt is over: finish it")]
    Over,
    #[error("{left} of {all} episodes are still under way: step on")]
    NotOver { left: usize, all: usize },
    #[error("the attempt took longer than {limit_s} s and counts as abandoned")]
    TooLate { limit_s: u64 },
    #[error("{}: schema {found} is newer than this program's ({known}): use a newer crazyflie", path.display())]
    Newer { path: PathBuf, found: i64, known: i64 },
    #[error("{}: there is no such file; `crazyflie bench submit` makes one", path.display())]
    Missing { path: PathBuf },
    #[error("{} is a database of another program", path.display())]
    Foreign { path: PathBuf },
    #[error("{} has the signing key and can be read by others (mode {mode:03o}): chmod 600 it", path.display())]
    Exposed { path: PathBuf, mode: u32 },
    #[error("{}: {problem}", path.display())]
    File { path: PathBuf, problem: std::io::Error },
    #[error("stored data is damaged: {0}")]
    Damaged(String),
    #[error(
        "{}: the log of the newest transactions is damaged at frame {frame}, and attempts after it would be lost. Keep a copy of the database and of the log; then go on without them by: sqlite3 DATABASE 'PRAGMA wal_checkpoint(TRUNCATE)'", path.display()
    )]
    DamagedLog { path: PathBuf, frame: usize },
    #[error("the benchmark's database cannot be reached: try again in {retry_after_s} s")]
    Away { retry_after_s: u64 },
    #[error("{} was removed or replaced while it was open: what was stored since is not in it; put it back and start again", path.display())]
    Gone { path: PathBuf },
    #[error("database: {0}")]
    Store(#[from] rusqlite::Error),
    #[cfg(feature = "postgres")]
    #[error("database: {}", postgres_words(.0))]
    Postgres(#[from] postgres::Error),
    #[cfg(not(feature = "postgres"))]
    #[error("this program was built without PostgreSQL: build it with the feature `postgres`")]
    NoPostgres,
    #[error(transparent)]
    Env(#[from] crazyflie_env::Error),
    #[error("scenario file {file}: {problem}")]
    ScenarioFile { file: &'static str, problem: String },
    #[error("season {name:?}: {problem}")]
    Season { name: String, problem: String },
    #[error("this is an archive: nothing in it changes")]
    Archive,
    #[error("{0}")]
    Internal(String),
}

/// The error of the server of the database, or of the way there.
#[cfg(feature = "postgres")]
fn postgres_words(error: &postgres::Error) -> String {
    let cause = std::error::Error::source(error).map(|cause| format!(": {cause}")).unwrap_or_default();
    format!("{error}{cause}")
}

/// Returns whether the server of the database cannot be reached, stops, starts, or has no time.
#[cfg(feature = "postgres")]
fn is_postgres_away(problem: &postgres::Error) -> bool {
    // classes of PostgreSQL's appendix A: connection, resources, operator intervention, lock not available
    let classes = ["08", "53", "57", "55P03"];
    problem.code().is_none_or(|code| classes.iter().any(|class| code.code().starts_with(class)))
}

impl Error {
    /// Returns whether the database may answer again soon.
    pub(crate) fn is_away(&self) -> bool {
        match self {
            Error::Away { .. } => true,
            Error::Store(problem) => {
                use rusqlite::ErrorCode::{DatabaseBusy, DatabaseLocked};
                matches!(problem.sqlite_error_code(), Some(DatabaseBusy | DatabaseLocked))
            }
            #[cfg(feature = "postgres")]
            Error::Postgres(problem) => is_postgres_away(problem),
            _ => false,
        }
    }

    /// Returns whether it is the database that failed, or its file.
    pub(crate) fn is_of_database(&self) -> bool {
        #[cfg(feature = "postgres")]
        if matches!(self, Error::Postgres(_)) {
            return true;
        }
        matches!(self, Error::Store(_) | Error::Gone { .. })
    }

    /// The error for clients of a server: the words of a database may reveal what is not theirs.
    pub(crate) fn for_clients(self) -> Error {
        if self.is_away() {
            return Error::Away { retry_after_s: 1 };
        }
        if self.is_of_database() {
            return Error::Internal("the benchmark's database failed; the server's log says more".into());
        }
        self
    }

    /// The HTTP status with the same meaning, and a word for machines that does not change.
    fn answer(&self) -> (u16, &'static str) {
        match self {
            Error::Scenario { .. } => (404, "unknown_scenario"),
            Error::Attempt(_) => (404, "unknown_attempt"),
            Error::Unfinished { .. } => (409, "unfinished_attempt"),
            Error::Episode { .. } => (404, "unknown_episode"),
            Error::Drone { .. } => (404, "unknown_drone"),
            Error::Token => (401, "bad_token"),
            Error::Name { .. } => (400, "bad_name"),
            Error::TooMany { .. } | Error::DayOver { .. } => (429, "too_many_attempts"),
            Error::Busy { .. } => (429, "too_many_at_once"),
            Error::TooManyEntries { .. } => (429, "too_many_entries"),
            Error::OtherEntry { .. } => (409, "other_entry"),
            Error::Away { .. } => (503, "unavailable"),
            Error::Season { .. } => (500, "bad_season"),
            Error::Archive => (500, "archive"),
            Error::Over => (409, "attempt_over"),
            Error::NotOver { .. } => (409, "attempt_under_way"),
            Error::TooLate { .. } => (409, "attempt_too_late"),
            Error::Env(crazyflie_env::Error::Action { .. } | crazyflie_env::Error::DroneAction { .. }) => {
                (400, "bad_action")
            }
            Error::Env(crazyflie_env::Error::Shape { .. }) => (400, "bad_shape"),
            _ => (500, "internal"),
        }
    }

    /// A word for machines; it does not change.
    pub(crate) fn code(&self) -> &'static str {
        self.answer().1
    }

    /// Returns the HTTP status with the same meaning.
    pub(crate) fn status(&self) -> u16 {
        self.answer().0
    }

    /// Returns the time after which to retry, if that is the answer.
    pub(crate) fn retry_after_s(&self) -> Option<u64> {
        match self {
            Error::TooMany { retry_after_s, .. }
            | Error::Busy { retry_after_s, .. }
            | Error::DayOver { retry_after_s, .. }
            | Error::Away { retry_after_s }
            | Error::TooManyEntries { retry_after_s, .. } => Some(*retry_after_s),
            _ => None,
        }
    }
}

/// Results of the benchmark.
pub type Result<T> = std::result::Result<T, Error>;
