//! Arrays of numpy in an archive (`numpy.savez`), as the columns of a table.

use csv::ByteRecord;

use super::bytes::Bytes;
use super::front::MOST_ROWS;
use super::table::Table;
use super::text::{NamedFile, unzip};
use super::{LogError, Note, Result};

const MAGIC: &[u8] = b"\x93NUMPY";
/// A flight has a few dozen columns.
const MOST_COLUMNS: usize = 256;

/// The arrays of the most frequent length as columns: of one with two dimensions, each with its number.
pub(super) fn table(file: &str, bytes: &[u8], limit_mib: u64, notes: &mut Vec<Note>) -> Result<Table> {
    let mut columns: Vec<(String, Vec<f64>)> = Vec::new();
    let mut left_out = Vec::new();
    for NamedFile { name, bytes } in unzip(file, bytes, limit_mib)? {
        let name = name.rsplit('/').next().unwrap_or_default().trim_end_matches(".npy").to_owned();
        match array(&bytes) {
            Some(array) if columns.len() < MOST_COLUMNS => columns.extend(array.columns(&name)),
            _ => left_out.push(name),
        }
    }
    let length = |values: &Vec<f64>| columns.iter().filter(|(_, other)| other.len() == values.len()).count();
    let rows =
        columns.iter().max_by_key(|(_, values)| (length(values), values.len())).map_or(0, |(_, v)| v.len());
    left_out.extend(columns.iter().filter(|(_, values)| values.len() != rows).map(|(name, _)| name.clone()));
    columns.retain(|(_, values)| values.len() == rows);
    match rows {
        0 => return Err(LogError::NoRows { file: file.to_owned() }),
        1..=MOST_ROWS => {}
        _ => return Err(LogError::TooManyRows { file: file.to_owned(), most: MOST_ROWS }),
    }
    if !left_out.is_empty() {
        notes.push(Note::IgnoredColumns { columns: left_out });
    }
    let records =
        (0..rows).map(|row| columns.iter().map(|(_, values)| values[row].to_string()).collect::<Vec<_>>());
    let records = records.map(ByteRecord::from).collect();
    Ok(Table::of_cells(file.to_owned(), columns.into_iter().map(|(name, _)| name).collect(), records))
}

/// An array of numbers, row by row.
struct Array {
    values: Vec<f64>,
    width: usize,
}

impl Array {
    fn columns(self, name: &str) -> Vec<(String, Vec<f64>)> {
        let column = |at: usize| {
            let name = if self.width == 1 { name.to_owned() } else { format!("{name}[{at}]") };
            (name, self.values.iter().skip(at).step_by(self.width).copied().collect())
        };
        (0..self.width.min(MOST_COLUMNS)).map(column).collect()
    }
}

/// The array of a `.npy` file of one or two dimensions; `None` for another, or for what is no array of numbers.
fn array(data: &[u8]) -> Option<Array> {
    let mut bytes = Bytes::new(data);
    if bytes.take(MAGIC.len())? != MAGIC {
        return None;
    }
    let (major, _minor) = (bytes.u8()?, bytes.u8()?);
    let length = if major == 1 { u32::from(bytes.u16()?) } else { bytes.u32()? };
    let header = std::str::from_utf8(bytes.take(usize::try_from(length).ok()?)?).ok()?;
    let kind = header.split("'descr':").nth(1)?.trim_start().strip_prefix('\'')?.split('\'').next()?;
    let shape = header.split("'shape':").nth(1)?.split(['(', ')']).nth(1)?;
    let shape: Vec<usize> = shape.split(',').filter_map(|size| size.trim().parse().ok()).collect();
    if header.contains("'fortran_order': True") && shape.len() > 1 {
        return None;
    }
    let width = match shape[..] {
        [_] => 1,
        [_, width] if width > 0 => width,
        _ => return None,
    };
    let letter = KINDS.iter().position(|known| *known == kind).map(|at| LETTERS[at]);
    let mut values = Vec::new();
    while bytes.remaining() > 0 {
        values.push(bytes.number(letter?)?);
    }
    (values.len() == shape.iter().product::<usize>()).then_some(Array { values, width })
}

/// Kinds of numbers, little endian, and their letters in Python's `struct`.
const KINDS: [&str; 11] = ["<f8", "<f4", "<i8", "<u8", "<i4", "<u4", "<i2", "<u2", "|i1", "|u1", "|b1"];
const LETTERS: &[u8; 11] = b"dfqQiIhHbBB";
