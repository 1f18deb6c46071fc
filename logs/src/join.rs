//! Several files of one flight as one table, joined on their clock.

use csv::ByteRecord;

use super::table::{Clock, Table};
use super::times::TimeUnit;
use super::{LogError, Note, Result};

/// Name of the time column of a joined table.
const TIME: &str = "time";
/// Files of the same columns follow each other within this time; after a longer one it is another flight.
const LONGEST_BREAK_S: f64 = 2.0;

/// The tables as one: rows in order of time, columns side by side.
pub(super) fn join(tables: Vec<Table>, notes: &mut Vec<Note>) -> Result<Table> {
    check_clocks(&tables)?;
    let mut header = vec![TIME.to_owned()];
    let (mut units, mut twice) = (vec![String::new()], Vec::new());
    let first_header = tables.first().map_or(Vec::new(), |table| table.header.clone());
    // places in the joined header, by table and column; none for the clock and for what came twice
    let mut places: Vec<Vec<Option<usize>>> = Vec::new();
    for (at, table) in tables.iter().enumerate() {
        let clock = &table.clock()?.column;
        let follows = at > 0 && table.header == first_header;
        let place = |(column, name): (usize, &String)| {
            let known = header.iter().position(|known| known == name);
            match known {
                _ if name == clock => None,
                Some(known) if follows => Some(known),
                Some(_) => {
                    twice.push(name.clone());
                    None
                }
                None => {
                    header.push(name.clone());
                    units.push(table.units.get(column).cloned().unwrap_or_default());
                    Some(header.len() - 1)
                }
            }
        };
        places.push(table.header.iter().enumerate().map(place).collect());
    }
    if !twice.is_empty() {
        notes.push(Note::ColumnsTwice { columns: twice });
    }
    notes.push(Note::Joined { files: tables.iter().map(|table| table.file.clone()).collect() });
    let mut rows = Vec::new();
    for (table, places) in tables.iter().zip(&places) {
        for (t_s, record, line) in table.rows()? {
            let mut cells: Vec<&[u8]> = vec![b""; header.len()];
            for (cell, place) in record.iter().zip(places) {
                place.iter().for_each(|place| cells[*place] = cell);
            }
            rows.push((t_s, ByteRecord::from(cells), line));
        }
    }
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    let t_s: Vec<f64> = rows.iter().map(|(t_s, ..)| *t_s).collect();
    let (records, lines) = rows.into_iter().map(|(_, record, line)| (record, line)).unzip();
    let file = tables.iter().map(|table| table.file.as_str()).collect::<Vec<_>>().join(" + ");
    let mut joined = Table::new(file, header, records, lines);
    joined.units = units;
    joined.clock = Some(Clock { column: TIME.to_owned(), unit: TimeUnit::SECOND, t_s });
    Ok(joined)
}

/// Every clock runs beside that of another file, or files of the same columns follow each other at once.
fn check_clocks(tables: &[Table]) -> Result<()> {
    let mut spans: Vec<[f64; 2]> = Vec::new();
    for table in tables {
        let t_s = &table.clock()?.t_s;
        let low = t_s.iter().copied().fold(f64::INFINITY, f64::min);
        let high = t_s.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let near_s =
            if tables.iter().all(|other| other.header == table.header) { LONGEST_BREAK_S } else { 0.0 };
        let meets = |other: &[f64; 2]| low <= other[1] + near_s && other[0] <= high + near_s;
        if !spans.is_empty() && !spans.iter().any(meets) {
            let (file, other, [other_low, other_high]) = (&table.file, &tables[0].file, spans[0]);
            return Err(LogError::Unusable(format!(
                "{file} and {other} are not one flight: their clocks run from {low} to {high} s and from {other_low} to {other_high} s"
            )));
        }
        spans.push([low, high]);
    }
    Ok(())
}
