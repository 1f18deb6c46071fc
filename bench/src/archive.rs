//! A season in one file, JSON line by line: the signed documents of its beginning and its end, the secret, and every
//! attempt with its actions. Anyone with the file can verify it without the server.

use std::io::{BufRead, Write};
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use ed25519_dalek::VerifyingKey;
use serde::{Deserialize, Serialize};

use super::Bench;
use super::error::{Error, Result};
use super::record::{AttemptRow, Document};
use super::seasons::{SeasonDocument, StoredSeason, no_season};
use super::secrets::{Secrets, canonical, sha256_hex};
use super::sql::SqlStore;
use super::sqlite::Sqlite;
use super::store::{AttemptFilter, Store};

/// Format of the file, in its first line.
const FORMAT: &str = "crazyflie.season.v1";

/// The first line.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Head {
    format: String,
    public_key: String,
    /// Text of the signed [`SeasonDocument`].
    season: String,
    season_signature: String,
    /// Text of the signed [`Closing`].
    closing: String,
    closing_signature: String,
}

/// The document signed when a season is archived: the secret, and every row, so that none can be taken away.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Closing {
    name: String,
    closed_ms: i64,
    secret: String,
    /// Number and SHA-256 of each attempt's document.
    rows: Vec<(i64, String)>,
}

/// A line for an attempt.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    document: String,
    signature: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    actions: Option<String>,
}

impl Bench {
    /// Writes the archive of a season that is closed; how many attempts are in it.
    ///
    /// # Errors
    /// [`Error::Season`], and of the writer.
    pub fn write_season(&self, name: &str, out: &mut dyn Write) -> Result<usize> {
        let refuse = |problem: &str| Error::Season { name: name.into(), problem: problem.into() };
        let season = self.season_row(name)?;
        let closed_ms = season.closed_ms.ok_or_else(|| refuse("it is open: close it first"))?;
        if season.under_way > 0 {
            return Err(refuse("attempts are under way: archive it when they are over, within 30 minutes"));
        }
        let rows: Vec<AttemptRow> = {
            let rows = self.store().attempts(AttemptFilter::default())?;
            let is_part = |row: &AttemptRow| {
                serde_json::from_slice::<Document>(&row.document)
                    .is_ok_and(|document| document.season.as_deref() == Some(name))
            };
            rows.into_iter().filter(is_part).collect()
        };
        let stored = self.stored_season(name)?.ok_or_else(|| no_season(name))?;
        let closing = canonical(&Closing {
            name: name.into(),
            closed_ms,
            secret: hex::encode(stored.secret),
            rows: rows.iter().map(|row| (row.number, sha256_hex(&row.document))).collect(),
        })?;
        let head = Head {
            format: FORMAT.into(),
            public_key: self.public_key(),
            season: text(&stored.document)?,
            season_signature: hex::encode(&stored.signature),
            closing_signature: hex::encode(self.0.secrets.sign(&closing)?),
            closing: text(&closing)?,
        };
        write_line(out, &head)?;
        for row in &rows {
            let actions = self.store().actions(&row.id)?.map(|actions| BASE64.encode(actions));
            let (document, signature) = (text(&row.document)?, hex::encode(&row.signature));
            write_line(out, &Line { document, signature, actions })?;
        }
        Ok(rows.len())
    }
}

fn text(bytes: &[u8]) -> Result<String> {
    String::from_utf8(bytes.to_vec()).map_err(|e| Error::Damaged(e.to_string()))
}

fn write_line(out: &mut dyn Write, line: &impl Serialize) -> Result<()> {
    let failed = |e: std::io::Error| Error::Internal(format!("writing the archive: {e}"));
    serde_json::to_writer(&mut *out, line).map_err(|e| failed(e.into()))?;
    out.write_all(b"\n").map_err(failed)
}

/// A season's archive, read.
pub(super) struct Archive {
    opening: Opening,
    attempts: Vec<ArchivedAttempt>,
}

/// An attempt with its actions.
type ArchivedAttempt = (AttemptRow, Option<Vec<u8>>);

impl Archive {
    /// Returns whether a file begins like a season file.
    pub(super) fn is_season_file(path: &Path) -> bool {
        let mut beginning = Vec::new();
        let head = format!("{{\"format\":\"{FORMAT}\"");
        let read = std::fs::File::open(path).and_then(|file| {
            std::io::Read::read_to_end(&mut std::io::Read::take(file, head.len() as u64), &mut beginning)
        });
        read.is_ok() && beginning == head.as_bytes()
    }

    /// # Errors
    /// [`Error::File`]; [`Error::Damaged`] with the line.
    pub(super) fn open(path: &Path) -> Result<Archive> {
        let failed = |problem| Error::File { path: path.to_owned(), problem };
        let file = std::fs::File::open(path).map_err(failed)?;
        Archive::read(std::io::BufReader::new(file))
    }

    /// # Errors
    /// [`Error::Damaged`] with the line: what is no line of an archive, a signature that does not fit, another secret
    /// than was published, an attempt that is missing or more than there were.
    pub(super) fn read(from: impl BufRead) -> Result<Archive> {
        let archive = Archive::read_part(from)?;
        archive.check_complete()?;
        Ok(archive)
    }

