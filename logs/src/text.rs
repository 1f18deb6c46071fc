//! From the bytes of a file to whole lines of text.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;

use flate2::read::MultiGzDecoder;

use super::{LogError, Note};

/// A two-hour flight at 100 Hz with 60 columns is about 400 MB; beyond that it is not a flight log.
const LIMIT_MIB: u64 = 512;
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];

/// Reads the file at `path`, refusing more than [`LIMIT_MIB`].
pub(super) fn load(path: &Path, file: &str) -> Result<Vec<u8>, LogError> {
    let io = |source| LogError::Io { file: file.to_owned(), source };
    let mut bytes = Vec::new();
    let handle = File::open(path).map_err(io)?;
    handle.take((LIMIT_MIB << 20) + 1).read_to_end(&mut bytes).map_err(io)?;
    within_limit(file, bytes)
}

/// Unpacks gzip, known by its magic bytes, and leaves anything else as it is. A truncated stream gives what
/// it holds.
pub(super) fn decompress(file: &str, bytes: &[u8], notes: &mut Vec<Note>) -> Result<Vec<u8>, LogError> {
    if !bytes.starts_with(&GZIP_MAGIC) {
        return Ok(bytes.to_vec());
    }
    let mut text = Vec::new();
    let mut source = MultiGzDecoder::new(bytes).take((LIMIT_MIB << 20) + 1);
    let mut block = vec![0_u8; 1 << 16];
    loop {
        match source.read(&mut block) {
            Ok(0) => break,
            Ok(count) => text.extend_from_slice(&block[..count]),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
                notes.push(Note::TruncatedGzip);
                break;
            }
            Err(error) => {
                return Err(LogError::BadGzip { file: file.to_owned(), reason: error.to_string() });
            }
        }
    }
    within_limit(file, text)
}

fn within_limit(file: &str, bytes: Vec<u8>) -> Result<Vec<u8>, LogError> {
    if bytes.len() as u64 > LIMIT_MIB << 20 {
        return Err(LogError::TooLarge { file: file.to_owned(), limit_mib: LIMIT_MIB });
    }
    Ok(bytes)
}

/// The part of `text` that consists of whole lines: a line is whole when its line end is there, since
/// otherwise its last number may be cut short without a trace.
pub(super) fn whole_lines<'a>(text: &'a [u8], notes: &mut Vec<Note>) -> &'a [u8] {
    let end = text.iter().rposition(|b| matches!(b, b'\n' | b'\r')).map_or(0, |at| at + 1);
    if text[end..].iter().any(|b| !b.is_ascii_whitespace()) {
        let line = text[..end].iter().filter(|b| **b == b'\n').count() as u64 + 1;
        notes.push(Note::PartialLastLine { line });
    }
    &text[..end]
}
