//! The store on SQLite: one file with everything, the signing key and the secret too. One file is backed up,
//! moved and protected (mode 0600) as a whole; a key in a file beside it could be lost or mixed up with
//! another.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rusqlite::{Connection, OpenFlags, OptionalExtension, Row, TransactionBehavior, params};

use super::error::{Error, Result};
use super::record::AttemptRow;
use super::seasons::StoredSeason;
use super::secrets::{Bytes, Secrets, random};
use super::store::{AttemptFilter, Revision, Store, StoredToken, TeamAttempt};

/// "crzf" as a number: whose database this is.
const APPLICATION_ID: i64 = 0x6372_7a66;

/// Each brings the schema one version on.
const MIGRATIONS: &[&str] = &[
    "
    CREATE TABLE secrets (name TEXT PRIMARY KEY, value BLOB NOT NULL) STRICT;
    CREATE TABLE attempts (
        number INTEGER PRIMARY KEY AUTOINCREMENT,
        id TEXT NOT NULL UNIQUE,
        scenario TEXT NOT NULL,
        team TEXT NOT NULL,
        controller TEXT NOT NULL,
        begun_ms INTEGER NOT NULL,
        status TEXT NOT NULL,
        document TEXT NOT NULL,
        signature BLOB NOT NULL,
        actions BLOB
    ) STRICT;
    CREATE INDEX attempts_by_scenario ON attempts (scenario);
    CREATE INDEX attempts_by_team ON attempts (team, begun_ms);
    CREATE INDEX attempts_running ON attempts (begun_ms) WHERE status = 'running';
    CREATE TABLE tokens (
        number INTEGER PRIMARY KEY AUTOINCREMENT,
        team TEXT NOT NULL,
        hash BLOB NOT NULL UNIQUE,
        created_ms INTEGER NOT NULL,
        revoked_ms INTEGER
    ) STRICT;",
    "
    CREATE TABLE seasons (
        number INTEGER PRIMARY KEY AUTOINCREMENT,
        name TEXT NOT NULL UNIQUE,
        document TEXT NOT NULL,
        signature BLOB NOT NULL,
        secret BLOB NOT NULL,
        closed_ms INTEGER
    ) STRICT;",
];

/// Time to wait for another process that writes.
const BUSY: Duration = Duration::from_secs(10);

/// Between two tries where SQLite itself does not wait.
const RETRY: Duration = Duration::from_millis(20);

/// Turns write-ahead logging on. Processes that open a new file at once all ask for it, and SQLite tells some
/// that it is busy without having waited.
fn log_ahead(db: &Connection) -> rusqlite::Result<()> {
    let began = Instant::now();
    loop {
        match db.pragma_update(None, "journal_mode", "WAL") {
            Err(e)
                if e.sqlite_error_code() == Some(rusqlite::ErrorCode::DatabaseBusy)
                    && began.elapsed() < BUSY =>
            {
                std::thread::sleep(RETRY);
            }
            answer => return answer,
        }
    }
}

pub(super) struct Sqlite {
    db: Connection,
}

impl Sqlite {
    /// Opens the file, made and migrated as needed; one without permission to write as an archive, which does not
    /// change.
    pub(super) fn open(path: &Path) -> Result<Sqlite> {
        let is_archive = is_archive(path);
        protect(path, is_archive)?;
        if is_archive {
            return Sqlite::open_archive(path);
        }
        let mut db = Connection::open(path)?;
        db.busy_timeout(BUSY)?;
        let foreign = || Error::Foreign { path: path.to_owned() };
        let not_ours = |e: rusqlite::Error| {
            if e.sqlite_error_code() == Some(rusqlite::ErrorCode::NotADatabase) {
                foreign()
            } else {
                e.into()
            }
        };
        // every commit reaches the disk before it is acknowledged
        log_ahead(&db).map_err(not_ours)?;
        db.pragma_update(None, "synchronous", "FULL")?;
        migrate(&mut db, path)?;
        Ok(Sqlite { db })
    }

