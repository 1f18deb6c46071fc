//! Any log, by a mapping file.

use crate::channels::{Channels, Facts};
use crate::columns::closest;
use crate::firmware::pwm_of_force;
use crate::mapping::{Mapping, Source};
use crate::quantity::Quantity;
use crate::series::{Series, longest_times};
use crate::table::{NUMBER, PWM, Table};
use crate::{Columns, Content, FlightLog, LogError, Note, Reader, Result};

pub(crate) static READER: Reader = Reader {
    name: "mapped_csv",
    title: "a log read by a mapping file",
    read: |content, notes| read(content, None, notes),
    ..Reader::TEXT
};

/// The flight of a content by its mapping: of its table, or of the columns of a binary file.
pub(crate) fn read(
    content: &Content<'_>,
    columns: Option<Columns>,
    mut notes: Vec<Note>,
) -> Result<FlightLog> {
    let Some((mapping_file, mapping)) = content.mapping else {
        return Err(LogError::UnknownFormat { file: content.file.to_owned(), found: String::new() });
    };
    let columns = match &columns {
        Some(Columns(series)) => ColumnSource::Series { file: content.file, series },
        None => ColumnSource::Table(content.table()?),
    };
    columns.check(mapping_file, mapping)?;
    let facts = Facts {
        position: mapping.position,
        attitude: mapping.attitude,
        airborne_above_m: mapping.airborne_above_m,
    };
    Ok(columns.channels(mapping, &mut notes)?.flight(READER.name, &facts, notes))
}

/// Columns by name, from any source.
enum ColumnSource<'a> {
    Table(&'a Table),
    Series { file: &'a str, series: &'a [Series] },
}

