//! From the bytes of a file to whole lines of text.

use std::borrow::Cow;
use std::fs::File;
use std::io::{Cursor, ErrorKind, Read};
use std::path::{Path, PathBuf};

use encoding_rs::{Encoding, UTF_8, UTF_16BE, UTF_16LE, WINDOWS_1252};
use flate2::read::MultiGzDecoder;
use zip::ZipArchive;

use super::{LogError, Note, Result};

/// A two-hour flight at 100 Hz with 60 columns is about 400 MB; beyond that it is not a flight log.
pub(super) const LIMIT_MIB: u64 = 512;
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
const ZIP_MAGIC: &[u8] = b"PK\x03\x04";
/// Files of one flight; an archive of more is something else.
const MOST_FILES: usize = 64;
/// Text without a mark is taken for UTF-16 where so large a share of every second byte is zero.
const ZERO_SHARE: f64 = 0.4;

/// A file, unpacked, with the name used in errors.
#[derive(Debug)]
pub(super) struct NamedFile {
    pub(super) name: String,
    pub(super) bytes: Vec<u8>,
}

/// The files that a path names, unpacked, and their paths.
pub(super) fn load_all(
    path: &Path,
    limit_mib: u64,
    notes: &mut Vec<Note>,
) -> Result<(Vec<NamedFile>, Vec<PathBuf>)> {
    let paths = paths(path)?;
    let mut files = Vec::new();
    for path in &paths {
        let file = path.display().to_string();
        files.extend(unpack(&file, &load(path, &file, limit_mib)?, limit_mib, notes)?);
    }
    Ok((files, paths))
}

/// Returns the files that a path names: one, several with a plus between them, or those of a folder. In a folder with
/// a recording of ROS 2, only the recording.
fn paths(path: &Path) -> Result<Vec<PathBuf>> {
    if path.is_dir() {
        return folder(path);
    }
    let name = path.to_string_lossy();
    if path.exists() || !name.contains('+') {
        return Ok(vec![path.to_owned()]);
    }
    Ok(name.split('+').map(PathBuf::from).collect())
}

fn folder(path: &Path) -> Result<Vec<PathBuf>> {
    let file = path.display().to_string();
    let io = |source| LogError::Io { file: file.clone(), source };
    let entries = std::fs::read_dir(path).map_err(io)?.collect::<Result<Vec<_>, _>>().map_err(io)?;
    let mut files: Vec<PathBuf> =
        entries.into_iter().map(|entry| entry.path()).filter(|path| path.is_file()).collect();
    let ends = |path: &PathBuf, names: &[&str]| {
        path.extension().is_some_and(|found| names.iter().any(|name| found.eq_ignore_ascii_case(name)))
    };
    if files.iter().any(|path| path.file_name().is_some_and(|name| name == "metadata.yaml")) {
        files.retain(|path| ends(path, &["db3", "mcap"]));
    } else {
        files.retain(|path| ends(path, &["csv", "tsv", "txt", "gz", "log", "zip", "npz"]));
    }
    files.sort();
    match files.len() {
        0 => Err(LogError::Empty { file }),
        1..=MOST_FILES => Ok(files),
        count => Err(LogError::Unusable(format!(
            "{file}: has {count} files, expected the files of one flight, at most {MOST_FILES}"
        ))),
    }
}

/// Reads the file at `path`, refusing more than the limit.
pub(super) fn load(path: &Path, file: &str, limit_mib: u64) -> Result<Vec<u8>> {
    let io = |source| LogError::Io { file: file.to_owned(), source };
    let mut bytes = Vec::new();
    let handle = File::open(path).map_err(io)?;
    handle.take((limit_mib << 20) + 1).read_to_end(&mut bytes).map_err(io)?;
    within_limit(file, bytes, limit_mib)
}

/// Unpacks gzip and zip, known by their magic bytes, and leaves anything else as it is. A truncated stream gives its
/// readable part; an archive every file.
pub(super) fn unpack(
    file: &str,
    bytes: &[u8],
    limit_mib: u64,
    notes: &mut Vec<Note>,
) -> Result<Vec<NamedFile>> {
    if bytes.starts_with(ZIP_MAGIC) && !is_npz(bytes) {
        return unzip(file, bytes, limit_mib);
    }
    let bytes = if bytes.starts_with(&GZIP_MAGIC) {
        decompress(file, bytes, limit_mib, notes)?
    } else {
        within_limit(file, bytes.to_vec(), limit_mib)?
    };
    Ok(vec![NamedFile { name: file.to_owned(), bytes }])
}