    /// A database of this program alone, gone with it.
    pub(super) fn in_memory() -> Result<Sqlite> {
        let mut db = Connection::open_in_memory()?;
        migrate(&mut db, Path::new("memory"))?;
        Ok(Sqlite { db })
    }

    fn open_archive(path: &Path) -> Result<Sqlite> {
        // "immutable": no lock and no log beside it, which would have to be written
        let uri = format!(
            "file:{}?immutable=1",
            path.display().to_string().replace('%', "%25").replace('?', "%3f").replace('#', "%23")
        );
        let flags =
            OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let db = Connection::open_with_flags(uri, flags)?;
        let pragma = |name: &str| db.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
        let known = MIGRATIONS.len() as i64;
        match (pragma("application_id")?, pragma("user_version")?) {
            (APPLICATION_ID, found) if found > known => {
                Err(Error::Newer { path: path.to_owned(), found, known })
            }
            (APPLICATION_ID, _) => Ok(Sqlite { db }),
            _ => Err(Error::Foreign { path: path.to_owned() }),
        }
    }

    /// The signing key and the secret, made on first use.
    pub(super) fn secrets(&mut self) -> Result<Secrets> {
        let behavior = if self.db.is_readonly(rusqlite::MAIN_DB)? {
            TransactionBehavior::Deferred
        } else {
            TransactionBehavior::Immediate
        };
        let tx = self.db.transaction_with_behavior(behavior)?;
        let read = |name: &str| -> Result<Bytes> {
            let found: Option<Vec<u8>> = tx
                .query_row("SELECT value FROM secrets WHERE name = ?1", [name], |row| row.get(0))
                .optional()?;
            if let Some(found) = found {
                return found
                    .try_into()
                    .map_err(|_| Error::Damaged(format!("the {name} has the wrong length")));
            }
            let made = random()?;
            tx.execute("INSERT INTO secrets (name, value) VALUES (?1, ?2)", params![name, made])?;
            Ok(made)
        };
        let secrets = Secrets::new(&read("signing key")?, read("seed secret")?);
        tx.commit()?;
        Ok(secrets)
    }
}

/// Whether nobody has the permission to write to the file.
fn is_archive(path: &Path) -> bool {
    path.metadata().is_ok_and(|file| file.permissions().readonly())
}

/// Makes the file for its owner alone, or sees to it that it is so.
fn protect(path: &Path, is_archive: bool) -> Result<()> {
    let failed = |problem| Error::File { path: path.to_owned(), problem };
    let mut options = std::fs::OpenOptions::new();
    options.read(true).append(!is_archive).create(!is_archive);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let file = options.open(path).map_err(failed)?;
    #[cfg(unix)]
    {
        let mode =
            std::os::unix::fs::PermissionsExt::mode(&file.metadata().map_err(failed)?.permissions()) & 0o777;
        if mode & 0o077 != 0 {
            return Err(Error::Exposed { path: path.to_owned(), mode });
        }
    }
    drop(file);
    Ok(())
}

fn migrate(db: &mut Connection, path: &Path) -> Result<()> {
    let known = MIGRATIONS.len() as i64;
    // two processes may open a new file at once
    let tx = db.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let pragma = |name: &str| tx.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
    let (owner, found) = (pragma("application_id")?, pragma("user_version")?);
    let tables: i64 = tx.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
    if owner != APPLICATION_ID && tables > 0 {
        return Err(Error::Foreign { path: path.to_owned() });
    }
    if found > known {
        return Err(Error::Newer { path: path.to_owned(), found, known });
    }
    if owner == APPLICATION_ID && found == known {
        return Ok(());
    }
    for migration in &MIGRATIONS
        [usize::try_from(found).map_err(|_| Error::Damaged(format!("schema version {found}")))?..]
    {
        tx.execute_batch(migration)?;
    }
    tx.pragma_update(None, "application_id", APPLICATION_ID)?;
    tx.pragma_update(None, "user_version", known)?;
    Ok(tx.commit()?)
}

