//! CSV of the Crazyflie's own variables: what cfclient writes, and what scripts with cflib write in its
//! manner.
//!
//! A time stamp and variables such as `stateEstimate.x`, in any order; a cell is empty where the variable's
//! packet did not come in that row. Units and signs are the firmware's.

use crate::firmware::{self, PWM_VARIABLES, Variables, is_used};
use crate::series::Series;
use crate::table::{NUMBER, PWM, Table};
use crate::times::{guess_unit, time_column};
use crate::{Content, FlightLog, LogError, Note, Reader};

/// Fewer variables are a coincidence of names.
const LEAST_VARIABLES: usize = 2;

pub(crate) struct FirmwareCsv;

impl Reader for FirmwareCsv {
    fn name(&self) -> &'static str {
        "firmware_csv"
    }

    fn title(&self) -> &'static str {
        "a CSV of firmware variables (cfclient, cflib)"
    }

    /// Which variables are logged is up to whoever flew: two of them and a time are enough.
    fn share(&self, content: &Content<'_>) -> f64 {
        let known = content.header.iter().filter(|name| variable(name).is_some()).count();
        if known < LEAST_VARIABLES || time_column(&content.header).is_none() {
            return 0.0;
        }
        0.5 + 0.5 * known as f64 / content.header.len() as f64
    }

    fn read(&self, content: &Content<'_>, mut notes: Vec<Note>) -> Result<FlightLog, LogError> {
        let table = content.table(&mut notes)?;
        let Some(time) = time_column(&table.header) else {
            return Err(LogError::UnknownFormat { file: table.file, found: table.header.join(", ") });
        };
        let series = series(&table, time, &mut notes)?;
        let rows_s = series
            .iter()
            .max_by_key(|series| series.t_s.len())
            .map_or(Vec::new(), |series| series.t_s.clone());
        let variables = Variables::on_rows(content.file, &rows_s, series, &mut notes)?;
        firmware::flight(self.name(), &variables, notes)
    }
}

/// The firmware's name of a column, if a flight has a use for it; some scripts write an underscore for the
/// dot.
fn variable(column: &str) -> Option<String> {
    let name = if column.contains('.') { column.to_owned() } else { column.replacen('_', ".", 1) };
    is_used(&name).then_some(name)
}

/// The filled cells of every variable, each with its own times.
fn series(table: &Table, time: &str, notes: &mut Vec<Note>) -> Result<Vec<Series>, LogError> {
    let times = table.column(time, NUMBER)?;
    let unit = guess_unit(&times);
    notes.push(Note::TimeUnit { column: time.to_owned(), unit: unit.name });
    let mut all: Vec<Series> = Vec::new();
    let mut ignored = Vec::new();
    for column in table.header.iter().filter(|column| *column != time) {
        let Some(name) = variable(column) else {
            ignored.push(column.clone());
            continue;
        };
        let accept = if PWM_VARIABLES.contains(&name.as_str()) { PWM } else { NUMBER };
        let (rows, values) = table.cells(column, accept)?;
        if all.iter().any(|known| known.name == name) {
            return Err(LogError::DuplicateColumn { file: table.file.clone(), column: column.clone() });
        }
        let t_s = rows.iter().map(|row| times[*row] * unit.seconds).collect();
        all.push(Series { name, t_s, values }.in_order(notes));
    }
    if !ignored.is_empty() {
        notes.push(Note::IgnoredColumns { columns: ignored });
    }
    Ok(all)
}
