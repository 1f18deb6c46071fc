//! The file of a database while it is open: still there, and with a write-ahead log that can be read to its end.
//! SQLite notices neither: it goes on in a file that was removed, and reads a damaged log up to the damage.

use std::cell::Cell;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use super::error::{Error, Result};

/// Bytes before the first frame of a log, and before the page of each frame (SQLite's file format, section 4).
const HEADER: usize = 32;
const FRAME_HEADER: usize = 24;

/// The files of an open database.
pub(super) struct DatabaseFile {
    path: PathBuf,
    log: PathBuf,
    id: Option<FileId>,
    /// None until there is one.
    log_id: Cell<Option<FileId>>,
}

/// Tells a file from one that took its place.
type FileId = (u64, u64);

fn file_id(path: &Path) -> Option<FileId> {
    let stat = path.metadata().ok()?;
    #[cfg(unix)]
    return Some((std::os::unix::fs::MetadataExt::dev(&stat), std::os::unix::fs::MetadataExt::ino(&stat)));
    #[cfg(not(unix))]
    return Some((u64::from(stat.is_file()), 0));
}

fn log_of(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push("-wal");
    name.into()
}

impl DatabaseFile {
    pub(super) fn new(path: &Path) -> Self {
        let log = log_of(path);
        DatabaseFile { id: file_id(path), log_id: Cell::new(None), path: path.to_owned(), log }
    }

    /// Looks whether the files are those that were opened.
    ///
    /// # Errors
    /// [`Error::Gone`].
    pub(super) fn check(&self) -> Result<()> {
        if file_id(&self.path) != self.id {
            return Err(Error::Gone { path: self.path.clone() });
        }
        let log_id = file_id(&self.log);
        if self.log_id.get().is_some() && log_id != self.log_id.get() {
            return Err(Error::Gone { path: self.log.clone() });
        }
        self.log_id.set(log_id);
        Ok(())
    }
}

/// Looks whether all transactions of a log can be read, before SQLite opens it and cuts it off.
///
/// # Errors
/// [`Error::DamagedLog`].
pub(super) fn check_log(database: &Path) -> Result<()> {
    let path = log_of(database);
    let damaged = || std::fs::read(&path).ok().and_then(|log| damaged_frame(&log));
    let Some(frame) = damaged() else { return Ok(()) };
    // another process may have begun the log anew while it was read
    std::thread::sleep(std::time::Duration::from_millis(100));
    match damaged() {
        Some(again) if again == frame => Err(Error::DamagedLog { path, frame }),
        _ => Ok(()),
    }
}

/// The first frame that does not fit its checksum, counted from 1, if a later one ends a transaction. After a loss of
/// power the last transaction may be there in part; it was not acknowledged.
fn damaged_frame(log: &[u8]) -> Option<usize> {
    let word = |bytes: &[u8], at: usize| Some(u32::from_be_bytes(*bytes.get(at..at + 4)?.as_array()?));
    let big_endian = word(log, 0)? & 1 == 1;
    let page = usize::try_from(word(log, 8)?).ok().filter(|page| (512..=65536).contains(page))?;
    let salt = log.get(16..24)?;
    let mut sum = checksum([0; 2], log.get(..24)?, big_endian);
    let mut first = ([word(log, 24)?, word(log, 28)?] != sum).then_some(0);
    let frames = log.get(HEADER..)?.chunks_exact(FRAME_HEADER + page).enumerate();
    for (at, frame) in frames.take_while(|(_, frame)| frame[8..16] == *salt) {
        sum = checksum(checksum(sum, &frame[..8], big_endian), &frame[FRAME_HEADER..], big_endian);
        let fits = [word(frame, 16)?, word(frame, 20)?] == sum;
        match first {
            // the next checksums continue this one
            None if !fits => first = Some(at + 1),
            Some(first) if word(frame, 4)? != 0 => return Some(first),
            _ => {}
        }
    }
    None
}

fn checksum(sum: [u32; 2], bytes: &[u8], big_endian: bool) -> [u32; 2] {
    bytes.as_chunks::<8>().0.iter().fold(sum, |[mut a, mut b], eight| {
        let [x, y] = [0, 4].map(|at| {
            let four = [eight[at], eight[at + 1], eight[at + 2], eight[at + 3]];
            if big_endian { u32::from_be_bytes(four) } else { u32::from_le_bytes(four) }
        });
        a = a.wrapping_add(x).wrapping_add(b);
        b = b.wrapping_add(y).wrapping_add(a);
        [a, b]
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::damaged_frame;

    proptest! {
        #[test]
        fn any_bytes_are_read(
            mut log in prop::collection::vec(any::<u8>(), 0..3000),
            page in prop::sample::select(vec![0, 512, 1024, 65_536, u32::MAX]),
        ) {
            if log.len() >= 12 {
                log[8..12].copy_from_slice(&page.to_be_bytes());
            }
            let _ = damaged_frame(&log);
        }
    }
}