const COLUMNS: &str = "number, id, scenario, team, controller, begun_ms, status, document, signature";

/// As it is: text that is no longer UTF-8 must not hide the row.
fn attempt_row(row: &Row<'_>) -> rusqlite::Result<AttemptRow> {
    let bytes = |at: usize| -> rusqlite::Result<Vec<u8>> { Ok(row.get_ref(at)?.as_bytes()?.to_vec()) };
    let text = |at: usize| Ok::<_, rusqlite::Error>(String::from_utf8_lossy(&bytes(at)?).into_owned());
    Ok(AttemptRow {
        number: row.get(0)?,
        id: text(1)?,
        scenario: text(2)?,
        team: text(3)?,
        controller: text(4)?,
        begun_ms: row.get(5)?,
        status: text(6)?,
        document: bytes(7)?,
        signature: bytes(8)?,
    })
}

/// A document is text in the database, for whoever looks at it with other tools.
fn as_text(document: &[u8]) -> Result<&str> {
    std::str::from_utf8(document).map_err(|e| Error::Internal(format!("a document that is no text: {e}")))
}

impl Store for Sqlite {
    fn is_archive(&self) -> Result<bool> {
        Ok(self.db.is_readonly(rusqlite::MAIN_DB)?)
    }

    fn begin(&mut self, make: &(dyn Fn(i64) -> Result<AttemptRow> + Sync)) -> Result<i64> {
        let tx = self.db.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let last = last_number(&tx)?;
        let row = make(last + 1)?;
        tx.execute(
            &format!("INSERT INTO attempts ({COLUMNS}) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)"),
            params![
                row.number,
                row.id,
                row.scenario,
                row.team,
                row.controller,
                row.begun_ms,
                row.status,
                as_text(&row.document)?,
                row.signature
            ],
        )?;
        tx.commit()?;
        Ok(row.number)
    }

    fn conclude(&mut self, row: &AttemptRow, actions: Option<&[u8]>) -> Result<bool> {
        let changed = self.db.execute(
            "UPDATE attempts SET status = ?2, document = ?3, signature = ?4, actions = ?5 WHERE id = ?1 AND status = 'running'",
            params![row.id, row.status, as_text(&row.document)?, row.signature, actions],
        )?;
        Ok(changed == 1)
    }

    fn attempts(&self, filter: AttemptFilter<'_>) -> Result<Vec<AttemptRow>> {
        let sql = format!(
            "SELECT {COLUMNS} FROM attempts WHERE (?1 IS NULL OR scenario = ?1) AND (?2 IS NULL OR id = ?2) ORDER BY number"
        );
        let mut query = self.db.prepare(&sql)?;
        let rows = query.query_map(params![filter.scenario, filter.id], attempt_row)?;
        Ok(rows.collect::<rusqlite::Result<_>>()?)
    }

    fn running_since_before(&self, ms: i64) -> Result<Vec<AttemptRow>> {
        let mut query = self
            .db
            .prepare(&format!("SELECT {COLUMNS} FROM attempts WHERE status = 'running' AND begun_ms < ?1"))?;
        let rows = query.query_map([ms], attempt_row)?;
        Ok(rows.collect::<rusqlite::Result<_>>()?)
    }

    fn actions(&self, id: &str) -> Result<Option<Vec<u8>>> {
        let found = self
            .db
            .query_row("SELECT actions FROM attempts WHERE id = ?1", [id], |row| row.get(0))
            .optional()?;
        Ok(found.flatten())
    }

    fn newest_concluded(&self) -> Result<Option<AttemptRow>> {
        let sql =
            format!("SELECT {COLUMNS} FROM attempts WHERE status <> 'running' ORDER BY number DESC LIMIT 1");
        Ok(self.db.query_row(&sql, [], attempt_row).optional()?)
    }

    fn revision(&self) -> Result<Revision> {
        let sql = "SELECT count(*), coalesce(sum(status <> 'running'), 0) FROM attempts";
        Ok(self.db.query_row(sql, [], |row| Ok(Revision { all: row.get(0)?, over: row.get(1)? }))?)
    }

