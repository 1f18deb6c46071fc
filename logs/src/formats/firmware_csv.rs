//! CSV of the Crazyflie's own variables: what cfclient writes, and what scripts with cflib write in its
//! manner.
//!
//! A time stamp and variables such as `stateEstimate.x`, in any order; a cell is empty if the variable's packet did
//! not arrive in that row. Units and signs are the firmware's.

use crate::firmware::{self, Variables};
use crate::names::outside_axis;
use crate::quantity::CHANNELS;
use crate::series::{Series, longest_times};
use crate::table::{NUMBER, Table};
use crate::variables::{group_of, variable};
use crate::{Content, FlightLog, LogError, Note, Reader, Result};

/// Fewer variables are a coincidence of names.
const LEAST_VARIABLES: usize = 2;

pub(crate) static READER: Reader = Reader {
    name: "firmware_csv",
    title: "a CSV of firmware variables (cfclient, cflib)",
    share,
    read,
    ..Reader::TEXT
};

/// Which variables are logged is up to whoever flew: two of them are enough.
fn share(header: &[String]) -> f64 {
    let known = header.iter().filter(|name| variable(name).is_some()).count();
    if known < LEAST_VARIABLES {
        return 0.0;
    }
    0.5 + 0.5 * known as f64 / header.len() as f64
}

fn read(content: &Content<'_>, mut notes: Vec<Note>) -> Result<FlightLog> {
    let series = series(content.table()?, &mut notes)?;
    let variables = Variables::on_rows(content.file, &longest_times(&series), series, &mut notes)?;
    firmware::flight(READER.name, &variables, notes)
}

/// The filled cells of every variable, each with its own times.
fn series(table: &Table, notes: &mut Vec<Note>) -> Result<Vec<Series>> {
    let clock = table.clock()?;
    notes.push(Note::TimeUnit { column: clock.column.clone(), unit: clock.unit.name });
    let mut all: Vec<Series> = Vec::new();
    let mut ignored = Vec::new();
    let outside = outside_columns(table);
    for column in table.header.iter().filter(|column| **column != clock.column) {
        let as_outside = outside.iter().flatten().position(|known| known == column);
        let Some(name) = as_outside.map(|axis| OUTSIDE[axis].to_owned()).or_else(|| variable(column)) else {
            ignored.push(column.clone());
            continue;
        };
        let (rows, mut values) = table.cells(column, NUMBER)?;
        if all.iter().any(|known| known.name == name) {
            return Err(LogError::DuplicateColumn { file: table.file.clone(), column: column.clone() });
        }
        if as_outside.is_some() {
            notes.push(Note::OutsideColumn { column: column.clone() });
        }
        if let Some((factor, unit)) = table.unit(column).and_then(|said| other_unit(&name, said)) {
            notes.push(Note::ReadInUnit { column: column.clone(), unit });
            values.iter_mut().for_each(|value| *value *= factor);
        }
        let t_s = rows.iter().map(|row| clock.t_s[*row]).collect();
        all.push(Series { name, t_s, values }.in_order(notes));
    }
    if !ignored.is_empty() {
        notes.push(Note::IgnoredColumns { columns: ignored });
    }
    Ok(all)
}

/// Variables of a position from outside.
const OUTSIDE: [&str; 3] = ["locSrv.x", "locSrv.y", "locSrv.z"];

/// Columns of a position from outside beside the firmware's variables, such as `mocap_x`: all three, or none.
fn outside_columns(table: &Table) -> Option<[String; 3]> {
    let of_axis = |axis| {
        table.header.iter().find(|name| variable(name).is_none() && outside_axis(name) == Some(axis)).cloned()
    };
    let is_logged = table.header.iter().any(|name| variable(name).is_some_and(|name| name == OUTSIDE[0]));
    Some([of_axis(0)?, of_axis(1)?, of_axis(2)?]).filter(|_| !is_logged)
}

/// Returns the factor from the unit in a file to the firmware's, if they differ, and its name.
fn other_unit(name: &str, said: &str) -> Option<(f64, &'static str)> {
    let (group, _) = group_of(name)?;
    let mut quantities = CHANNELS.iter().map(|channel| channel.quantity);
    let quantity = quantities.find(|quantity| quantity.factor(group.unit.name).is_some())?;
    let (said, factor) =
        quantity.units().iter().find(|(unit, _)| unit.eq_ignore_ascii_case(said)).copied()?;
    (said != group.unit.name).then_some((factor / quantity.factor(group.unit.name)?, said))
}
