//! Errors of log files, worded so that the reader of the message can find the place.

use std::fmt;

use thiserror::Error;

use crate::inspect::Finding;

/// Result of reading or writing a log.
pub(crate) type Result<T, E = LogError> = std::result::Result<T, E>;

/// Hint for a file of unknown format, in a program without the formats of single labs.
const LEFT_OUT: &str = if cfg!(feature = "labs") {
    ""
} else {
    "; the formats of single labs are left out: build with the feature labs"
};

/// Why a log could not be read or written. Lines count from 1, the header being line 1.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "each variant's message says what went wrong")]
pub enum LogError {
    #[error("{file}: cannot be read")]
    Io { file: String, source: std::io::Error },
    #[error("{file}: is larger than {limit_mib} MiB after decompression, more than any flight log")]
    TooLarge { file: String, limit_mib: u64 },
    #[error("{file}: has more than {most} rows, more than any flight log")]
    TooManyRows { file: String, most: usize },
    #[error("{file}: the gzip data is damaged ({reason})")]
    BadGzip { file: String, reason: String },
    /// Any other problem, in words.
    #[error("{0}")]
    Unusable(String),
    #[error("{file}: is empty")]
    Empty { file: String },
    #[error("{file}: is no log: neither CSV text nor any binary format that is known")]
    NotText { file: String },
    #[error("{file}, line {line}: is longer than {limit} bytes, more than any row of a flight log")]
    LineTooLong { file: String, line: u64, limit: usize },
    #[error("{file}: has a header but no whole row of data")]
    NoRows { file: String },
    #[error(
        "{file}: the columns belong to no known log format (found: {found}); write a mapping file, which crazyflie inspect drafts{LEFT_OUT}"
    )]
    UnknownFormat { file: String, found: String },
    #[error("{file}: column \"{column}\" appears more than once")]
    DuplicateColumn { file: String, column: String },
    #[error(
        "{file}: read as {format}, it lacks {}; if it is none, write a mapping file, which crazyflie inspect drafts",
        joined(missing, ", ")
    )]
    MissingColumns { file: String, format: &'static str, missing: Vec<MissingColumn> },
    #[error(
        "{file}: {count} of {rows} rows are damaged: the first is line {line} with {found} cells, expected {expected}; up to 1 % would be left out"
    )]
    RaggedRows { file: String, count: usize, rows: usize, line: u64, found: usize, expected: usize },
    #[error(
        "{file}: contains the poses of several bodies; choose one in a mapping file (body = \"...\"): {}",
        bodies.join(", ")
    )]
    SeveralBodies { file: String, bodies: Vec<String> },
    #[error(
        "{file}: no header line: give the names of the columns in a mapping file ([table] columns = [\"t\", \"x\", ...])"
    )]
    NoHeader { file: String },
    #[error("{file}: has {count} flights, expected --part from 1 to {count}, found {wanted}")]
    NoSuchFlight { file: String, wanted: usize, count: usize },
    #[error("{file}, line {line}, column \"{column}\": found \"{value}\", expected {expected}")]
    BadValue { file: String, line: u64, column: String, value: String, expected: &'static str },
    #[error(
        "{file}, line {line}, column \"{column}\": found {value} s after {previous} s, expected a later time"
    )]
    TimeNotIncreasing { file: String, line: u64, column: String, value: f64, previous: f64 },
    #[error("{file}, line {line}: {problem}")]
    BadMapping { file: String, line: u64, problem: String },
    #[error("{file}: is no ROS 2 bag with the tables topics and messages ({reason})")]
    BadDatabase { file: String, reason: String },
    #[error("{file}, byte {byte}: expected {expected}")]
    BadBinary { file: String, byte: usize, expected: &'static str },
    #[error("{file}, topic \"{topic}\", message {index}: expected {expected} ({reason})")]
    BadMessage { file: String, topic: String, index: usize, expected: &'static str, reason: String },
    #[error("{file}: {}\n  --anyway goes on all the same", joined(findings, "\n  "))]
    Grave { file: String, findings: Vec<Finding> },
    #[error("{file}: contains no {missing} (found: {found})")]
    MissingSignals { file: String, missing: &'static str, found: String },
    #[error("the log cannot be written in the project's own form: {channel} {reason}")]
    CannotWrite { channel: String, reason: &'static str },
    #[error("writing the log failed")]
    Write(#[source] csv::Error),
    #[error("writing the log failed")]
    WriteMcap(#[source] std::io::Error),
}

/// A column that the format needs and the file lacks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MissingColumn {
    /// Name in the format's spelling; alternatives are joined by "or".
    pub name: String,
    /// A column of the file with a similar name that the format does not know.
    pub did_you_mean: Option<String>,
}

impl fmt::Display for MissingColumn {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{}\"", self.name)?;
        match &self.did_you_mean {
            Some(found) => write!(f, " (did you mean that by \"{found}\"?)"),
            None => Ok(()),
        }
    }
}

fn joined(items: &[impl fmt::Display], separator: &str) -> String {
    items.iter().map(ToString::to_string).collect::<Vec<_>>().join(separator)
}
