//! The store in SQL, written once for every database: what differs are connections, migrations, and how
//! attempts are counted.

use std::cell::Cell;
use std::time::{Duration, Instant};

use tracing::error;

use super::error::{Error, Result};
use super::record::AttemptRow;
use super::seasons::StoredSeason;
use super::secrets::{Bytes, Secrets, random};
use super::store::{AttemptFilter, AttemptPage, Revision, Store, TeamAttempt};
use super::teams::Token;

/// The value of a parameter, `$1` and so on in a statement.
#[derive(Debug, Clone, Copy)]
pub(super) enum Param<'a> {
    Null,
    Int(i64),
    Text(&'a str),
    Blob(&'a [u8]),
}

/// The value of a column; text is as it is, even if it is no longer UTF-8.
#[derive(Debug)]
pub(super) enum Value {
    Null,
    Int(i64),
    Bytes(Vec<u8>),
}

/// Rows of an answer.
pub(super) type Rows = Vec<Vec<Value>>;

/// A transaction that is open.
pub(super) trait Statements {
    /// Changes rows; how many.
    fn execute(&mut self, sql: &str, params: &[Param<'_>]) -> Result<usize>;
    fn query(&mut self, sql: &str, params: &[Param<'_>]) -> Result<Rows>;
}

/// A database of SQL.
pub(super) trait Database: Send {
    /// The number of a new attempt; numbers have no gaps.
    const NEXT_NUMBER: &'static str;
    /// The number of the newest attempt, or 0.
    const LAST_NUMBER: &'static str;
    /// In a transaction that writes: no attempt begins beside it.
    const HOLD_NUMBERS: &'static str;

    /// Returns whether nothing in it can change.
    fn is_read_only(&self) -> Result<bool>;

    /// Runs `work` as one transaction. If `writes`, the rows to change are locked from the beginning. After a lost
    /// connection `work` runs once more; what it did before is undone.
    fn transact<T: Send>(
        &self,
        writes: bool,
        work: impl Fn(&mut dyn Statements) -> Result<T> + Send,
    ) -> Result<T>;
}

/// Time for which a database that could not be reached is left alone, so that requests do not queue behind
/// each other's waits.
const REST: Duration = Duration::from_secs(1);

/// The store in a database. Failures are logged here, for all callers.
pub(super) struct SqlStore<D> {
    pub(super) database: D,
    /// When it could not be reached.
    failed: Cell<Option<Instant>>,
}

impl<D: Database> SqlStore<D> {
    pub(super) fn new(database: D) -> Self {
        SqlStore { database, failed: Cell::new(None) }
    }

    fn transact<T: Send>(
        &self,
        writes: bool,
        work: impl Fn(&mut dyn Statements) -> Result<T> + Send,
    ) -> Result<T> {
        if self.failed.get().is_some_and(|at| at.elapsed() < REST) {
            return Err(Error::Away { retry_after_s: REST.as_secs() });
        }
        self.failed.set(None);
        self.database.transact(writes, work).inspect_err(|problem| {
            if problem.is_away() {
                self.failed.set(Some(Instant::now()));
            }
            if problem.is_of_database() {
                error!(%problem, "the benchmark's database failed");
            }
        })
    }

    /// Reads rows, each by `take`.
    fn rows<T>(&self, sql: &str, params: &[Param<'_>], take: fn(Row) -> Result<T>) -> Result<Vec<T>> {
        let rows = self.transact(false, |tx| tx.query(sql, params))?;
        rows.into_iter().map(|row| take(Row(row.into_iter()))).collect()
    }

    /// Changes rows; how many.
    fn change(&self, sql: &str, params: &[Param<'_>]) -> Result<usize> {
        self.transact(true, |tx| tx.execute(sql, params))
    }
}

/// Each brings the schema one version on, in the words of SQLite.
pub(super) const SCHEMA: &[&str] =
    &[include_str!("schema/1_attempts.sql"), include_str!("schema/2_seasons.sql")];

const COLUMNS: &str = "number, id, scenario, team, controller, begun_ms, status, document, signature";

/// The signing key and the secret, made on first use.
pub(super) fn secrets(database: &impl Database) -> Result<Secrets> {
    database.transact(!database.is_read_only()?, |tx| {
        let mut read = |name: &str| -> Result<Bytes> {
            let sql = "SELECT value FROM secrets WHERE name = $1";
            let mut rows = tx.query(sql, &[Param::Text(name)])?;
            if rows.is_empty() {
                // several processes may open a new database at once: the first one sets the secret
                let sql = "INSERT INTO secrets (name, value) VALUES ($1, $2) ON CONFLICT (name) DO NOTHING";
                tx.execute(sql, &[Param::Text(name), Param::Blob(&random::<32>()?)])?;
                rows = tx.query("SELECT value FROM secrets WHERE name = $1", &[Param::Text(name)])?;
            }
            let mut row = Row::first(rows).ok_or_else(|| Error::Damaged(format!("there is no {name}")))?;
            row.bytes()?.try_into().map_err(|_| Error::Damaged(format!("the {name} has the wrong length")))
        };
        Ok(Secrets::new(&read("signing key")?, read("seed secret")?))
    })
}

/// The values of a row, one after the other.
struct Row(std::vec::IntoIter<Value>);

impl Row {
    fn first(rows: Rows) -> Option<Row> {
        rows.into_iter().next().map(|row| Row(row.into_iter()))
    }

    fn next(&mut self) -> Value {
        self.0.next().unwrap_or(Value::Null)
    }

    fn optional_int(&mut self) -> Result<Option<i64>> {
        match self.next() {
            Value::Int(number) => Ok(Some(number)),
            Value::Null => Ok(None),
            Value::Bytes(_) => Err(Error::Damaged("a number of the database is text".into())),
        }
    }

    fn int(&mut self) -> Result<i64> {
        self.optional_int()?.ok_or_else(|| Error::Damaged("a number of the database is missing".into()))
    }

    fn optional_bytes(&mut self) -> Result<Option<Vec<u8>>> {
        match self.next() {
            Value::Bytes(bytes) => Ok(Some(bytes)),
            Value::Null => Ok(None),
            Value::Int(_) => Err(Error::Damaged("a text of the database is a number".into())),
        }
    }

    fn bytes(&mut self) -> Result<Vec<u8>> {
        self.optional_bytes()?.ok_or_else(|| Error::Damaged("a text of the database is missing".into()))
    }

    /// Text that is no longer UTF-8 must not hide the row.
    fn text(&mut self) -> Result<String> {
        Ok(String::from_utf8_lossy(&self.bytes()?).into_owned())
    }

    fn attempt(mut self) -> Result<AttemptRow> {
        Ok(AttemptRow {
            number: self.int()?,
            id: self.text()?,
            scenario: self.text()?,
            team: self.text()?,
            controller: self.text()?,
            begun_ms: self.int()?,
            status: self.text()?,
            document: self.bytes()?,
            signature: self.bytes()?,
        })
    }
}

/// A document is text in the database, for whoever looks at it with other tools.
fn text(document: &[u8]) -> Result<Param<'_>> {
    let text = std::str::from_utf8(document);
    text.map(Param::Text).map_err(|e| Error::Internal(format!("a document that is no text: {e}")))
}

impl<D: Database> Store for SqlStore<D> {
    fn is_archive(&self) -> Result<bool> {
        self.database.is_read_only()
    }

    fn begin(
        &mut self,
        season: Option<&str>,
        make: &(dyn Fn(i64) -> Result<AttemptRow> + Sync),
    ) -> Result<Option<i64>> {
        self.transact(true, |tx| {
            tx.query(D::HOLD_NUMBERS, &[])?;
            let open = "SELECT name FROM seasons WHERE closed_ms IS NULL ORDER BY number DESC LIMIT 1";
            let open = Row::first(tx.query(open, &[])?).map(|mut row| row.text()).transpose()?;
            if open.as_deref() != season {
                return Ok(None);
            }
            let next = Row::first(tx.query(D::NEXT_NUMBER, &[])?);
            let row = make(next.ok_or_else(|| Error::Damaged("attempts are not counted".into()))?.int()?)?;
            tx.execute(
                &format!("INSERT INTO attempts ({COLUMNS}) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)"),
                &[
                    Param::Int(row.number),
                    Param::Text(&row.id),
                    Param::Text(&row.scenario),
                    Param::Text(&row.team),
                    Param::Text(&row.controller),
                    Param::Int(row.begun_ms),
                    Param::Text(&row.status),
                    text(&row.document)?,
                    Param::Blob(&row.signature),
                ],
            )?;
            Ok(Some(row.number))
        })
    }

    fn conclude(&mut self, row: &AttemptRow, actions: Option<&[u8]>) -> Result<bool> {
        // again if it is not known whether the row was stored before the connection was lost
        let sql = "UPDATE attempts SET status = $2, document = $3, signature = $4, actions = $5 WHERE id = $1 AND (status = 'running' OR signature = $4)";
        let (status, document) = (Param::Text(&row.status), text(&row.document)?);
        let actions = actions.map_or(Param::Null, Param::Blob);
        let params = [Param::Text(&row.id), status, document, Param::Blob(&row.signature), actions];
        Ok(self.change(sql, &params)? == 1)
    }

    fn attempts(&self, filter: AttemptFilter<'_>) -> Result<Vec<AttemptRow>> {
        let sql = format!(
            "SELECT {COLUMNS} FROM attempts WHERE (CAST($1 AS TEXT) IS NULL OR scenario = $1) AND (CAST($2 AS TEXT) IS NULL OR id = $2) AND number > $3 ORDER BY number LIMIT $4"
        );
        let [scenario, id] = [filter.scenario, filter.id].map(|name| name.map_or(Param::Null, Param::Text));
        let AttemptPage { after, limit } = filter.page;
        self.rows(&sql, &[scenario, id, Param::Int(after), Param::Int(limit)], Row::attempt)
    }

    fn running_since_before(&self, ms: i64) -> Result<Vec<AttemptRow>> {
        let sql = format!("SELECT {COLUMNS} FROM attempts WHERE status = 'running' AND begun_ms < $1");
        self.rows(&sql, &[Param::Int(ms)], Row::attempt)
    }

    fn actions(&self, id: &str) -> Result<Option<Vec<u8>>> {
        let sql = "SELECT actions FROM attempts WHERE id = $1";
        let rows = self.rows(sql, &[Param::Text(id)], |mut row| row.optional_bytes())?;
        Ok(rows.into_iter().next().flatten())
    }

    fn newest_concluded(&self) -> Result<Option<AttemptRow>> {
        let sql =
            format!("SELECT {COLUMNS} FROM attempts WHERE status <> 'running' ORDER BY number DESC LIMIT 1");
        Ok(self.rows(&sql, &[], Row::attempt)?.pop())
    }

    fn revision(&self) -> Result<Revision> {
        let sql = "SELECT count(*), count(*) FILTER (WHERE status <> 'running') FROM attempts";
        let counted = self.rows(sql, &[], |mut row| Ok(Revision { all: row.int()?, over: row.int()? }))?;
        counted.into_iter().next().ok_or_else(|| Error::Internal("nothing was counted".into()))
    }

    fn last_number(&self) -> Result<i64> {
        Ok(self.rows(D::LAST_NUMBER, &[], |mut row| row.int())?.pop().unwrap_or(0))
    }

    fn begun_between(&self, team: &str, from_ms: i64, to_ms: i64) -> Result<Vec<i64>> {
        let sql = "SELECT begun_ms FROM attempts WHERE team = $1 AND begun_ms > $2 AND begun_ms <= $3 ORDER BY begun_ms";
        self.rows(sql, &[Param::Text(team), Param::Int(from_ms), Param::Int(to_ms)], |mut row| row.int())
    }

    fn team_attempts(&self, team: &str, scenario: &str) -> Result<Vec<TeamAttempt>> {
        let sql =
            "SELECT controller, begun_ms FROM attempts WHERE team = $1 AND scenario = $2 ORDER BY number";
        self.rows(sql, &[Param::Text(team), Param::Text(scenario)], |mut row| {
            Ok(TeamAttempt { controller: row.text()?, begun_ms: row.int()? })
        })
    }

    fn add_token(&mut self, team: &str, hash: &[u8; 32], now_ms: i64) -> Result<()> {
        let sql = "INSERT INTO tokens (team, hash, created_ms) VALUES ($1, $2, $3)";
        self.change(sql, &[Param::Text(team), Param::Blob(hash), Param::Int(now_ms)]).map(drop)
    }

    fn tokens(&self) -> Result<Vec<Token>> {
        let sql = "SELECT number, team, hash, created_ms, revoked_ms FROM tokens ORDER BY number";
        self.rows(sql, &[], |mut row| {
            let (number, team, hash) = (row.int()?, row.text()?, row.bytes()?);
            Ok(Token { number, team, hash, created_ms: row.int()?, revoked_ms: row.optional_int()? })
        })
    }

    fn revoke(&mut self, team: &str, now_ms: i64) -> Result<usize> {
        let sql = "UPDATE tokens SET revoked_ms = $2 WHERE team = $1 AND revoked_ms IS NULL";
        self.change(sql, &[Param::Text(team), Param::Int(now_ms)])
    }

    fn add_season(&mut self, name: &str, season: &StoredSeason) -> Result<()> {
        let sql = "INSERT INTO seasons (name, document, signature, secret) VALUES ($1, $2, $3, $4)";
        let (signature, secret) = (Param::Blob(&season.signature), Param::Blob(&season.secret));
        self.change(sql, &[Param::Text(name), text(&season.document)?, signature, secret]).map(drop)
    }

    fn close_season(&mut self, name: &str, now_ms: i64) -> Result<()> {
        let sql = "UPDATE seasons SET closed_ms = $2 WHERE name = $1 AND closed_ms IS NULL";
        self.transact(true, |tx| {
            tx.query(D::HOLD_NUMBERS, &[])?;
            tx.execute(sql, &[Param::Text(name), Param::Int(now_ms)]).map(drop)
        })
    }

    fn seasons(&self) -> Result<Vec<StoredSeason>> {
        let sql = "SELECT document, signature, secret, closed_ms FROM seasons ORDER BY number";
        self.rows(sql, &[], |mut row| {
            let (document, signature, secret) = (row.bytes()?, row.bytes()?, row.bytes()?.try_into());
            let secret =
                secret.map_err(|_| Error::Damaged("the secret of a season has the wrong length".into()))?;
            Ok(StoredSeason { document, signature, secret, closed_ms: row.optional_int()? })
        })
    }
}
