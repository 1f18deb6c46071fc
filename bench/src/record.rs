//! Stored form of an attempt: one signed JSON document, and the actions.

use std::io::{Read, Write};

use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use serde::{Deserialize, Serialize};

use super::error::{Error, Result};
use super::metrics::{EpisodeMetrics, Metrics};
use super::score::Score;
use super::secrets::{Secrets, canonical};

/// Progress of an attempt.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    Running,
    /// Its client went away, or took too long. It stays listed.
    Abandoned,
    Finished,
}

impl Status {
    pub fn name(self) -> &'static str {
        match self {
            Status::Running => "running",
            Status::Abandoned => "abandoned",
            Status::Finished => "finished",
        }
    }
}

/// An attempt as it is signed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Document {
    /// Counted up without gaps, so that a row that was taken away is missed.
    pub number: i64,
    /// Random name of the attempt, in hex.
    pub id: String,
    /// Scenario as `name@version`.
    pub scenario: String,
    pub(crate) scenario_hash: String,
    /// Fingerprint of the program's sources.
    pub build: String,
    /// Owner of the token, or "local".
    pub team: String,
    /// Name under which it was submitted.
    pub controller: String,
    /// Milliseconds since 1970, UTC.
    pub begun_ms: i64,
    /// Season that it is part of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub season: Option<String>,
    /// Progress when it was signed.
    pub status: Status,
    /// Score and flights, of a finished attempt alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub result: Option<AttemptResult>,
}

/// Result of a finished attempt.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AttemptResult {
    pub finished_ms: i64,
    pub ticks: usize,
    /// Hash of the actions as they are stored, compressed.
    pub actions_sha256: String,
    pub score: Score,
    pub metrics: Metrics,
    pub episodes: Vec<EpisodeResult>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeResult {
    pub score: f64,
    /// SHA-256 over the true states of all ticks.
    pub states_sha256: String,
    #[serde(flatten)]
    pub metrics: EpisodeMetrics,
}

/// A row of the database, as it was found there. Columns besides the document are for searching; they contain only
/// values of the document.
#[derive(Debug, Clone)]
pub(crate) struct AttemptRow {
    pub number: i64,
    pub id: String,
    pub scenario: String,
    pub team: String,
    pub controller: String,
    pub begun_ms: i64,
    pub status: String,
    pub document: Vec<u8>,
    pub signature: Vec<u8>,
}

impl Document {
    /// The signed row for the database.
    pub(super) fn to_row(&self, secrets: &Secrets) -> Result<AttemptRow> {
        let document = canonical(self)?;
        let signature = secrets.sign(&document)?.to_vec();
        Ok(self.row_with(document, signature))
    }

    /// The row of this document, with its bytes as they were signed.
    pub(super) fn row_with(&self, document: Vec<u8>, signature: Vec<u8>) -> AttemptRow {
        AttemptRow {
            number: self.number,
            id: self.id.clone(),
            scenario: self.scenario.clone(),
            team: self.team.clone(),
            controller: self.controller.clone(),
            begun_ms: self.begun_ms,
            status: self.status.name().into(),
            document,
            signature,
        }
    }
}

impl AttemptRow {
    /// The document, if it is signed and the columns agree with it.
    ///
    /// # Errors
    /// [`Error::Damaged`] names the mismatch.
    pub(super) fn document(&self, secrets: &Secrets) -> Result<Document> {
        let damaged = |what: &str| Error::Damaged(format!("attempt {:?}: {what}", self.id));
        if !secrets.is_signature_valid(&self.document, &self.signature) {
            return Err(damaged("the signature does not fit the document"));
        }
        let document: Document =
            serde_json::from_slice(&self.document).map_err(|e| damaged(&format!("document: {e}")))?;
        let columns = [
            ("number", self.number == document.number),
            ("id", self.id == document.id),
            ("scenario", self.scenario == document.scenario),
            ("team", self.team == document.team),
            ("controller", self.controller == document.controller),
            ("begun_ms", self.begun_ms == document.begun_ms),
            ("status", self.status == document.status.name()),
        ];
        match columns.iter().find(|(_, same)| !same) {
            Some((column, _)) => {
                Err(damaged(&format!("the column {column} differs from the signed document")))
            }
            None => Ok(document),
        }
    }
}

/// Actions as they are stored: little-endian f32, compressed.
pub(super) fn pack(actions: &[f32]) -> Result<Vec<u8>> {
    let failed = |e: std::io::Error| Error::Internal(format!("compressing actions: {e}"));
    let mut out = ZlibEncoder::new(Vec::new(), Compression::default());
    let bytes: Vec<u8> = actions.iter().flat_map(|a| a.to_le_bytes()).collect();
    out.write_all(&bytes).map_err(failed)?;
    out.finish().map_err(failed)
}

/// The bytes of so many actions.
///
/// # Errors
/// [`Error::Damaged`] if there are more, fewer, or none that can be read.
pub(super) fn unpack(packed: &[u8], numbers: usize) -> Result<Vec<u8>> {
    let damaged = |what: String| Error::Damaged(format!("actions: {what}"));
    let mut bytes = Vec::new();
    let limit = numbers as u64 * 4 + 1;
    ZlibDecoder::new(packed).take(limit).read_to_end(&mut bytes).map_err(|e| damaged(e.to_string()))?;
    if bytes.len() != numbers * 4 {
        return Err(damaged(format!("{} bytes, expected {}", bytes.len(), numbers * 4)));
    }
    Ok(bytes)
}

/// Bytes as numbers.
pub(super) fn numbers(bytes: &[u8]) -> Vec<f32> {
    let (all, _) = bytes.as_chunks::<4>();
    all.iter().map(|b| f32::from_le_bytes(*b)).collect()
}
