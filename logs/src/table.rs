//! A table of named columns, whose numbers are checked when they are read.

use std::ops::Range;

use csv::ByteRecord;

use super::cells::{date_s, decimal_point, is_missing, number, shown};
use super::clock::{choose_flight, flights, unwrap_counter, unwrap_day};
use super::times::{TimeSpec, TimeUnit, guess_unit, time_column, unit_of_name};
use super::{LogError, Note, Result};

/// Above this no channel of a flight makes sense (Unix time is 1.8e9), below it squares stay finite.
const LARGEST: f64 = 1e12;
/// Bad values are quoted up to this many characters.
const LONGEST_QUOTE: usize = 40;
/// With more stamps that repeat the one before, a clock is unusable.
const REPEATED_SHARE: f64 = 0.5;

/// The values allowed in a column.
#[derive(Debug, Clone, Copy)]
pub(super) struct Accept {
    low: f64,
    high: f64,
    expected: &'static str,
}

/// Any finite number.
pub(super) const NUMBER: Accept = Accept::between(-LARGEST, LARGEST, "a finite number");
/// Thrust and motor commands are 16 bits wide.
pub(super) const PWM: Accept = Accept::between(0.0, 65_535.0, "a PWM command from 0 to 65535");
/// Unix time in nanoseconds is 1.8e18.
const STAMP: Accept = Accept::between(-1e19, 1e19, "a time");

impl Accept {
    pub(super) const fn between(low: f64, high: f64, expected: &'static str) -> Self {
        Self { low, high, expected }
    }

    pub(super) fn admits(&self, value: f64) -> bool {
        value >= self.low && value <= self.high
    }
}

/// The rows of a table. Every record has as many cells as the header.
#[derive(Debug, Clone)]
pub(super) struct Table {
    pub(super) file: String,
    pub(super) header: Vec<String>,
    /// Units by column, if a row gives them; empty if none does.
    pub(super) units: Vec<String>,
    /// The times of the rows, by the table's own time column.
    pub(super) clock: Option<Clock>,
    /// The names are numbers of columns: the text had no line for them.
    pub(super) has_no_header: bool,
    records: Vec<ByteRecord>,
    lines: Vec<u64>,
}

/// The time column of a table, on a clock that neither wraps nor begins anew.
#[derive(Debug, Clone)]
pub(super) struct Clock {
    /// Name of the column; empty if a rate replaces it.
    pub(super) column: String,
    pub(super) unit: TimeUnit,
    /// One per row, as the file counts.
    pub(super) t_s: Vec<f64>,
}

impl Table {
    /// A table of these cells; `lines` are their places in the file, for errors.
    pub(super) fn new(file: String, header: Vec<String>, records: Vec<ByteRecord>, lines: Vec<u64>) -> Self {
        Self { file, header, units: Vec::new(), clock: None, has_no_header: false, records, lines }
    }

    /// Creates a table of cells from another form than text.
    pub(super) fn of_cells(file: String, header: Vec<String>, records: Vec<ByteRecord>) -> Self {
        let lines = (1..=records.len() as u64).collect();
        Self::new(file, header, records, lines)
    }

    /// Drops the columns without a name that are empty; others without a name are numbered.
    pub(super) fn drop_empty_columns(&mut self) {
        let is_used = |at: usize| {
            !self.header[at].is_empty() || self.records.iter().any(|record| !record[at].is_empty())
        };
        let kept: Vec<usize> = (0..self.header.len()).filter(|at| is_used(*at)).collect();
        if kept.len() < self.header.len() {
            for record in &mut self.records {
                *record = kept.iter().map(|at| &record[*at]).collect();
            }
            self.header = kept.iter().map(|at| self.header[*at].clone()).collect();
            self.units = kept.iter().filter_map(|at| self.units.get(*at).cloned()).collect();
        }
        for (at, name) in self.header.iter_mut().enumerate().filter(|(_, name)| name.is_empty()) {
            *name = format!("column {}", at + 1);
        }
    }

