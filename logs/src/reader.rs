//! The trait of file formats, the choice among them, and the flight that a file holds.

use std::path::Path;

use crate::columns::LEAST_SHARE;
use crate::formats::readers;
use crate::table::{Table, header};
use crate::{FlightLog, LogError, Mapping, Note, Provenance, text};

/// A file format. Adding one is a file in `formats/` and its line in the registry there.
pub trait Reader: Sync {
    /// Name in reports, and of the folder of its fuzz corpus.
    fn name(&self) -> &'static str;

    /// The format in words, such as "a NanoBench CSV".
    fn title(&self) -> &'static str;

    /// Share of the format's marks that the file bears: 0 for a file of another format, 1 for all of them.
    fn share(&self, content: &Content<'_>) -> f64;

    /// Reads a file of this format.
    ///
    /// # Errors
    /// [`LogError`] as [`FlightLog::read`].
    fn read(&self, content: &Content<'_>, notes: Vec<Note>) -> Result<FlightLog, LogError>;
}

/// The content of a file, unpacked.
pub struct Content<'a> {
    /// The name used in errors.
    pub(crate) file: &'a str,
    pub(crate) bytes: &'a [u8],
    /// Names in the first line; none where that is no text.
    pub(crate) header: Vec<String>,
    /// The mapping that was given for it, with its name in errors.
    pub(crate) mapping: Option<(String, Mapping)>,
}

impl<'a> Content<'a> {
    pub(crate) fn new(file: &'a str, bytes: &'a [u8], mapping: Option<(String, Mapping)>) -> Self {
        Self { file, bytes, header: header(bytes), mapping }
    }

    /// 1 if the file begins with these bytes, else 0.
    pub(crate) fn magic_share(&self, magic: &[u8]) -> f64 {
        f64::from(u8::from(self.bytes.starts_with(magic)))
    }

    pub(crate) fn table(&self, notes: &mut Vec<Note>) -> Result<Table, LogError> {
        Table::parse(self.file, self.bytes, notes)
    }
}

/// The reader whose marks the file bears most of; of equals the first in the registry.
fn best_reader(content: &Content<'_>) -> Option<&'static dyn Reader> {
    let mut best: Option<(f64, &'static dyn Reader)> = None;
    for reader in readers() {
        let share = reader.share(content);
        if share >= LEAST_SHARE && best.is_none_or(|(most, _)| share > most) {
            best = Some((share, *reader));
        }
    }
    best.map(|(_, reader)| reader)
}

/// Reads a file by the reader that fits it best.
fn read(content: &Content<'_>, mut notes: Vec<Note>) -> Result<FlightLog, LogError> {
    if let Some(reader) = best_reader(content) {
        return reader.read(content, notes);
    }
    let table = content.table(&mut notes)?;
    Err(LogError::UnknownFormat {
        file: content.file.to_owned(),
        found: table.header.join(", ").chars().take(200).collect(),
    })
}

impl FlightLog {
    /// Reads a log file, gzipped or not, of any of the formats of [`readers`](crate::readers); a mapping file
    /// beside it is used, see [`Mapping::path_beside`].
    ///
    /// # Errors
    /// [`LogError`] names the file and, where there is one, the line, the column, the value and what was
    /// expected.
    pub fn read(path: &Path) -> Result<Self, LogError> {
        Self::read_mapped(path, Mapping::path_beside(path).as_deref())
    }

    /// Reads a log file by a mapping file, which counts for text only: binary formats say themselves what
    /// they hold.
    ///
    /// # Errors
    /// As [`FlightLog::read`], and for the mapping as [`Mapping::read`].
    pub fn read_mapped(path: &Path, mapping: Option<&Path>) -> Result<Self, LogError> {
        let file = path.display().to_string();
        let bytes = text::load(path, &file)?;
        let mapping =
            mapping.map(|path| Ok((path.display().to_string(), Mapping::read(path)?))).transpose()?;
        Self::from_content(&file, &bytes, mapping)
    }

    /// Reads a log from the bytes of a file; `file` is the name used in errors.
    ///
    /// # Errors
    /// As [`FlightLog::read`].
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self, LogError> {
        Self::from_content(file, bytes, None)
    }

    /// Reads a log from the bytes of a file by a mapping.
    ///
    /// # Errors
    /// As [`FlightLog::read`].
    pub fn from_mapped_bytes(file: &str, bytes: &[u8], mapping: Mapping) -> Result<Self, LogError> {
        Self::from_content(file, bytes, Some(("the mapping".to_owned(), mapping)))
    }

    fn from_content(file: &str, bytes: &[u8], mapping: Option<(String, Mapping)>) -> Result<Self, LogError> {
        let mut notes = Vec::new();
        let unpacked = text::decompress(file, bytes, &mut notes)?;
        read(&Content::new(file, &unpacked, mapping), notes)
    }
}

impl Provenance {
    /// The format in words.
    pub fn title(&self) -> &'static str {
        let reader = readers().iter().find(|reader| reader.name() == self.format);
        reader.map_or("a simulated flight", |reader| reader.title())
    }
}
