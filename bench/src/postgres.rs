//! The store on PostgreSQL, for several server processes that share teams, attempts and leaderboard. The signing key
//! and the secret are in it too: whoever may read the database may read them.

use std::sync::{Mutex, PoisonError};

use postgres::{Client, NoTls, Row, Transaction};

use super::error::{Error, Result};
use super::record::AttemptRow;
use super::seasons::StoredSeason;
use super::secrets::{Bytes, Secrets, random};
use super::store::{AttemptFilter, Revision, Store, StoredToken, TeamAttempt};

/// "crzf" as a number: so many processes as open a new database at once, only one makes its tables.
const LOCK: i64 = 0x6372_7a66;

/// Each brings the schema one version on.
const MIGRATIONS: &[&str] = &["
    CREATE TABLE secrets (name TEXT PRIMARY KEY, value BYTEA NOT NULL);
    CREATE TABLE counters (name TEXT PRIMARY KEY, value BIGINT NOT NULL);
    INSERT INTO counters (name, value) VALUES ('attempts', 0);
    CREATE TABLE attempts (
        number BIGINT PRIMARY KEY,
        id TEXT NOT NULL UNIQUE,
        scenario TEXT NOT NULL,
        team TEXT NOT NULL,
        controller TEXT NOT NULL,
        begun_ms BIGINT NOT NULL,
        status TEXT NOT NULL,
        document TEXT NOT NULL,
        signature BYTEA NOT NULL,
        actions BYTEA
    );
    CREATE INDEX attempts_by_scenario ON attempts (scenario);
    CREATE INDEX attempts_by_team ON attempts (team, begun_ms);
    CREATE INDEX attempts_running ON attempts (begun_ms) WHERE status = 'running';
    CREATE TABLE tokens (
        number BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
        team TEXT NOT NULL,
        hash BYTEA NOT NULL UNIQUE,
        created_ms BIGINT NOT NULL,
        revoked_ms BIGINT
    );
    CREATE TABLE seasons (
        number BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
        name TEXT NOT NULL UNIQUE,
        document TEXT NOT NULL,
        signature BYTEA NOT NULL,
        secret BYTEA NOT NULL,
        closed_ms BIGINT
    );"];

const COLUMNS: &str = "number, id, scenario, team, controller, begun_ms, status, document, signature";

pub(super) struct Postgres {
    url: String,
    /// None while it is dropped.
    client: Mutex<Option<Client>>,
}

/// Runs on a thread of its own: the library waits with a runtime of its own, which no task of another may do.
fn run_aside<T: Send>(work: impl FnOnce() -> T + Send) -> Result<T> {
    let broken = |_| Error::Internal("the thread of the database broke".into());
    std::thread::scope(|scope| scope.spawn(work).join()).map_err(broken)
}

impl Postgres {
    /// Connects, and makes or migrates the tables as needed.
    pub(super) fn open(url: &str) -> Result<Postgres> {
        let client = run_aside(|| -> Result<Client> {
            let mut client = Client::connect(url, NoTls)?;
            migrate(&mut client)?;
            Ok(client)
        })??;
        Ok(Postgres { url: url.into(), client: Mutex::new(Some(client)) })
    }

    /// The signing key and the secret, made on first use.
    pub(super) fn secrets(&self) -> Result<Secrets> {
        self.change(|tx| {
            tx.execute("SELECT pg_advisory_xact_lock($1)", &[&LOCK])?;
            let mut read = |name: &str| -> Result<Bytes> {
                let found = tx.query_opt("SELECT value FROM secrets WHERE name = $1", &[&name])?;
                if let Some(found) = found {
                    return found
                        .get::<_, Vec<u8>>(0)
                        .try_into()
                        .map_err(|_| Error::Damaged(format!("the {name} has the wrong length")));
                }
                let made: Bytes = random()?;
                tx.execute("INSERT INTO secrets (name, value) VALUES ($1, $2)", &[&name, &&made[..]])?;
                Ok(made)
            };
            Ok(Secrets::new(&read("signing key")?, read("seed secret")?))
        })
    }

    /// Asks, after connecting again if the connection was lost.
    fn ask<T: Send>(&self, work: impl FnOnce(&mut Client) -> Result<T> + Send) -> Result<T> {
        run_aside(|| {
            let mut client = self.client.lock().unwrap_or_else(PoisonError::into_inner);
            let open = client.take().filter(|client| !client.is_closed());
            let open = open.map_or_else(|| Client::connect(&self.url, NoTls), Ok)?;
            work(client.insert(open))
        })?
    }

    /// Changes everything or nothing.
    fn change<T: Send>(&self, work: impl FnOnce(&mut Transaction<'_>) -> Result<T> + Send) -> Result<T> {
        self.ask(|client| {
            let mut tx = client.transaction()?;
            let done = work(&mut tx)?;
            tx.commit()?;
            Ok(done)
        })
    }
}

fn migrate(client: &mut Client) -> Result<()> {
    let known = MIGRATIONS.len() as i64;
    let mut tx = client.transaction()?;
    tx.execute("SELECT pg_advisory_xact_lock($1)", &[&LOCK])?;
    tx.batch_execute("CREATE TABLE IF NOT EXISTS crazyflie_schema (version BIGINT NOT NULL)")?;
    let found =
        tx.query_opt("SELECT version FROM crazyflie_schema", &[])?.map_or(0, |row| row.get::<_, i64>(0));
    if found > known {
        return Err(Error::Newer { path: "the database".into(), found, known });
    }
    let from = usize::try_from(found).map_err(|_| Error::Damaged(format!("schema version {found}")))?;
    for migration in &MIGRATIONS[from..] {
        tx.batch_execute(migration)?;
    }
    tx.execute("DELETE FROM crazyflie_schema", &[])?;
    tx.execute("INSERT INTO crazyflie_schema (version) VALUES ($1)", &[&known])?;
    Ok(tx.commit()?)
}

fn attempt_row(row: &Row) -> AttemptRow {
    AttemptRow {
        number: row.get(0),
        id: row.get(1),
        scenario: row.get(2),
        team: row.get(3),
        controller: row.get(4),
        begun_ms: row.get(5),
        status: row.get(6),
        document: row.get::<_, String>(7).into_bytes(),
        signature: row.get(8),
    }
}

fn text(document: &[u8]) -> Result<&str> {
    std::str::from_utf8(document).map_err(|e| Error::Internal(format!("a document that is no text: {e}")))
}

impl Store for Postgres {
    fn is_archive(&self) -> Result<bool> {
        Ok(false)
    }

    fn begin(&mut self, make: &(dyn Fn(i64) -> Result<AttemptRow> + Sync)) -> Result<i64> {
        self.change(|tx| {
            // the row of the counter is locked until the end: numbers have no gaps
            let counted = tx.query_one(
                "UPDATE counters SET value = value + 1 WHERE name = 'attempts' RETURNING value",
                &[],
            )?;
            let row = make(counted.get(0))?;
            tx.execute(
                &format!("INSERT INTO attempts ({COLUMNS}) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)"),
                &[
                    &row.number,
                    &row.id,
                    &row.scenario,
                    &row.team,
                    &row.controller,
                    &row.begun_ms,
                    &row.status,
                    &text(&row.document)?,
                    &row.signature,
                ],
            )?;
            Ok(row.number)
        })
    }

    fn conclude(&mut self, row: &AttemptRow, actions: Option<&[u8]>) -> Result<bool> {
        let changed = self.ask(|client| {
            Ok(client.execute(
                "UPDATE attempts SET status = $2, document = $3, signature = $4, actions = $5 WHERE id = $1 AND status = 'running'",
                &[&row.id, &row.status, &text(&row.document)?, &row.signature, &actions],
            )?)
        })?;
        Ok(changed == 1)
    }

    fn attempts(&self, filter: AttemptFilter<'_>) -> Result<Vec<AttemptRow>> {
        let sql = format!(
            "SELECT {COLUMNS} FROM attempts WHERE ($1::text IS NULL OR scenario = $1) AND ($2::text IS NULL OR id = $2) ORDER BY number"
        );
        self.ask(|client| {
            Ok(client.query(&sql, &[&filter.scenario, &filter.id])?.iter().map(attempt_row).collect())
        })
    }

    fn running_since_before(&self, ms: i64) -> Result<Vec<AttemptRow>> {
        let sql = format!("SELECT {COLUMNS} FROM attempts WHERE status = 'running' AND begun_ms < $1");
        self.ask(|client| Ok(client.query(&sql, &[&ms])?.iter().map(attempt_row).collect()))
    }

    fn actions(&self, id: &str) -> Result<Option<Vec<u8>>> {
        let found =
            self.ask(|client| Ok(client.query_opt("SELECT actions FROM attempts WHERE id = $1", &[&id])?))?;
        Ok(found.and_then(|row| row.get(0)))
    }

    fn newest_concluded(&self) -> Result<Option<AttemptRow>> {
        let sql =
            format!("SELECT {COLUMNS} FROM attempts WHERE status <> 'running' ORDER BY number DESC LIMIT 1");
        self.ask(|client| Ok(client.query_opt(&sql, &[])?.as_ref().map(attempt_row)))
    }

    fn revision(&self) -> Result<Revision> {
        let sql = "SELECT count(*), count(*) FILTER (WHERE status <> 'running') FROM attempts";
        self.ask(|client| {
            let row = client.query_one(sql, &[])?;
            Ok(Revision { all: row.get(0), over: row.get(1) })
        })
    }

    fn last_number(&self) -> Result<i64> {
        self.ask(|client| {
            Ok(client.query_one("SELECT value FROM counters WHERE name = 'attempts'", &[])?.get(0))
        })
    }

    fn begun_since(&self, team: &str, since_ms: i64) -> Result<Vec<i64>> {
        self.ask(|client| {
            let sql = "SELECT begun_ms FROM attempts WHERE team = $1 AND begun_ms > $2 ORDER BY begun_ms";
            Ok(client.query(sql, &[&team, &since_ms])?.iter().map(|row| row.get(0)).collect())
        })
    }

    fn team_attempts(&self, team: &str, scenario: &str) -> Result<Vec<TeamAttempt>> {
        self.ask(|client| {
            let sql =
                "SELECT controller, begun_ms FROM attempts WHERE team = $1 AND scenario = $2 ORDER BY number";
            let attempt = |row: &Row| TeamAttempt { controller: row.get(0), begun_ms: row.get(1) };
            Ok(client.query(sql, &[&team, &scenario])?.iter().map(attempt).collect())
        })
    }

    fn add_token(&mut self, team: &str, hash: &[u8; 32], now_ms: i64) -> Result<()> {
        self.ask(|client| {
            let sql = "INSERT INTO tokens (team, hash, created_ms) VALUES ($1, $2, $3)";
            client.execute(sql, &[&team, &&hash[..], &now_ms])?;
            Ok(())
        })
    }

    fn tokens(&self) -> Result<Vec<StoredToken>> {
        let token = |row: &Row| StoredToken {
            number: row.get(0),
            team: row.get(1),
            hash: row.get(2),
            created_ms: row.get(3),
            revoked_ms: row.get(4),
        };
        self.ask(|client| {
            let sql = "SELECT number, team, hash, created_ms, revoked_ms FROM tokens ORDER BY number";
            Ok(client.query(sql, &[])?.iter().map(token).collect())
        })
    }

    fn revoke(&mut self, team: &str, now_ms: i64) -> Result<usize> {
        let sql = "UPDATE tokens SET revoked_ms = $2 WHERE team = $1 AND revoked_ms IS NULL";
        self.ask(|client| Ok(client.execute(sql, &[&team, &now_ms])? as usize))
    }

    fn add_season(&mut self, name: &str, season: &StoredSeason) -> Result<()> {
        self.ask(|client| {
            let sql = "INSERT INTO seasons (name, document, signature, secret) VALUES ($1, $2, $3, $4)";
            client
                .execute(sql, &[&name, &text(&season.document)?, &season.signature, &&season.secret[..]])?;
            Ok(())
        })
    }

    fn close_season(&mut self, name: &str, now_ms: i64) -> Result<()> {
        let sql = "UPDATE seasons SET closed_ms = $2 WHERE name = $1 AND closed_ms IS NULL";
        self.ask(|client| Ok(client.execute(sql, &[&name, &now_ms]).map(drop)?))
    }

    fn seasons(&self) -> Result<Vec<StoredSeason>> {
        let rows = self.ask(|client| {
            let sql = "SELECT document, signature, secret, closed_ms FROM seasons ORDER BY number";
            Ok(client.query(sql, &[])?)
        })?;
        let season = |row: &Row| {
            let secret = row.get::<_, Vec<u8>>(2).try_into();
            Ok(StoredSeason {
                document: row.get::<_, String>(0).into_bytes(),
                signature: row.get(1),
                secret: secret
                    .map_err(|_| Error::Damaged("the secret of a season has the wrong length".into()))?,
                closed_ms: row.get(3),
            })
        };
        rows.iter().map(season).collect()
    }
}

impl Drop for Postgres {
    fn drop(&mut self) {
        // closing waits too, and a server may end within a task
        let client = self.client.get_mut().unwrap_or_else(PoisonError::into_inner).take();
        let _ = run_aside(|| drop(client));
    }
}
