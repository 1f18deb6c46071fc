//! The trait of file formats, and the choice among them.

use crate::columns::LEAST_SHARE;
use crate::formats::readers;
use crate::table::{Table, header};
use crate::{FlightLog, LogError, Mapping, Note};

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
pub(crate) fn read(content: &Content<'_>, mut notes: Vec<Note>) -> Result<FlightLog, LogError> {
    if let Some(reader) = best_reader(content) {
        return reader.read(content, notes);
    }
    let table = content.table(&mut notes)?;
    Err(LogError::UnknownFormat {
        file: content.file.to_owned(),
        found: table.header.join(", ").chars().take(200).collect(),
    })
}
