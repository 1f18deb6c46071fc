//! Long form: a row has a time, the name of a variable and its value. Turned into a column per variable.

use std::collections::BTreeMap;

use csv::ByteRecord;

use super::cells::{date_s, is_missing, number, shown};
use super::front::Row;
use super::names::is_channel_name;
use super::table::Table;
use super::times::is_time_name;

/// A host's time, a vehicle's time, a block, a name and a value.
const MOST_COLUMNS: usize = 6;
/// Rows from which the form is inferred.
const SAMPLE: usize = 200;
/// The column that the rows of one time are gathered by.
const TIME: &str = "time";

/// The columns of a text in long form, by their places.
struct Places {
    time: usize,
    name: usize,
    value: usize,
}

/// The table of rows in long form; `None` if they are not. `header` may be empty.
pub(super) fn table(file: &str, header: &[String], rows: &[Row]) -> Option<Table> {
    let places = Places::find(header, rows)?;
    let mut wide = Wide::default();
    for row in rows {
        let [time, name, value] =
            [places.time, places.name, places.value].map(|at| row.cells.get(at).unwrap_or_default());
        if !time.is_empty() && !name.is_empty() && number(time).or_else(|| date_s(time)).is_some() {
            wide.add_value(row.line, time, &shown(name), value);
        }
    }
    Some(wide.into_table(file))
}

impl Places {
    fn find(header: &[String], rows: &[Row]) -> Option<Self> {
        let sample: Vec<&ByteRecord> = rows.iter().take(SAMPLE).map(|row| &row.cells).collect();
        let width = sample.first()?.len();
        if !(3..=MOST_COLUMNS).contains(&width) {
            return None;
        }
        let cells = |at: usize| sample.iter().map(move |row| row.get(at).unwrap_or_default());
        let is_number = |at: usize| {
            cells(at).all(|cell| is_missing(cell) || number(cell).or_else(|| date_s(cell)).is_some())
        };
        let is_names = |at: &usize| {
            let known = cells(*at).filter(|cell| is_channel_name(&shown(cell))).count();
            2 * known > sample.len() && cells(*at).any(|cell| Some(cell) != sample[0].get(*at))
        };
        let name = (0..width).find(is_names)?;
        let value = (name + 1..width).rev().find(|at| is_number(*at))?;
        let times: Vec<usize> = (0..name).filter(|at| is_number(*at)).collect();
        let named = times.iter().filter(|at| header.get(**at).is_some_and(|name| is_time_name(name)));
        // the vehicle's clock, one of several, is the column before the name
        let time = named.copied().next_back().or(times.last().copied())?;
        Some(Self { time, name, value })
    }
}

/// A table while it is gathered: rows of one time are one row, unless a name occurs twice.
#[derive(Default)]
pub(super) struct Wide {
    names: Vec<String>,
    places: BTreeMap<String, usize>,
    rows: Vec<(u64, Vec<u8>, Vec<Vec<u8>>)>,
}

/// Damaged files could name a new variable with every row.
const MOST_NAMES: usize = 1024;

impl Wide {
    pub(super) fn add_value(&mut self, line: u64, time: &[u8], name: &str, value: &[u8]) {
        if !self.places.contains_key(name) {
            if self.names.len() == MOST_NAMES {
                return;
            }
            self.places.insert(name.to_owned(), self.names.len());
            self.names.push(name.to_owned());
        }
        let column = self.places[name];
        let is_free = |cells: &[Vec<u8>]| cells.get(column).is_none_or(Vec::is_empty);
        let is_open = self.rows.last().is_some_and(|(_, last, cells)| last == time && is_free(cells));
        if !is_open {
            self.rows.push((line, time.to_vec(), Vec::new()));
        }
        if let Some((_, _, cells)) = self.rows.last_mut() {
            if cells.len() <= column {
                cells.resize(column + 1, Vec::new());
            }
            cells[column] = value.to_vec();
        }
    }

    pub(super) fn into_table(self, file: &str) -> Table {
        let header: Vec<String> = std::iter::once(TIME.to_owned()).chain(self.names).collect();
        let mut lines = Vec::new();
        let mut records = Vec::new();
        for (line, time, mut cells) in self.rows {
            cells.resize(header.len() - 1, Vec::new());
            lines.push(line);
            records.push(ByteRecord::from_iter(std::iter::once(time).chain(cells)));
        }
        Table::new(file.to_owned(), header, records, lines)
    }
}
