//! The front of every text format: finds the table in a text, whatever surrounds or interrupts it.
//!
//! Comments, a preamble, several header lines, a row of units, a header that is repeated, rows with a cell too
//! few or too many: each is read or left out, with a note.

use csv::{ByteRecord, ReaderBuilder, Trim};
use serde::Deserialize;

use super::cells::{is_data, is_missing, is_unit, shown};
use super::table::Table;
use super::text::{decode, whole_lines};
use super::{LogError, Note, Result, long_form, pairs};

/// The longest line of a real log has about 700 bytes.
const LONGEST_LINE: usize = 1 << 16;
/// Ten hours at 100 Hz, or one at 1 kHz: each row takes some 200 bytes while it is read.
pub(super) const MOST_ROWS: usize = 4_000_000;
/// Rows from which the layout is inferred.
const SAMPLE: usize = 200;
/// Rows that may be left out for their number of cells: one, or this share.
const RAGGED_SHARE: f64 = 0.01;
const SEPARATORS: [u8; 5] = [b',', b';', b'\t', b'|', b' '];
const COMMENT_MARKS: [&[u8]; 3] = [b"#", b"//", b"%"];

const COMMAS: &str =
    "; decimal commas beside separating commas cannot be told apart: store the numbers with points";

/// The layout of a text, if a mapping gives it.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TableLayout {
    /// Line of the column names, from 1.
    header_line: Option<u64>,
    /// Names of the columns, of a text that has no line for them.
    columns: Option<Vec<String>>,
}

/// The table in the bytes of a text file; numbers are parsed column by column, later.
pub(crate) fn read_table(
    file: &str,
    bytes: &[u8],
    layout: &TableLayout,
    notes: &mut Vec<Note>,
) -> Result<Table> {
    let text = decode(bytes, notes);
    check_text(file, &text)?;
    let lines = whole_lines(&text, notes);
    if let Some(table) = pairs::table(file, lines) {
        notes.push(Note::Pivoted { from: "name and value pairs" });
        return Ok(table);
    }
    let rows =
        Row::all(lines).map_err(|error| LogError::Io { file: file.to_owned(), source: error.into() })?;
    if rows.len() > MOST_ROWS {
        return Err(LogError::TooManyRows { file: file.to_owned(), most: MOST_ROWS });
    }
    let head = Head::find(file, &rows, layout)?;
    if let Some(table) = long_form::table(file, &head.names, &rows[head.data_from..]) {
        notes.push(Note::Pivoted { from: "rows of a name and a value" });
        return Ok(table);
    }
    head.table(file, &rows, notes)
}

fn check_text(file: &str, text: &str) -> Result<()> {
    let is_text = |line: &str| line.chars().all(|c| c == '\t' || !c.is_control());
    if text.trim().is_empty() {
        return Err(LogError::Empty { file: file.to_owned() });
    }
    let mut lines = text.split('\n');
    if let Some(at) = lines.position(|line| line.len() > LONGEST_LINE) {
        let (file, line) = (file.to_owned(), at as u64 + 1);
        return Err(LogError::LineTooLong { file, line, limit: LONGEST_LINE });
    }
    match text.split(['\n', '\r']).find(|line| !line.is_empty()) {
        Some(line) if !is_text(line) => Err(LogError::NotText { file: file.to_owned() }),
        _ => Ok(()),
    }
}

/// A line, split into cells.
pub(super) struct Row {
    pub(super) line: u64,
    pub(super) cells: ByteRecord,
    /// It begins like a comment.
    is_marked: bool,
}

impl Row {
    fn all(text: &str) -> Result<Vec<Self>, csv::Error> {
        // spreadsheets say the separator in a line of its own
        let named = text.lines().next().and_then(|line| line.trim().strip_prefix("sep="));
        let (skipped, text) = match named {
            Some(_) => (1, text.split_once('\n').map_or("", |(_, rest)| rest)),
            None => (0, text),
        };
        let separator = named.and_then(|named| named.bytes().next()).map_or_else(|| separator(text), Ok)?;
        let mut rows = Self::split(text.as_bytes(), separator, MOST_ROWS + 1)?;
        rows.iter_mut().for_each(|row| row.line += skipped);
        Ok(rows)
    }

    fn split(text: &[u8], separator: u8, most: usize) -> Result<Vec<Self>, csv::Error> {
        let mut builder = ReaderBuilder::new();
        builder.has_headers(false).flexible(true).trim(Trim::All).delimiter(separator);
        let mut reader = builder.from_reader(text);
        let (mut rows, mut cells) = (Vec::new(), ByteRecord::new());
        while rows.len() < most && reader.read_byte_record(&mut cells)? {
            let line = cells.position().map_or(0, csv::Position::line);
            let row = if separator == b' ' {
                cells.iter().filter(|cell| !cell.is_empty()).collect()
            } else {
                cells.clone()
            };
            rows.push(Self::unmarked(line, row));
        }
        Ok(rows)
    }