/// Arrays of numpy are stored as an archive whose files are named so; its reader unpacks it.
pub(super) fn is_npz(bytes: &[u8]) -> bool {
    bytes.starts_with(ZIP_MAGIC)
        && ZipArchive::new(Cursor::new(bytes))
            .is_ok_and(|zip| !zip.is_empty() && zip.file_names().all(|name| name.ends_with(".npy")))
}

fn decompress(file: &str, bytes: &[u8], limit_mib: u64, notes: &mut Vec<Note>) -> Result<Vec<u8>> {
    let mut text = Vec::new();
    match MultiGzDecoder::new(bytes).take((limit_mib << 20) + 1).read_to_end(&mut text) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => notes.push(Note::TruncatedGzip),
        Err(error) => return Err(LogError::BadGzip { file: file.to_owned(), reason: error.to_string() }),
        Ok(_) => {}
    }
    within_limit(file, text, limit_mib)
}

/// The files of an archive, by name; hidden ones and folders aside.
pub(super) fn unzip(file: &str, bytes: &[u8], limit_mib: u64) -> Result<Vec<NamedFile>> {
    let bad =
        |reason: String| LogError::Unusable(format!("{file}: the zip archive cannot be read ({reason})"));
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(|error| bad(error.to_string()))?;
    if archive.len() > MOST_FILES {
        return Err(bad(format!("{} files in it, expected at most {MOST_FILES}", archive.len())));
    }
    let (mut files, mut left) = (Vec::new(), limit_mib << 20);
    for at in 0..archive.len() {
        let mut entry = archive.by_index(at).map_err(|error| bad(error.to_string()))?;
        let name = entry.name().to_owned();
        let is_hidden = name.split('/').any(|part| part.starts_with('.') || part == "__MACOSX");
        if entry.is_dir() || is_hidden {
            continue;
        }
        let mut content = Vec::new();
        (&mut entry).take(left + 1).read_to_end(&mut content).map_err(|error| bad(error.to_string()))?;
        let size = content.len() as u64;
        left =
            left.checked_sub(size).ok_or_else(|| LogError::TooLarge { file: file.to_owned(), limit_mib })?;
        files.push(NamedFile { name: format!("{file}/{name}"), bytes: content });
    }
    files.sort_by(|a, b| a.name.cmp(&b.name));
    if files.is_empty() {
        return Err(LogError::Empty { file: file.to_owned() });
    }
    Ok(files)
}

fn within_limit(file: &str, bytes: Vec<u8>, limit_mib: u64) -> Result<Vec<u8>> {
    if bytes.len() as u64 > limit_mib << 20 {
        return Err(LogError::TooLarge { file: file.to_owned(), limit_mib });
    }
    Ok(bytes)
}

/// The bytes as text: by the mark at their start, else UTF-8, else what Windows wrote before it.
pub(super) fn decode<'a>(bytes: &'a [u8], notes: &mut Vec<Note>) -> Cow<'a, str> {
    let (encoding, mark) = Encoding::for_bom(bytes).unwrap_or_else(|| (unmarked(bytes), 0));
    if encoding != UTF_8 {
        notes.push(Note::Decoded { encoding: encoding.name() });
    }
    encoding.decode_without_bom_handling(&bytes[mark..]).0
}

fn unmarked(bytes: &[u8]) -> &'static Encoding {
    let sample = &bytes[..bytes.len().min(4096) & !1];
    let zeros = |from: usize| sample.iter().skip(from).step_by(2).filter(|byte| **byte == 0).count();
    let (even, odd) = (zeros(0), zeros(1));
    let most = ZERO_SHARE * sample.len() as f64 / 2.0;
    match std::str::from_utf8(bytes) {
        _ if !sample.is_empty() && odd as f64 > most && even == 0 => UTF_16LE,
        _ if !sample.is_empty() && even as f64 > most && odd == 0 => UTF_16BE,
        Ok(_) => UTF_8,
        Err(_) => WINDOWS_1252,
    }
}

/// The part of `text` that consists of whole lines: a line is whole when its line end is there, since
/// otherwise its last number may be cut short without a trace.
pub(super) fn whole_lines<'a>(text: &'a str, notes: &mut Vec<Note>) -> &'a str {
    let end = text.rfind(['\n', '\r']).map_or(0, |at| at + 1);
    if !text[end..].trim().is_empty() {
        let line = text[..end].bytes().filter(|b| *b == b'\n').count() as u64 + 1;
        notes.push(Note::PartialLastLine { line });
    }
    &text[..end]
}
