//! Any CSV, by a mapping file.

use crate::channels::{Channels, Facts};
use crate::columns::closest;
use crate::mapping::{Mapping, Quantity, Source};
use crate::series::Series;
use crate::table::{NUMBER, PWM, Table};
use crate::times::guess_unit;
use crate::{Content, FlightLog, LogError, Note, Reader};

pub(crate) struct MappedReader;

impl Reader for MappedReader {
    fn name(&self) -> &'static str {
        "mapped_csv"
    }

    fn title(&self) -> &'static str {
        "a CSV read by a mapping file"
    }

    /// Whoever wrote a mapping means it: no other format is a better match.
    fn share(&self, content: &Content<'_>) -> f64 {
        f64::from(u8::from(content.mapping.is_some() && !content.header.is_empty()))
    }

    fn read(&self, content: &Content<'_>, mut notes: Vec<Note>) -> Result<FlightLog, LogError> {
        let table = content.table(&mut notes)?;
        let Some((mapping_file, mapping)) = &content.mapping else {
            return Err(LogError::UnknownFormat { file: table.file, found: table.header.join(", ") });
        };
        check_columns(&table, mapping_file, mapping)?;
        let facts = Facts {
            position: mapping.position,
            attitude: mapping.attitude,
            airborne_above_m: mapping.airborne_above_m,
        };
        Ok(channels(&table, mapping, &mut notes)?.flight(self.name(), &facts, notes))
    }
}

/// Every column that the mapping names has to be there.
fn check_columns(table: &Table, mapping_file: &str, mapping: &Mapping) -> Result<(), LogError> {
    let times = mapping.sources.iter().filter_map(|source| Some((source.time.as_ref()?, "time")));
    let named = mapping
        .sources
        .iter()
        .map(|source| (&source.column, source.channel.name))
        .chain(times)
        .chain([(&mapping.time, "time")]);
    for (column, channel) in named {
        if !table.has(column) {
            return Err(LogError::UnmappedColumn {
                file: table.file.clone(),
                column: column.clone(),
                mapping: mapping_file.to_owned(),
                channel: channel.to_owned(),
                did_you_mean: closest(column, &table.header),
            });
        }
    }
    Ok(())
}

/// The mapped columns as channels.
fn channels(table: &Table, mapping: &Mapping, notes: &mut Vec<Note>) -> Result<Channels, LogError> {
    let times = table.column(&mapping.time, NUMBER)?;
    let unit = mapping.time_unit.unwrap_or_else(|| guess_unit(&times));
    if mapping.time_unit.is_none() {
        notes.push(Note::TimeUnit { column: mapping.time.clone(), unit: unit.name });
    }
    let start = times[0];
    notes.push(Note::TimeShifted { start_s: start * unit.seconds });
    let seconds = |time: f64| (time - start) * unit.seconds;
    let mut series = Vec::new();
    for source in &mapping.sources {
        let (rows, values) = cells(table, source)?;
        let own = source.time.as_ref().map(|column| table.column(column, NUMBER)).transpose()?;
        let times = own.as_ref().unwrap_or(&times);
        // The capture time of a fix is a time itself.
        let value =
            |value: &f64| if source.channel.quantity == Quantity::Time { seconds(*value) } else { *value };
        let t_s = rows.iter().map(|row| seconds(times[*row])).collect();
        let name = source.channel.name.to_owned();
        series.push(Series { name, t_s, values: values.iter().map(value).collect() }.in_order(notes));
        if source.channel.quantity == Quantity::Pwm && source.unit != "pwm" {
            notes.push(Note::ScaledToPwm {
                channel: source.channel.name.to_owned(),
                unit: source.unit.to_owned(),
            });
        }
    }
    let rows = Series {
        name: mapping.time.clone(),
        t_s: times.iter().map(|t| seconds(*t)).collect(),
        values: times.clone(),
    };
    Ok(Channels::new(series, || rows.in_order(notes).t_s))
}

/// The filled cells of a source in the log's unit.
fn cells(table: &Table, source: &Source) -> Result<(Vec<usize>, Vec<f64>), LogError> {
    let (rows, values) = table.cells(&source.column, NUMBER)?;
    let values: Vec<f64> = match source.channel.quantity {
        Quantity::Time => values,
        _ => values.into_iter().map(|value| value * source.factor).collect(),
    };
    if source.channel.quantity == Quantity::Pwm
        && let Some(at) = values.iter().position(|value| !PWM.admits(*value))
    {
        let found = format!("{}", values[at] / source.factor);
        let expected = match source.unit {
            "fraction" => "a share from 0 to 1",
            "percent" => "a share from 0 to 100 per cent",
            "pwm8" => "a command from 0 to 255",
            _ => "a PWM command from 0 to 65535",
        };
        return Err(table.bad(rows[at], &source.column, &found, expected));
    }
    if rows.is_empty() {
        return Err(table.bad(0, &source.column, "", "a number in at least one row"));
    }
    Ok((rows, values))
}