    /// Finds the clock of the rows and keeps those of one flight: the clock may wrap, and begin anew with
    /// another flight. A table without a time column is left as it is.
    pub(super) fn set_clock(
        &mut self,
        time: &TimeSpec,
        flight: Option<usize>,
        notes: &mut Vec<Note>,
    ) -> Result<()> {
        if self.records.iter().take(10).flatten().any(|cell| decimal_point(cell).is_some()) {
            notes.push(Note::DecimalCommas);
        }
        if let Some(rate_hz) = time.rate_hz {
            let t_s = (0..self.len()).map(|row| row as f64 / rate_hz).collect();
            self.clock = Some(Clock { column: String::new(), unit: TimeUnit::SECOND, t_s });
            return Ok(());
        }
        let named = time.column.as_deref().or_else(|| time_column(&self.header)).map(str::to_owned);
        let Some(column) = named.filter(|column| self.has(column)) else { return Ok(()) };
        let (mut stamps, is_dated) = self.stamps(&column)?;
        let said = || unit_of_name(&column).or_else(|| self.unit(&column).and_then(unit_of_name));
        let unit = match time.unit {
            _ if is_dated => TimeUnit::SECOND,
            Some(unit) => unit,
            None => said().filter(|unit| unit.is_plausible(&stamps)).unwrap_or_else(|| guess_unit(&stamps)),
        };
        let wraps =
            if is_dated { unwrap_day(&mut stamps) } else { unwrap_counter(&mut stamps, unit.seconds) };
        if wraps > 0 {
            notes.push(Note::ClockWraps { column: column.clone(), wraps });
        }
        let flights = flights(&stamps, unit.seconds);
        let rows = flights[choose_flight(&self.file, flights.len(), flight, notes)?].clone();
        self.keep_rows(rows.clone());
        let t_s = stamps[rows].iter().map(|stamp| stamp * unit.seconds).collect();
        let clock = Clock { column, unit, t_s };
        self.check_repeats(&clock)?;
        self.clock = Some(clock);
        Ok(())
    }

    fn keep_rows(&mut self, rows: Range<usize>) {
        self.records.truncate(rows.end);
        self.records.drain(..rows.start);
        self.lines.truncate(rows.end);
        self.lines.drain(..rows.start);
    }

    /// Stamps that repeat with every column filled anew have lost their digits.
    fn check_repeats(&self, clock: &Clock) -> Result<()> {
        let both = |row: usize| {
            let (a, b) = (&self.records[row - 1], &self.records[row]);
            let mut cells = a.iter().zip(b).zip(&self.header);
            cells.any(|((a, b), name)| *name != clock.column && !a.is_empty() && !b.is_empty())
        };
        let repeats =
            (1..self.len()).filter(|row| clock.t_s[*row] == clock.t_s[row - 1] && both(*row)).count();
        if repeats as f64 > REPEATED_SHARE * self.len() as f64 {
            let (file, column, rows) = (&self.file, &clock.column, self.len());
            return Err(LogError::Unusable(format!(
                "{file}: {repeats} of {rows} stamps in \"{column}\" repeat the one before, as they do when times are stored with too few digits (float32): store them as float64, or give the rate of the rows in a mapping file ([time] rate_hz = ...)"
            )));
        }
        Ok(())
    }

    /// The cells of a time column as numbers; whether they are dates.
    fn stamps(&self, column: &str) -> Result<(Vec<f64>, bool)> {
        let index = self.position(column)?;
        let is_dated = self.records.first().is_some_and(|record| number(&record[index]).is_none());
        let stamp = |row: usize| match date_s(&self.records[row][index]).filter(|_| is_dated) {
            Some(date_s) => Ok(date_s),
            None => self.value(row, index, column, STAMP),
        };
        Ok(((0..self.len()).map(stamp).collect::<Result<_>>()?, is_dated))
    }

    /// Time, cells and line of every row.
    pub(super) fn rows(&self) -> Result<impl Iterator<Item = (f64, &ByteRecord, u64)>> {
        let t_s = &self.clock()?.t_s;
        Ok(t_s.iter().zip(&self.records).zip(&self.lines).map(|((t_s, record), line)| (*t_s, record, *line)))
    }

    /// The clock of the rows, which a flight needs.
    pub(super) fn clock(&self) -> Result<&Clock> {
        let problem = "no time column: name it in a mapping file ([time] column = \"...\"), or give the rate of the rows ([time] rate_hz = ...)";
        self.clock.as_ref().ok_or_else(|| LogError::Unusable(format!("{}: {problem}", self.file)))
    }

    /// Returns the unit of a column, if a row gives it or its name in brackets.
    pub(super) fn unit<'a>(&'a self, column: &'a str) -> Option<&'a str> {
        let index = self.header.iter().position(|name| name == column)?;
        let in_row = self.units.get(index).map(String::as_str);
        let in_name = || column.find(['[', '(']).map(|index| &column[index..]);
        let unit = in_row.filter(|unit| !unit.is_empty()).or_else(in_name)?;
        Some(unit.trim_matches(['[', ']', '(', ')', ' '])).filter(|unit| !unit.is_empty())
    }