impl ColumnSource<'_> {
    fn names(&self) -> Vec<&str> {
        match self {
            Self::Table(table) => table.header.iter().map(String::as_str).collect(),
            Self::Series { series, .. } => series.iter().map(|series| series.name.as_str()).collect(),
        }
    }

    fn file(&self) -> &str {
        match self {
            Self::Table(table) => &table.file,
            Self::Series { file, .. } => file,
        }
    }

    /// Every column that the mapping names has to be there.
    fn check(&self, mapping_file: &str, mapping: &Mapping) -> Result<()> {
        let names = self.names();
        let times = mapping.sources.iter().filter_map(|source| Some((source.time.as_ref()?, "time")));
        let clock =
            mapping.time.column.iter().filter(|_| matches!(self, Self::Table(_))).map(|time| (time, "time"));
        let named = mapping.sources.iter().map(|source| (&source.column, source.channel.name));
        for (column, channel) in named.chain(times).chain(clock) {
            if !names.contains(&column.as_str()) {
                let alike = closest(column, &names);
                let hint = alike.map_or(String::new(), |name| format!(" (did you mean \"{name}\"?)"));
                return Err(LogError::Unusable(format!(
                    "{}: has no column \"{column}\", which {mapping_file} maps to {channel}{hint}",
                    self.file()
                )));
            }
        }
        Ok(())
    }

    /// The mapped columns as channels.
    fn channels(&self, mapping: &Mapping, notes: &mut Vec<Note>) -> Result<Channels> {
        let start_s = self.start_s()?;
        if let Self::Table(table) = self
            && mapping.time.unit.is_none()
        {
            let clock = table.clock()?;
            notes.push(Note::TimeUnit { column: clock.column.clone(), unit: clock.unit.name });
        }
        notes.push(Note::TimeShifted { start_s });
        let mut series = Vec::new();
        for source in &mapping.sources {
            let mut of_source = self.series(source)?;
            of_source.t_s.iter_mut().for_each(|t| *t -= start_s);
            if source.channel.quantity == Quantity::Time {
                // The capture time of a fix is a time itself.
                let tick_s = if let Self::Table(table) = self { table.clock()?.unit.seconds } else { 1.0 };
                of_source.values.iter_mut().for_each(|stamp| *stamp = *stamp * tick_s - start_s);
            }
            series.push(of_source.in_order(notes));
            if source.channel.quantity == Quantity::Pwm && source.unit != "pwm" {
                notes.push(Note::ScaledToPwm {
                    channel: source.channel.name.to_owned(),
                    unit: source.unit.to_owned(),
                });
            }
        }
        let all_s = match self {
            Self::Table(table) => table.clock()?.t_s.clone(),
            Self::Series { series, .. } => longest_times(series),
        };
        let t_s: Vec<f64> = all_s.iter().map(|t| t - start_s).collect();
        let rows = Series { name: "time".to_owned(), values: t_s.clone(), t_s };
        Ok(Channels::new(series, || rows.in_order(notes).t_s))
    }

    /// The time of the first row.
    fn start_s(&self) -> Result<f64> {
        let first = match self {
            Self::Table(table) => table.clock()?.t_s.first().copied(),
            Self::Series { series, .. } => {
                series.iter().filter_map(|series| series.t_s.first().copied()).min_by(f64::total_cmp)
            }
        };
        first.ok_or_else(|| LogError::NoRows { file: self.file().to_owned() })
    }

    /// The values of a source in the log's unit, at the times of the file's clock.
    fn series(&self, source: &Source) -> Result<Series> {
        let name = source.channel.name.to_owned();
        let (t_s, raw, rows) = match self {
            Self::Table(table) => {
                let (rows, raw) = table.cells(&source.column, NUMBER)?;
                let clock = table.clock()?;
                let own = source.time.as_ref().map(|column| table.column(column, NUMBER)).transpose()?;
                let time =
                    |row: &usize| own.as_ref().map_or(clock.t_s[*row], |own| own[*row] * clock.unit.seconds);
                (rows.iter().map(time).collect(), raw, rows)
            }
            Self::Series { series, .. } => {
                let of_name = |name: &str| series.iter().find(|series| series.name == name);
                let column = of_name(&source.column).cloned();
                let Series { t_s, values, .. } =
                    column.unwrap_or(Series { name: name.clone(), t_s: Vec::new(), values: Vec::new() });
                let own = source.time.as_deref().and_then(of_name).map(|series| series.values.clone());
                let rows = (0..values.len()).collect();
                (own.filter(|own| own.len() == values.len()).unwrap_or(t_s), values, rows)
            }
        };
        if raw.is_empty() {
            return Err(self.bad(0, source, "", "a number in at least one row"));
        }
        let values: Vec<f64> = raw.iter().map(|value| in_log(source, *value)).collect();
        if source.channel.quantity == Quantity::Pwm
            && let Some(at) = values.iter().position(|value| !PWM.admits(*value))
        {
            return Err(self.bad(rows[at], source, &raw[at].to_string(), expected(source.unit)));
        }
        Ok(Series { name, t_s, values })
    }

    fn bad(&self, row: usize, source: &Source, found: &str, expected: &'static str) -> LogError {
        match self {
            Self::Table(table) => table.bad(row, &source.column, found, expected),
            Self::Series { file, .. } => LogError::Unusable(format!(
                "{file}, \"{}\", record {row}: found {found}, expected {expected}",
                source.column
            )),
        }
    }
}

/// A value in the log's unit.
fn in_log(source: &Source, value: f64) -> f64 {
    match (source.channel.quantity, source.force_n) {
        (Quantity::Time, _) => value,
        (_, Some(force_n)) => pwm_of_force((value + source.offset) * source.factor * force_n),
        _ => (value + source.offset) * source.factor,
    }
}

/// The range of a command in the unit of the file.
fn expected(unit: &str) -> &'static str {
    match unit {
        "fraction" => "a share from 0 to 1",
        "percent" => "a share from 0 to 100 per cent",
        "pwm8" => "a command from 0 to 255",
        _ => "a PWM command from 0 to 65535",
    }
}
