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
    #[error("{file}: the zip archive cannot be read ({reason})")]
    BadZip { file: String, reason: String },
    #[error("{file}: has {count} files, expected the files of one flight, at most {most}")]
    TooManyFiles { file: String, count: usize, most: usize },
    #[error("several recordings of one flight cannot be joined, only tables: name one of {}", files.join(", "))]
    SeveralRecordings { files: Vec<String> },
    #[error("{file}: is empty")]
    Empty { file: String },
    #[error("{file}: is no log: neither CSV text nor any binary format that is known")]
    NotText { file: String },
    #[error("{file}, line {line}: is longer than {limit} bytes, more than any row of a flight log")]
    LineTooLong { file: String, line: u64, limit: usize },
    #[error("{file}: has a header but no whole row of data")]
    NoRows { file: String },
    #[error(
        "{file}: the columns belong to no known log format (found: {found}); a mapping file can tell, and crazyflie inspect drafts one{LEFT_OUT}"
    )]
    UnknownFormat { file: String, found: String },
    #[error("{file}: column \"{column}\" appears more than once")]
    DuplicateColumn { file: String, column: String },
    #[error(
        "{file}: read as {format}, it lacks {}; if it is none, a mapping file can tell, and crazyflie inspect drafts one",
        joined(missing, ", ")
    )]
    MissingColumns { file: String, format: &'static str, missing: Vec<MissingColumn> },
    #[error(
        "{file}, line {line}: the rows have {cells} cells, the line of names has {names}; if another line holds the names, say it in a mapping file ([table] header_line = N){}",
        decimal_commas(*names, *cells)
    )]
    ColumnCount { file: String, line: u64, names: usize, cells: usize },
    #[error(
        "{file}: {count} of {rows} rows are damaged: the first is line {line} with {found} cells, expected {expected}; up to 1 % would be left out"
    )]
    RaggedRows { file: String, count: usize, rows: usize, line: u64, found: usize, expected: usize },
    #[error(
        "{file}: holds the poses of several bodies; choose one in a mapping file (body = \"...\"): {}",
        bodies.join(", ")
    )]
    SeveralBodies { file: String, bodies: Vec<String> },
    #[error("{file}: has no line {line}, which the mapping file says holds the names of the columns")]
    NoHeaderLine { file: String, line: u64 },
    #[error(
        "{file}: no header line: give the names of the columns in a mapping file ([table] columns = [\"t\", \"x\", ...])"
    )]
    NoHeader { file: String },
    #[error(
        "{file}: no time column: name it in a mapping file ([time] column = \"...\"), or give the rate of the rows ([time] rate_hz = ...)"
    )]
    NoTime { file: String },
    #[error(
        "{file}: {repeats} of {rows} stamps in \"{column}\" repeat the one before, as they do when times are stored with too few digits (float32): store them as float64, or give the rate of the rows in a mapping file ([time] rate_hz = ...)"
    )]
    StampsRepeat { file: String, column: String, repeats: usize, rows: usize },
    #[error("{file}: has {count} flights, expected --part from 1 to {count}, found {wanted}")]
    NoSuchFlight { file: String, wanted: usize, count: usize },
    #[error(
        "{file} and {other} are not one flight: their clocks run from {} to {} s and from {} to {} s",
        span_s[0], span_s[1], other_span_s[0], other_span_s[1]
    )]
    ClocksApart { file: String, span_s: [f64; 2], other: String, other_span_s: [f64; 2] },
    #[error("{file}, line {line}, column \"{column}\": found \"{value}\", expected {expected}")]
    BadValue { file: String, line: u64, column: String, value: String, expected: &'static str },
    #[error(
        "{file}, line {line}, column \"{column}\": found {value} s after {previous} s, expected a later time"
    )]
    TimeNotIncreasing { file: String, line: u64, column: String, value: f64, previous: f64 },
    #[error("{file}, line {line}: {problem}")]
    BadMapping { file: String, line: u64, problem: String },
    #[error(
        "{file}: has no column \"{column}\", which {mapping} maps to {channel}{}",
        proposal(did_you_mean)
    )]
    UnmappedColumn {
        file: String,
        column: String,
        mapping: String,
        channel: String,
        did_you_mean: Option<String>,
    },
    #[error("{file}: is no ROS 2 bag with the tables topics and messages ({reason})")]
    BadDatabase { file: String, reason: String },
    #[error("{file}, byte {byte}: expected {expected}")]
    BadBinary { file: String, byte: usize, expected: &'static str },
    #[error("{file}, \"{source_name}\", record {index}: found {value}, expected {expected}")]
    BadRecord { file: String, source_name: String, index: usize, value: String, expected: &'static str },
    #[error("{file}, topic \"{topic}\", message {index}: expected {expected} ({reason})")]
    BadMessage { file: String, topic: String, index: usize, expected: &'static str, reason: String },
    #[error("{file}: {}\n  --anyway goes on all the same", joined(findings, "\n  "))]
    Grave { file: String, findings: Vec<Finding> },
    #[error("{file}: holds no {missing} (found: {found})")]
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

/// The usual reason of twice as many cells as names.
fn decimal_commas(names: usize, cells: usize) -> &'static str {
    if cells + 1 >= 2 * names {
        "; decimal commas beside separating commas cannot be told apart: store the numbers with points"
    } else {
        ""
    }
}

fn proposal(did_you_mean: &Option<String>) -> String {
    did_you_mean.as_ref().map_or(String::new(), |name| format!(" (did you mean \"{name}\"?)"))
}

fn joined(items: &[impl fmt::Display], separator: &str) -> String {
    items.iter().map(ToString::to_string).collect::<Vec<_>>().join(separator)
}