    /// Reads like [`Archive::read`], from a file that may lack attempts: the first line and the attempts to be
    /// examined.
    ///
    /// # Errors
    /// The errors of [`Archive::read`], except for missing attempts.
    pub(super) fn read_part(mut from: impl BufRead) -> Result<Archive> {
        let mut number = 0;
        let mut next = move || -> Result<Option<(usize, String)>> {
            let mut line = String::new();
            number += 1;
            let read = from.read_line(&mut line);
            let length = read.map_err(|e| Error::Damaged(format!("archive, line {number}: {e}")))?;
            Ok((length > 0).then_some((number, line)))
        };
        let damaged = |line: usize, what: String| Error::Damaged(format!("archive, line {line}: {what}"));
        let (_, first) = next()?.ok_or_else(|| damaged(1, "it is empty".into()))?;
        let head: Head = serde_json::from_str(&first).map_err(|e| damaged(1, e.to_string()))?;
        if head.format != FORMAT {
            return Err(damaged(1, format!("format is {:?}, expected {FORMAT:?}", head.format)));
        }
        let opening = head.read().map_err(|what| damaged(1, what))?;
        let mut attempts = Vec::new();
        while let Some((number, line)) = next()? {
            let line: Line = serde_json::from_str(&line).map_err(|e| damaged(number, e.to_string()))?;
            attempts.push(line.read().map_err(|what| damaged(number, what))?);
        }
        Ok(Archive { opening, attempts })
    }

    /// The rows are those that were there when it was closed, no fewer and no more.
    fn check_complete(&self) -> Result<()> {
        let listed = &self.opening.listed;
        let hashes: Vec<(i64, String)> =
            self.attempts.iter().map(|(row, _)| (row.number, sha256_hex(&row.document))).collect();
        match listed.iter().find(|row| !hashes.contains(row)) {
            Some((number, _)) => {
                Err(Error::Damaged(format!("archive: attempt number {number} is missing or changed")))
            }
            None if hashes.len() != listed.len() => {
                Err(Error::Damaged("archive: there are attempts that were not listed at the closing".into()))
            }
            None => Ok(()),
        }
    }

    /// A store in which nothing changes, and the keys to verify it.
    pub(super) fn into_store(self) -> Result<(SqlStore<Sqlite>, Secrets)> {
        let Opening { keys, name, season, .. } = self.opening;
        let mut store = SqlStore::new(Sqlite::in_memory()?);
        store.add_season(&name, &season)?;
        for (row, actions) in self.attempts {
            store.begin(Some(&name), &|_| Ok(row.clone()))?;
            store.conclude(&row, actions.as_deref())?;
        }
        store.close_season(&name, season.closed_ms.unwrap_or_default())?;
        store.database.freeze()?;
        Ok((store, keys))
    }
}

/// Contents of an archive's first line, once its signatures are checked.
struct Opening {
    keys: Secrets,
    name: String,
    season: StoredSeason,
    listed: Vec<(i64, String)>,
}

impl Head {
    fn read(&self) -> std::result::Result<Opening, String> {
        let key: [u8; 32] = hex::decode(&self.public_key)
            .ok()
            .and_then(|key| key.try_into().ok())
            .ok_or("public_key: expected 64 hexadecimal digits")?;
        let key = VerifyingKey::from_bytes(&key).map_err(|e| format!("public_key: {e}"))?;
        let closing: Closing = serde_json::from_str(&self.closing).map_err(|e| format!("closing: {e}"))?;
        let secret: [u8; 32] = hex::decode(&closing.secret)
            .ok()
            .and_then(|secret| secret.try_into().ok())
            .ok_or("secret: expected 64 hexadecimal digits")?;
        let keys = Secrets::verifier(key, secret);
        let signature = |text: &str| hex::decode(text).map_err(|e| format!("signature: {e}"));
        let season_signature = signature(&self.season_signature)?;
        if !keys.is_signature_valid(self.closing.as_bytes(), &signature(&self.closing_signature)?) {
            return Err("the signature of the closing does not fit".into());
        }
        if !keys.is_signature_valid(self.season.as_bytes(), &season_signature) {
            return Err("the signature of the season does not fit".into());
        }
        let season: SeasonDocument =
            serde_json::from_str(&self.season).map_err(|e| format!("season: {e}"))?;
        if season.name != closing.name || season.secret_sha256 != sha256_hex(&secret) {
            return Err("the secret is not the one whose hash was published".into());
        }
        let stored = StoredSeason {
            document: self.season.clone().into_bytes(),
            signature: season_signature,
            secret,
            closed_ms: Some(closing.closed_ms),
        };
        Ok(Opening { keys, name: season.name, season: stored, listed: closing.rows })
    }
}

impl Line {
    fn read(self) -> std::result::Result<ArchivedAttempt, String> {
        let document: Document =
            serde_json::from_str(&self.document).map_err(|e| format!("document: {e}"))?;
        let signature = hex::decode(&self.signature).map_err(|e| format!("signature: {e}"))?;
        let actions = self.actions.map(|packed| BASE64.decode(packed)).transpose();
        let actions = actions.map_err(|e| format!("actions: {e}"))?;
        Ok((document.row_with(self.document.into_bytes(), signature), actions))
    }
}
