//! The store on SQLite: one file with everything, the signing key and the secret too. One file is backed up,
//! moved and protected (mode 0600) as a whole; a key in a file beside it could be lost or mixed up with
//! another.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rusqlite::types::{ToSql, ToSqlOutput, ValueRef};
use rusqlite::{Connection, OpenFlags, Row, Transaction, TransactionBehavior, params_from_iter};

use super::database_file::{DatabaseFile, check_log};
use super::error::{Error, Result};
use super::sql::{Database, Param, Rows, SCHEMA, Statements, Value};

/// "crzf" as a number: whose database this is.
const APPLICATION_ID: i64 = 0x6372_7a66;

/// Time to wait for another process that writes: to open the file, and for each transaction, behind which others
/// wait.
const BUSY: Duration = Duration::from_secs(10);
const BUSY_TRANSACTION: Duration = Duration::from_secs(2);

/// Between two tries where SQLite itself does not wait.
const RETRY: Duration = Duration::from_millis(20);

/// Turns write-ahead logging on. Processes that open a new file at once all request it, and SQLite reports to some
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
    /// None for a database in memory, and an archive.
    file: Option<DatabaseFile>,
    /// Nothing in it changes any more.
    is_frozen: bool,
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
        check_log(path)?;
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
        db.busy_timeout(BUSY_TRANSACTION)?;
        Ok(Sqlite { db, file: Some(DatabaseFile::new(path)), is_frozen: false })
    }

    /// A database of this program alone, gone with it.
    pub(super) fn in_memory() -> Result<Sqlite> {
        let mut db = Connection::open_in_memory()?;
        migrate(&mut db, Path::new("memory"))?;
        Ok(Sqlite { db, file: None, is_frozen: false })
    }

    /// From now on nothing changes: it has one season of another database. Numbers of other attempts lie between those
    /// of the season, so that none is the last.
    pub(super) fn freeze(&mut self) -> Result<()> {
        self.db.execute("DELETE FROM sqlite_sequence", [])?;
        self.is_frozen = true;
        Ok(())
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
        let known = SCHEMA.len() as i64;
        match (pragma("application_id")?, pragma("user_version")?) {
            (APPLICATION_ID, found) if found > known => {
                Err(Error::Newer { path: path.to_owned(), found, known })
            }
            (APPLICATION_ID, _) => Ok(Sqlite { db, file: None, is_frozen: false }),
            _ => Err(Error::Foreign { path: path.to_owned() }),
        }
    }
}

/// Returns whether nobody has the permission to write to the file.
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
    let known = SCHEMA.len() as i64;
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
    for migration in
        &SCHEMA[usize::try_from(found).map_err(|_| Error::Damaged(format!("schema version {found}")))?..]
    {
        tx.execute_batch(migration)?;
    }
    tx.pragma_update(None, "application_id", APPLICATION_ID)?;
    tx.pragma_update(None, "user_version", known)?;
    Ok(tx.commit()?)
}

impl ToSql for Param<'_> {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        Ok(ToSqlOutput::Borrowed(match self {
            Param::Null => ValueRef::Null,
            Param::Int(number) => ValueRef::Integer(*number),
            Param::Text(text) => ValueRef::Text(text.as_bytes()),
            Param::Blob(bytes) => ValueRef::Blob(bytes),
        }))
    }
}

impl Statements for Transaction<'_> {
    fn execute(&mut self, sql: &str, params: &[Param<'_>]) -> Result<usize> {
        Ok(Connection::execute(self, &numbered(sql), params_from_iter(params))?)
    }

    fn query(&mut self, sql: &str, params: &[Param<'_>]) -> Result<Rows> {
        let mut query = self.prepare(&numbered(sql))?;
        let columns = query.column_count();
        let value = |value: ValueRef<'_>| match value {
            ValueRef::Integer(number) => Value::Int(number),
            ValueRef::Text(bytes) | ValueRef::Blob(bytes) => Value::Bytes(bytes.to_vec()),
            ValueRef::Null | ValueRef::Real(_) => Value::Null,
        };
        let row = |row: &Row<'_>| (0..columns).map(|at| row.get_ref(at).map(value)).collect();
        Ok(query.query_map(params_from_iter(params), row)?.collect::<rusqlite::Result<_>>()?)
    }
}

/// With parameters as SQLite counts them.
fn numbered(sql: &str) -> String {
    sql.replace('$', "?")
}

impl Database for Sqlite {
    const NEXT_NUMBER: &'static str =
        "SELECT coalesce(max(seq), 0) + 1 FROM sqlite_sequence WHERE name = 'attempts'";
    // counted by SQLite, which remembers it when rows are taken away
    const LAST_NUMBER: &'static str =
        "SELECT coalesce(max(seq), 0) FROM sqlite_sequence WHERE name = 'attempts'";
    // a transaction that writes is alone
    const HOLD_NUMBERS: &'static str = "SELECT 1";

    fn is_read_only(&self) -> Result<bool> {
        Ok(self.is_frozen || self.db.is_readonly(rusqlite::MAIN_DB)?)
    }

    fn transact<T: Send>(
        &self,
        writes: bool,
        work: impl Fn(&mut dyn Statements) -> Result<T> + Send,
    ) -> Result<T> {
        if writes && self.is_frozen {
            return Err(Error::Archive);
        }
        self.file.as_ref().map_or(Ok(()), DatabaseFile::check)?;
        let behavior = if writes { TransactionBehavior::Immediate } else { TransactionBehavior::Deferred };
        let mut tx = Transaction::new_unchecked(&self.db, behavior)?;
        let done = work(&mut tx)?;
        tx.commit()?;
        Ok(done)
    }
}

/// Default path of the database.
pub fn default_path() -> PathBuf {
    PathBuf::from("crazyflie.sqlite")
}