    /// Number of rows.
    pub(super) fn len(&self) -> usize {
        self.records.len()
    }

    pub(super) fn has(&self, column: &str) -> bool {
        self.header.iter().any(|name| name == column)
    }

    /// All values of a column; an empty or unacceptable one is an error.
    pub(super) fn column(&self, column: &str, accept: Accept) -> Result<Vec<f64>> {
        let index = self.position(column)?;
        let values = (0..self.len()).map(|row| self.value(row, index, column, accept));
        values.collect()
    }

    /// Three columns, for instance x, y, z.
    pub(super) fn triple(&self, columns: [&str; 3]) -> Result<[Vec<f64>; 3]> {
        let [a, b, c] = columns;
        Ok([self.column(a, NUMBER)?, self.column(b, NUMBER)?, self.column(c, NUMBER)?])
    }

    /// The time column, which must increase strictly.
    pub(super) fn time(&self, column: &str) -> Result<Vec<f64>> {
        let t = self.column(column, NUMBER)?;
        match t.windows(2).position(|pair| pair[1] <= pair[0]) {
            None => Ok(t),
            Some(row) => Err(LogError::TimeNotIncreasing {
                file: self.file.clone(),
                line: self.lines[row + 1],
                column: column.to_owned(),
                value: t[row + 1],
                previous: t[row],
            }),
        }
    }

    /// Returns columns that are empty together whenever nothing was measured: the rows with values, and the values.
    pub(super) fn sparse(&self, columns: &[&str]) -> Result<(Vec<usize>, Vec<Vec<f64>>)> {
        let positions = columns.iter().map(|c| self.position(c)).collect::<Result<Vec<_>, _>>()?;
        let mut rows = Vec::new();
        let mut values = vec![Vec::new(); columns.len()];
        for (row, record) in self.records.iter().enumerate() {
            if positions.iter().all(|&at| is_missing(&record[at])) {
                continue;
            }
            rows.push(row);
            for ((&at, column), out) in positions.iter().zip(columns).zip(&mut values) {
                if is_missing(&record[at]) {
                    let expected = "a number, as in the other position columns of this row";
                    return Err(self.bad(row, column, "", expected));
                }
                out.push(self.value(row, at, column, NUMBER)?);
            }
        }
        Ok((rows, values))
    }

    /// The cells of a column that are not empty: their rows and values.
    pub(super) fn cells(&self, column: &str, accept: Accept) -> Result<(Vec<usize>, Vec<f64>)> {
        let index = self.position(column)?;
        let filled = (0..self.len()).filter(|row| !is_missing(&self.records[*row][index]));
        let values = filled.map(|row| Ok((row, self.value(row, index, column, accept)?)));
        Ok(values.collect::<Result<Vec<_>>>()?.into_iter().unzip())
    }

    /// Checks values that could not be checked while reading them, because rows were to be cut first.
    #[cfg(feature = "labs")]
    pub(super) fn recheck(&self, column: &str, values: &[f64], accept: Accept) -> Result<()> {
        match values.iter().position(|v| !accept.admits(*v)) {
            None => Ok(()),
            Some(row) => Err(self.bad(row, column, &values[row].to_string(), accept.expected)),
        }
    }

    pub(super) fn position(&self, column: &str) -> Result<usize> {
        let position = self.header.iter().position(|name| name == column);
        position
            .ok_or_else(|| LogError::UnknownFormat { file: self.file.clone(), found: self.header.join(", ") })
    }

    fn value(&self, row: usize, at: usize, column: &str, accept: Accept) -> Result<f64> {
        let field = &self.records[row][at];
        match number(field) {
            // Comparisons are false for NaN, so this also refuses what is not finite.
            Some(value) if accept.admits(value) => Ok(value),
            _ => Err(self.bad(row, column, &shown(field), accept.expected)),
        }
    }

    pub(super) fn bad(&self, row: usize, column: &str, value: &str, expected: &'static str) -> LogError {
        let value = value.chars().take(LONGEST_QUOTE).collect();
        let (file, line, column) = (self.file.clone(), self.lines[row], column.to_owned());
        LogError::BadValue { file, line, column, value, expected }
    }
}