    /// A row without the mark of a comment in its first cell.
    fn unmarked(line: u64, cells: ByteRecord) -> Self {
        let first = cells.get(0).unwrap_or_default();
        let Some(mark) = COMMENT_MARKS.iter().find(|mark| first.starts_with(mark)) else {
            return Self { line, cells, is_marked: false };
        };
        let first = first[mark.len()..].trim_ascii();
        // a mark that stands alone is no cell
        let kept = (!first.is_empty() || cells.len() == 1).then_some(first);
        let cells = kept.into_iter().chain(cells.iter().skip(1)).collect();
        Self { line, cells, is_marked: true }
    }
}

/// The separator by which most rows are rows of data of one width; of equals the one with more columns.
fn separator(text: &str) -> Result<u8, csv::Error> {
    let mut best = ((0, 0), b',');
    for separator in SEPARATORS {
        let rows = Row::split(text.as_bytes(), separator, SAMPLE)?;
        let rank = (data_rows(&rows), usual_width(&rows));
        if rank.1 > 1 && rank > best.0 {
            best = (rank, separator);
        }
    }
    // no row of data: by the first line
    let first = text.split(['\n', '\r']).find(|line| !line.is_empty()).unwrap_or_default();
    let count = |byte: &u8| first.bytes().filter(|b| b == byte).count();
    Ok(if best.0.0 > 0 {
        best.1
    } else {
        [b';', b'\t'].into_iter().find(|b| count(b) > 0 && count(b) >= count(&b',')).unwrap_or(b',')
    })
}

fn data_rows(rows: &[Row]) -> usize {
    let width = usual_width(rows);
    rows.iter().filter(|row| !row.is_marked && row.cells.len() == width && is_data(&row.cells)).count()
}

/// The most frequent number of cells of the rows of data.
fn usual_width(rows: &[Row]) -> usize {
    let mut counts: Vec<(usize, usize)> = Vec::new();
    for row in rows.iter().filter(|row| !row.is_marked && is_data(&row.cells)).take(SAMPLE) {
        match counts.iter_mut().find(|(width, _)| *width == row.cells.len()) {
            Some((_, count)) => *count += 1,
            None => counts.push((row.cells.len(), 1)),
        }
    }
    counts.into_iter().max_by_key(|(width, count)| (*count, *width)).map_or(0, |(width, _)| width)
}

/// Lines above the data.
struct Head {
    /// Names of the columns; empty if there is no line of them.
    names: Vec<String>,
    units: Vec<String>,
    /// The names as written, for the rows that repeat them.
    header: Option<ByteRecord>,
    data_from: usize,
}

impl Head {
    fn find(file: &str, rows: &[Row], layout: &TableLayout) -> Result<Self> {
        let width = usual_width(rows);
        let starts = |at: usize| {
            let mut after = rows[at..].iter().filter(|row| !row.is_marked).take(2);
            !rows[at].is_marked && after.all(|row| row.cells.len() == width && is_data(&row.cells))
        };
        let first = (0..rows.len()).find(|at| width > 0 && starts(*at)).unwrap_or(rows.len());
        if let Some(names) = &layout.columns {
            return Ok(Self { names: names.clone(), units: Vec::new(), header: None, data_from: first });
        }
        let Some(at) = (match layout.header_line {
            Some(line) => {
                let place = rows.iter().position(|row| row.line == line);
                Some(place.ok_or_else(|| LogError::Unusable(format!("{file}: has no line {line}, which the mapping file says holds the names of the columns")))?)
            }
            None => Self::header_above(rows, first, width),
        }) else {
            return Ok(Self { names: Vec::new(), units: Vec::new(), header: None, data_from: first });
        };
        let is_units = |row: &&Row| row.cells.iter().all(is_unit) && row.cells.iter().any(|c| !c.is_empty());
        // the row of units stands below the names, or the names above the row of units
        let (at, units) = match (layout.header_line, rows.get(at + 1), is_units(&&rows[at])) {
            (None, _, true) => match Self::header_above(rows, at, width) {
                Some(above) => (above, Some(&rows[at])),
                None => (at, None),
            },
            (Some(_), Some(below), _) if is_units(&below) => (at, Some(below)),
            _ => (at, None),
        };
        let data_from =
            if layout.header_line.is_some() { at + 1 + usize::from(units.is_some()) } else { first };
        let units = units.map_or(Vec::new(), |row| row.cells.iter().map(shown).collect());
        let names = Self::names(&rows[..at], &rows[at].cells);
        Ok(Self { names, units, header: Some(rows[at].cells.clone()), data_from: data_from.max(at + 1) })
    }

