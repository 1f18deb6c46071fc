//! A CSV file as named columns of checked numbers.

use csv::{ByteRecord, ReaderBuilder, Trim};

use super::text::whole_lines;
use super::{LogError, Note};

/// The longest line of a real log has about 700 bytes.
const LONGEST_LINE: usize = 1 << 16;
/// Above this no channel of a flight makes sense (Unix time is 1.8e9), below it squares stay finite.
const LARGEST: f64 = 1e12;
/// Bad values are quoted up to this many characters.
const LONGEST_QUOTE: usize = 40;

/// The values that a column may hold.
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

impl Accept {
    pub(super) const fn between(low: f64, high: f64, expected: &'static str) -> Self {
        Self { low, high, expected }
    }

    pub(super) fn admits(&self, value: f64) -> bool {
        value >= self.low && value <= self.high
    }
}

/// The rows of a CSV file. Every record has as many fields as the header.
#[derive(Debug)]
pub(super) struct Table {
    pub(super) file: String,
    pub(super) header: Vec<String>,
    /// A number may have a decimal comma, since something else separates the columns.
    comma_is_decimal: bool,
    records: Vec<ByteRecord>,
    lines: Vec<u64>,
}

impl Table {
    /// Splits `text` into fields; the numbers are parsed column by column, later.
    pub(super) fn parse(file: &str, text: &[u8], notes: &mut Vec<Note>) -> Result<Self, LogError> {
        let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
        if text.iter().all(u8::is_ascii_whitespace) {
            return Err(LogError::Empty { file: file.to_owned() });
        }
        check_line_lengths(file, text)?;
        let first = text.split(|b| matches!(b, b'\n' | b'\r')).find(|line| !line.is_empty());
        if first.is_some_and(|line| !is_text(line)) {
            return Err(LogError::NotText { file: file.to_owned() });
        }
        let delimiter = delimiter(first.unwrap_or_default());
        let lines = whole_lines(text, notes);
        let mut reader = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .trim(Trim::All)
            .delimiter(delimiter)
            .from_reader(lines);
        let comma_is_decimal = delimiter != b',';
        let mut table = Self {
            file: file.to_owned(),
            header: Vec::new(),
            comma_is_decimal,
            records: Vec::new(),
            lines: Vec::new(),
        };
        let mut record = ByteRecord::new();
        while reader
            .read_byte_record(&mut record)
            .map_err(|error| LogError::Io { file: file.to_owned(), source: error.into() })?
        {
            table.push(&record)?;
        }
        if table.records.is_empty() {
            return Err(LogError::NoRows { file: file.to_owned() });
        }
        if comma_is_decimal
            && table.records.iter().take(10).flatten().any(|field| decimal_point(field).is_some())
        {
            notes.push(Note::DecimalCommas);
        }
        Ok(table)
    }

    /// A table of cells that came in another form than text; `lines` count from 1 in errors.
    pub(super) fn of_cells(file: String, header: Vec<String>, records: Vec<ByteRecord>) -> Self {
        let lines = (1..=records.len() as u64).collect();
        Self { file, header, comma_is_decimal: false, records, lines }
    }

    /// Takes the first record as the header, the others as rows.
    fn push(&mut self, record: &ByteRecord) -> Result<(), LogError> {
        if self.header.is_empty() {
            self.header = record.iter().map(shown).collect();
            for (at, column) in self.header.iter().enumerate() {
                if self.header[..at].contains(column) {
                    return Err(LogError::DuplicateColumn {
                        file: self.file.clone(),
                        column: column.clone(),
                    });
                }
            }
            return Ok(());
        }
        let line = record.position().map_or(0, csv::Position::line);
        if record.len() != self.header.len() {
            return Err(LogError::FieldCount {
                file: self.file.clone(),
                line,
                expected: self.header.len(),
                found: record.len(),
            });
        }
        self.records.push(record.clone());
        self.lines.push(line);
        Ok(())
    }

    /// Number of rows.
    pub(super) fn len(&self) -> usize {
        self.records.len()
    }

    pub(super) fn has(&self, column: &str) -> bool {
        self.header.iter().any(|name| name == column)
    }

    /// All values of a column; an empty or unacceptable one is an error.
    pub(super) fn column(&self, column: &str, accept: Accept) -> Result<Vec<f64>, LogError> {
        let at = self.position(column)?;
        let values = (0..self.len()).map(|row| self.value(row, at, column, accept));
        values.collect()
    }

    /// Three columns, for instance x, y, z.
    pub(super) fn triple(&self, columns: [&str; 3]) -> Result<[Vec<f64>; 3], LogError> {
        let [a, b, c] = columns;
        Ok([self.column(a, NUMBER)?, self.column(b, NUMBER)?, self.column(c, NUMBER)?])
    }

