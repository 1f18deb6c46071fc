//! The trait of file formats, the choice among them, and the flight of files.

use std::path::{Path, PathBuf};

use crate::clock::choose_flight;
use crate::columns::{LEAST_SHARE, Layout};
use crate::formats::{mapped, readers};
use crate::front::read_table;
use crate::inspect::Grade;
use crate::join::join;
use crate::table::Table;
use crate::text::{self, NamedFile};
use crate::{Columns, FlightLog, LogError, Mapping, Note, Provenance, Result, npz};

/// A file format. Adding one is a file in `formats/` and its line in the registry there.
pub struct Reader {
    /// Name in reports, and of the folder of its fuzz corpus.
    pub name: &'static str,
    /// The format in words, such as "a NanoBench CSV".
    pub title: &'static str,
    /// The bytes that a file of this format begins with; empty for text.
    pub(crate) magic: &'static [u8],
    /// Share of the format's marks among the column names of a text: 0 for another format, 1 for all.
    pub(crate) share: fn(&[String]) -> f64,
    /// The columns of a text format that is known by them, which are checked before it is read.
    pub(crate) layout: Option<&'static Layout>,
    /// Reads a file of this format.
    pub(crate) read: fn(&Content<'_>, Vec<Note>) -> Result<FlightLog>,
    /// The columns of a binary file by name, for a mapping; `None` for text, whose table has them.
    pub(crate) columns: fn(&Content<'_>, &mut Vec<Note>) -> Result<Option<Columns>>,
}

impl Reader {
    /// A text without marks of its own, on which others build.
    pub(crate) const TEXT: Reader = Reader {
        name: "",
        title: "",
        magic: &[],
        share: |_| 0.0,
        layout: None,
        read: |content, _| Err(unknown(content.table()?)),
        columns: |_, _| Ok(None),
    };
}

/// The content of a log, unpacked.
pub struct Content<'a> {
    /// The name used in errors.
    pub(crate) file: &'a str,
    pub(crate) bytes: &'a [u8],
    table: Option<Table>,
    /// The mapping that was given for it, with its name in errors.
    pub(crate) mapping: Option<&'a NamedMapping>,
    /// The most MiB that its chunks unpack to.
    pub(crate) limit_mib: u64,
    /// The wanted flight of several, from 1.
    pub(crate) part: Option<usize>,
}

/// A mapping, with its name in errors.
pub(crate) type NamedMapping = (String, Mapping);

impl Content<'_> {
    /// The table of a text.
    pub(crate) fn table(&self) -> Result<&Table> {
        self.table.as_ref().ok_or_else(|| LogError::NotText { file: self.file.to_owned() })
    }
}

/// Options for opening a log.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ReadOptions {
    /// Mapping file; the one beside the log unless given, see [`Mapping::path_beside`].
    pub mapping: Option<PathBuf>,
    /// Number of a flight in a file of several, from 1; the first unless given.
    pub part: Option<usize>,
    /// True to open a log with grave findings.
    pub anyway: bool,
    /// Most MiB after decompression; 512 unless given.
    pub limit_mib: Option<u64>,
}

impl ReadOptions {
    fn limit_mib(&self) -> u64 {
        self.limit_mib.unwrap_or(text::LIMIT_MIB)
    }
}