    fn last_number(&self) -> Result<i64> {
        last_number(&self.db)
    }

    fn begun_since(&self, team: &str, since_ms: i64) -> Result<Vec<i64>> {
        let mut query = self
            .db
            .prepare("SELECT begun_ms FROM attempts WHERE team = ?1 AND begun_ms > ?2 ORDER BY begun_ms")?;
        let rows = query.query_map(params![team, since_ms], |row| row.get(0))?;
        Ok(rows.collect::<rusqlite::Result<_>>()?)
    }

    fn team_attempts(&self, team: &str, scenario: &str) -> Result<Vec<TeamAttempt>> {
        let mut query = self.db.prepare(
            "SELECT controller, begun_ms FROM attempts WHERE team = ?1 AND scenario = ?2 ORDER BY number",
        )?;
        let rows = query.query_map(params![team, scenario], |row| {
            Ok(TeamAttempt { controller: row.get(0)?, begun_ms: row.get(1)? })
        })?;
        Ok(rows.collect::<rusqlite::Result<_>>()?)
    }

    fn add_token(&mut self, team: &str, hash: &[u8; 32], now_ms: i64) -> Result<()> {
        self.db.execute(
            "INSERT INTO tokens (team, hash, created_ms) VALUES (?1, ?2, ?3)",
            params![team, hash, now_ms],
        )?;
        Ok(())
    }

    fn tokens(&self) -> Result<Vec<StoredToken>> {
        let mut query = self
            .db
            .prepare("SELECT number, team, hash, created_ms, revoked_ms FROM tokens ORDER BY number")?;
        let token = |row: &Row<'_>| {
            Ok(StoredToken {
                number: row.get(0)?,
                team: row.get(1)?,
                hash: row.get(2)?,
                created_ms: row.get(3)?,
                revoked_ms: row.get(4)?,
            })
        };
        let rows = query.query_map([], token)?;
        Ok(rows.collect::<rusqlite::Result<_>>()?)
    }

    fn revoke(&mut self, team: &str, now_ms: i64) -> Result<usize> {
        Ok(self.db.execute(
            "UPDATE tokens SET revoked_ms = ?2 WHERE team = ?1 AND revoked_ms IS NULL",
            params![team, now_ms],
        )?)
    }

    fn add_season(&mut self, name: &str, season: &StoredSeason) -> Result<()> {
        self.db.execute(
            "INSERT INTO seasons (name, document, signature, secret) VALUES (?1, ?2, ?3, ?4)",
            params![name, as_text(&season.document)?, season.signature, season.secret],
        )?;
        Ok(())
    }

    fn close_season(&mut self, name: &str, now_ms: i64) -> Result<()> {
        self.db.execute(
            "UPDATE seasons SET closed_ms = ?2 WHERE name = ?1 AND closed_ms IS NULL",
            params![name, now_ms],
        )?;
        Ok(())
    }

    fn seasons(&self) -> Result<Vec<StoredSeason>> {
        let mut query =
            self.db.prepare("SELECT document, signature, secret, closed_ms FROM seasons ORDER BY number")?;
        let season = |row: &Row<'_>| {
            Ok(StoredSeason {
                document: row.get_ref(0)?.as_bytes()?.to_vec(),
                signature: row.get(1)?,
                secret: row.get(2)?,
                closed_ms: row.get(3)?,
            })
        };
        let rows = query.query_map([], season)?;
        Ok(rows.collect::<rusqlite::Result<_>>()?)
    }
}

/// Counted by SQLite, which remembers it when rows are taken away.
fn last_number(db: &Connection) -> Result<i64> {
    let found: Option<i64> = db
        .query_row("SELECT seq FROM sqlite_sequence WHERE name = 'attempts'", [], |row| row.get(0))
        .optional()?;
    Ok(found.unwrap_or(0))
}

/// Default path of the database.
pub fn default_path() -> PathBuf {
    PathBuf::from("crazyflie.sqlite")
}