    /// The time column, which must increase strictly.
    pub(super) fn time(&self, column: &str) -> Result<Vec<f64>, LogError> {
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

    /// Columns that are empty together wherever nothing was measured: the rows that hold values, and the
    /// values.
    pub(super) fn sparse(&self, columns: &[&str]) -> Result<(Vec<usize>, Vec<Vec<f64>>), LogError> {
        let positions = columns.iter().map(|c| self.position(c)).collect::<Result<Vec<_>, _>>()?;
        let mut rows = Vec::new();
        let mut values = vec![Vec::new(); columns.len()];
        for (row, record) in self.records.iter().enumerate() {
            if positions.iter().all(|&at| record[at].is_empty()) {
                continue;
            }
            rows.push(row);
            for ((&at, column), out) in positions.iter().zip(columns).zip(&mut values) {
                if record[at].is_empty() {
                    let expected = "a number, as in the other position columns of this row";
                    return Err(self.bad(row, column, "", expected));
                }
                out.push(self.value(row, at, column, NUMBER)?);
            }
        }
        Ok((rows, values))
    }

    /// The cells of a column that are not empty: their rows and values.
    pub(super) fn cells(&self, column: &str, accept: Accept) -> Result<(Vec<usize>, Vec<f64>), LogError> {
        let at = self.position(column)?;
        let filled = (0..self.len()).filter(|row| !self.records[*row][at].is_empty());
        let values = filled.map(|row| Ok((row, self.value(row, at, column, accept)?)));
        Ok(values.collect::<Result<Vec<_>, LogError>>()?.into_iter().unzip())
    }

    /// Checks values that could not be checked while reading them, because rows were to be cut first.
    #[cfg(feature = "labs")]
    pub(super) fn recheck(&self, column: &str, values: &[f64], accept: Accept) -> Result<(), LogError> {
        match values.iter().position(|v| !accept.admits(*v)) {
            None => Ok(()),
            Some(row) => Err(self.bad(row, column, &values[row].to_string(), accept.expected)),
        }
    }

    fn position(&self, column: &str) -> Result<usize, LogError> {
        let found = self.header.iter().position(|name| name == column);
        found
            .ok_or_else(|| LogError::UnknownFormat { file: self.file.clone(), found: self.header.join(", ") })
    }

    fn value(&self, row: usize, at: usize, column: &str, accept: Accept) -> Result<f64, LogError> {
        let field = &self.records[row][at];
        let number = |field: &[u8]| std::str::from_utf8(field).ok().and_then(|text| text.parse::<f64>().ok());
        let with_comma =
            || decimal_point(field).filter(|_| self.comma_is_decimal).and_then(|field| number(&field));
        let parsed = number(field).or_else(with_comma);
        match parsed {
            // Comparisons are false for NaN, so this also refuses what is not finite.
            Some(value) if accept.admits(value) => Ok(value),
            _ => Err(self.bad(row, column, &shown(field), accept.expected)),
        }
    }

    pub(super) fn bad(&self, row: usize, column: &str, value: &str, expected: &'static str) -> LogError {
        LogError::BadValue {
            file: self.file.clone(),
            line: self.lines[row],
            column: column.to_owned(),
            value: value.chars().take(LONGEST_QUOTE).collect(),
            expected,
        }
    }
}

/// The names in the first line of a text; none where that is no text.
pub(super) fn header(text: &[u8]) -> Vec<String> {
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
    let line = text.split(|b| matches!(b, b'\n' | b'\r')).find(|line| !line.is_empty());
    let Some(line) = line.filter(|line| line.len() <= LONGEST_LINE && is_text(line)) else {
        return Vec::new();
    };
    let mut reader =
        ReaderBuilder::new().has_headers(false).trim(Trim::All).delimiter(delimiter(line)).from_reader(line);
    let mut record = ByteRecord::new();
    match reader.read_byte_record(&mut record) {
        Ok(true) => record.iter().map(shown).collect(),
        _ => Vec::new(),
    }
}

/// The byte between columns: a semicolon or a tab where the header has one and no more commas than that.
fn delimiter(header: &[u8]) -> u8 {
    let count = |byte: u8| header.iter().filter(|b| **b == byte).count();
    [b';', b'\t'].into_iter().find(|byte| count(*byte) > 0 && count(*byte) >= count(b',')).unwrap_or(b',')
}

/// A number with one decimal comma, with a point instead.
fn decimal_point(field: &[u8]) -> Option<Vec<u8>> {
    let at = field.iter().position(|b| *b == b',')?;
    let is_digit = |b: &u8| b.is_ascii_digit() || matches!(b, b'+' | b'-' | b'e' | b'E');
    let plain = field.len() > 1 && field[..at].iter().chain(&field[at + 1..]).all(is_digit);
    plain.then(|| [&field[..at], b".", &field[at + 1..]].concat())
}

fn shown(field: &[u8]) -> String {
    String::from_utf8_lossy(field).into_owned()
}

fn is_text(line: &[u8]) -> bool {
    std::str::from_utf8(line).is_ok_and(|text| text.chars().all(|c| c == '\t' || !c.is_control()))
}

fn check_line_lengths(file: &str, text: &[u8]) -> Result<(), LogError> {
    let mut lines = text.split(|b| *b == b'\n');
    match lines.position(|line| line.len() > LONGEST_LINE) {
        None => Ok(()),
        Some(at) => {
            Err(LogError::LineTooLong { file: file.to_owned(), line: at as u64 + 1, limit: LONGEST_LINE })
        }
    }
}