impl FlightLog {
    /// Reads a log of any of the formats of [`readers`](crate::readers), packed (gzip, zip) or not; a mapping
    /// file beside it is used, see [`Mapping::path_beside`]. Several files of one flight are named as
    /// `a.csv+b.csv`, or by their folder.
    ///
    /// # Errors
    /// [`LogError`] names the file and, where there is one, the line, the column, the value and what was
    /// expected.
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_with(path, &ReadOptions::default())
    }

    /// Reads a log by a mapping file, or another than the first flight of a file.
    ///
    /// # Errors
    /// The errors of [`FlightLog::read`], and for the mapping those of [`Mapping::read`].
    pub fn read_with(path: &Path, options: &ReadOptions) -> Result<Self> {
        let mut notes = Vec::new();
        let (files, paths) = text::load_all(path, options.limit_mib(), &mut notes)?;
        let beside = || paths.first().and_then(|path| Mapping::path_beside(path));
        let mapping = options.mapping.clone().or_else(beside);
        let mapping =
            mapping.map(|path| Ok((path.display().to_string(), Mapping::read(&path)?))).transpose()?;
        read(&files, mapping.as_ref(), options, notes)
    }

    /// Opens a log for a computation: one with grave findings is refused, unless the options allow it.
    ///
    /// # Errors
    /// The errors of [`FlightLog::read_with`], and [`LogError::Grave`] with the remedies.
    pub fn open(path: &Path, options: &ReadOptions) -> Result<Self> {
        Self::read_with(path, options)?.unless_grave(&path.display().to_string(), options)
    }

    /// Opens a log from the bytes of a file; `file` is the name used in errors. A mapping file is not read.
    ///
    /// # Errors
    /// The errors of [`FlightLog::open`].
    pub fn open_bytes(file: &str, bytes: &[u8], options: &ReadOptions) -> Result<Self> {
        let mut notes = Vec::new();
        let files = text::unpack(file, bytes, options.limit_mib(), &mut notes)?;
        read(&files, None, options, notes)?.unless_grave(file, options)
    }

    fn unless_grave(self, file: &str, options: &ReadOptions) -> Result<Self> {
        if options.anyway {
            return Ok(self);
        }
        let mut findings = self.findings();
        findings.retain(|finding| finding.grade == Grade::Grave);
        if findings.is_empty() { Ok(self) } else { Err(LogError::Grave { file: file.to_owned(), findings }) }
    }

    /// Reads a log from the bytes of a file; `file` is the name used in errors.
    ///
    /// # Errors
    /// The errors of [`FlightLog::read`].
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self> {
        Self::open_bytes(file, bytes, &ReadOptions { anyway: true, ..ReadOptions::default() })
    }

    /// Reads a log from the bytes of a file by a mapping.
    ///
    /// # Errors
    /// The errors of [`FlightLog::read`].
    pub fn from_mapped_bytes(file: &str, bytes: &[u8], mapping: Mapping) -> Result<Self> {
        Self::from_files(&text::unpack(file, bytes, text::LIMIT_MIB, &mut Vec::new())?, mapping)
    }

    pub(crate) fn from_files(files: &[NamedFile], mapping: Mapping) -> Result<Self> {
        read(files, Some(&("the mapping".to_owned(), mapping)), &ReadOptions::default(), Vec::new())
    }
}

/// Reads the flight of one file, or of several whose tables are joined, corrected by the mapping.
fn read(
    files: &[NamedFile],
    mapping: Option<&NamedMapping>,
    options: &ReadOptions,
    notes: Vec<Note>,
) -> Result<FlightLog> {
    let mut log = read_unscaled(files, mapping, options, notes)?;
    for (channel, factor) in mapping.iter().flat_map(|(_, mapping)| &mapping.scale) {
        log.scale(channel, *factor);
    }
    Ok(log)
}

fn read_unscaled(
    files: &[NamedFile],
    mapping: Option<&NamedMapping>,
    options: &ReadOptions,
    mut notes: Vec<Note>,
) -> Result<FlightLog> {
    let [NamedFile { name: file, bytes }, ..] = files else {
        return Err(LogError::Empty { file: String::new() });
    };
    let binary = binary_reader(bytes);
    if let Some(reader) = binary {
        if files.len() > 1 {
            let names: Vec<&str> = files.iter().map(|file| file.name.as_str()).collect();
            return Err(LogError::Unusable(format!(
                "several recordings of one flight cannot be joined, only tables: name one of {}",
                names.join(", ")
            )));
        }
        let (limit_mib, part) = (options.limit_mib(), options.part);
        let content = Content { file, bytes, table: None, mapping, limit_mib, part };
        let log = read_as(reader, &content, notes)?;
        // a format that does not look for several flights has one
        let has_several = log.notes.iter().any(|note| matches!(note, Note::Flights { .. }));
        return if has_several {
            Ok(log)
        } else {
            choose_flight(file, 1, options.part, &mut Vec::new()).map(|_| log)
        };
    }
    let table = text_table(files, mapping.map(|(_, mapping)| mapping), options, &mut notes)?;
    let best = best_reader(&table.header);
    let file = table.file.clone();
    let (limit_mib, part) = (options.limit_mib(), options.part);
    let content = Content { file: &file, bytes, table: Some(table), mapping, limit_mib, part };
    match best {
        _ if maps(mapping) => mapped::read(&content, None, notes),
        Some(reader) => read_as(reader, &content, notes),
        None => Err(unknown(content.table()?)),
    }
}