    /// The row of names above the data: the nearest that is no comment, or a comment that has as many cells.
    fn header_above(rows: &[Row], first: usize, width: usize) -> Option<usize> {
        let is_alike = |row: &Row| row.cells.len().abs_diff(width) <= 1;
        let plain = rows[..first].iter().rposition(|row| !row.is_marked && !is_data(&row.cells));
        let marked =
            rows[..first].iter().rposition(|row| row.is_marked && is_alike(row) && !is_data(&row.cells));
        match (plain, marked) {
            (Some(plain), Some(marked)) if !is_alike(&rows[plain]) => Some(marked.max(plain)),
            (Some(plain), _) => Some(plain),
            (None, marked) => marked,
        }
    }

    /// Returns the names of a row; duplicate names are distinguished by the rows above.
    fn names(above: &[Row], header: &ByteRecord) -> Vec<String> {
        let names: Vec<String> = header.iter().map(shown).collect();
        let is_twice = |name: &String| names.iter().filter(|other| *other == name).count() > 1;
        let told_apart = |(at, name): (usize, &String)| {
            if name.is_empty() || !is_twice(name) {
                return name.clone();
            }
            let upper = above.iter().filter(|row| row.cells.len() + 1 >= names.len());
            let mut words: Vec<String> = upper.filter_map(|row| row.cells.get(at).map(shown)).collect();
            words.retain(|word| !word.is_empty());
            words.push(name.clone());
            words.join(" ")
        };
        names.iter().enumerate().map(told_apart).collect()
    }

    /// The rows below the head.
    fn table(mut self, file: &str, rows: &[Row], notes: &mut Vec<Note>) -> Result<Table> {
        let below = &rows[self.data_from..];
        let width = usual_width(below);
        let has_no_header = self.names.is_empty();
        if has_no_header {
            self.names = (1..=width).map(|at| format!("column {at}")).collect();
        }
        self.check_names(file)?;
        if width == 0 {
            return Err(LogError::NoRows { file: file.to_owned() });
        }
        let ends_empty =
            || below.iter().all(|row| row.cells.len() < width || row.cells[width - 1].is_empty());
        if self.names.len() + 1 == width && ends_empty() {
            self.names.push(String::new());
        } else if self.names.len() == width + 1 && self.names.last().is_some_and(String::is_empty) {
            self.names.pop();
        }
        if self.names.len() != width {
            let line = below.iter().find(|row| row.cells.len() == width).map_or(0, |row| row.line);
            let names = self.names.len();
            // twice as many cells as names
            let hint = if width + 1 >= 2 * names { COMMAS } else { "" };
            return Err(LogError::Unusable(format!(
                "{file}, line {line}: the rows have {width} cells, the line of names has {names}; if another line holds the names, say it in a mapping file ([table] header_line = N){hint}"
            )));
        }
        let (records, lines) = self.kept(file, below, width, notes)?;
        let mut table = Table::new(file.to_owned(), self.names, records, lines);
        table.units = self.units;
        table.has_no_header = has_no_header;
        table.drop_empty_columns();
        Ok(table)
    }

    fn check_names(&self, file: &str) -> Result<()> {
        let twice = |(at, name): (usize, &String)| !name.is_empty() && self.names[..at].contains(name);
        match self.names.iter().enumerate().find(|(at, name)| twice((*at, name))) {
            None => Ok(()),
            Some((_, column)) => {
                Err(LogError::DuplicateColumn { file: file.to_owned(), column: column.clone() })
            }
        }
    }

    /// Cells and lines of the rows of data.
    fn kept(
        &self,
        file: &str,
        rows: &[Row],
        width: usize,
        notes: &mut Vec<Note>,
    ) -> Result<(Vec<ByteRecord>, Vec<u64>)> {
        let (mut records, mut lines, mut ragged, mut repeated, mut comments) =
            (Vec::new(), Vec::new(), Vec::new(), 0, 0);
        for row in rows {
            let is_whole = row.cells.len() == width;
            if row.is_marked {
                comments += 1;
            } else if self.header.as_ref().is_some_and(|header| *header == row.cells) {
                repeated += 1;
            } else if row.cells.iter().all(is_missing) {
                // spreadsheets leave empty rows below the last
            } else if is_whole {
                records.push(row.cells.clone());
                lines.push(row.line);
            } else {
                ragged.push(row);
            }
        }
        if let Some(first) = ragged.first() {
            let allowed = (RAGGED_SHARE * rows.len() as f64).ceil() as usize;
            if ragged.len() > allowed {
                let (count, rows, found) = (ragged.len(), rows.len(), first.cells.len());
                let (file, line, expected) = (file.to_owned(), first.line, width);
                return Err(LogError::RaggedRows { file, count, rows, line, found, expected });
            }
            notes.push(Note::RaggedRows { count: ragged.len(), line: first.line });
        }
        if repeated > 0 {
            notes.push(Note::RepeatedHeader { count: repeated });
        }
        if comments > 0 {
            notes.push(Note::Comments { count: comments });
        }
        if records.is_empty() {
            return Err(LogError::NoRows { file: file.to_owned() });
        }
        Ok((records, lines))
    }
}