/// The table of a text file, or those of several files, on its clock.
pub(crate) fn text_table(
    files: &[NamedFile],
    mapping: Option<&Mapping>,
    options: &ReadOptions,
    notes: &mut Vec<Note>,
) -> Result<Table> {
    let (layout, time) =
        mapping.map(|mapping| (mapping.layout.clone(), mapping.time.clone())).unwrap_or_default();
    let mut tables = Vec::new();
    for NamedFile { name, bytes } in files {
        let mut table = if text::is_npz(bytes) {
            npz::table(name, bytes, options.limit_mib(), notes)?
        } else {
            read_table(name, bytes, &layout, notes)?
        };
        table.set_clock(&time, options.part, notes)?;
        tables.push(table);
    }
    if tables.len() == 1 { Ok(tables.remove(0)) } else { join(tables, notes) }
}

fn read_as(reader: &'static Reader, content: &Content<'_>, mut notes: Vec<Note>) -> Result<FlightLog> {
    if maps(content.mapping)
        && let Some(columns) = (reader.columns)(content, &mut notes)?
    {
        return mapped::read(content, Some(columns), notes);
    }
    if let Some(layout) = reader.layout {
        layout.check(reader.title, content.table()?, &mut notes)?;
    }
    (reader.read)(content, notes)
}

/// Returns whether a mapping names channels, and not only the layout of the table.
fn maps(mapping: Option<&NamedMapping>) -> bool {
    mapping.is_some_and(|(_, mapping)| !mapping.sources.is_empty())
}

/// The columns of a binary file.
pub(crate) fn columns(file: &str, bytes: &[u8]) -> Result<Columns> {
    let content = Content { file, bytes, table: None, mapping: None, limit_mib: text::LIMIT_MIB, part: None };
    let columns =
        binary_reader(bytes).map(|reader| (reader.columns)(&content, &mut Vec::new())).transpose()?;
    columns.flatten().ok_or_else(|| LogError::NotText { file: file.to_owned() })
}

pub(crate) fn binary_reader(bytes: &[u8]) -> Option<&'static Reader> {
    readers().iter().copied().find(|reader| !reader.magic.is_empty() && bytes.starts_with(reader.magic))
}

/// Returns the reader with most marks in a text; of equals the first in the registry.
fn best_reader(header: &[String]) -> Option<&'static Reader> {
    let mut best: Option<(f64, &'static Reader)> = None;
    for reader in readers() {
        let share = reader.layout.map_or_else(|| (reader.share)(header), |layout| layout.share(header));
        if share >= LEAST_SHARE && best.is_none_or(|(most, _)| share > most) {
            best = Some((share, *reader));
        }
    }
    best.map(|(_, reader)| reader)
}

/// Why the columns of a table are no format's.
fn unknown(table: &Table) -> LogError {
    let (file, found) = (table.file.clone(), table.header.join(", ").chars().take(200).collect());
    if table.has_no_header {
        return LogError::NoHeader { file };
    }
    LogError::UnknownFormat { file, found }
}

impl Provenance {
    /// The format in words.
    pub fn title(&self) -> &'static str {
        let reader = readers().iter().find(|reader| reader.name == self.format);
        reader.map_or("a simulated flight", |reader| reader.title)
    }
}
