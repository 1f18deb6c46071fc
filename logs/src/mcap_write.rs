//! Writing a flight as MCAP, which plotting tools such as Foxglove open.

use std::collections::BTreeMap;
use std::io::{Error, Seek, Write};

use mcap::records::MessageHeader;
use mcap::{McapError, Writer};

use super::write::Column;
use super::{FlightLog, LogError, Result};

/// The topic of the rows.
pub(super) const TOPIC: &str = "/crazyflie/flight";
/// The name of the schema, by which the reader knows the project's own files.
pub(super) const SCHEMA: &str = "crazyflie.FlightRow";
pub(super) const ENCODING: &str = "json";

impl FlightLog {
    /// Writes the log as MCAP: one JSON message per row with the columns of the project CSV, in the same
    /// digits; the marker's are absent where no frame arrived. It reads back as the CSV does, to the bit.
    ///
    /// # Errors
    /// [`LogError::CannotWrite`] as [`FlightLog::write_csv`]; [`LogError::WriteMcap`] when `out` fails.
    pub fn write_mcap(&self, out: impl Write + Seek) -> Result<()> {
        let columns = self.columns()?;
        let failed = |error| match error {
            McapError::Io(error) => LogError::WriteMcap(error),
            other => LogError::WriteMcap(Error::other(other)),
        };
        self.write_messages(&columns, out).map_err(failed)
    }

    fn write_messages(&self, columns: &[Column<'_>], out: impl Write + Seek) -> Result<(), McapError> {
        let mut writer = Writer::new(out)?;
        let schema_id = writer.add_schema(SCHEMA, "jsonschema", schema(columns).as_bytes())?;
        let channel_id = writer.add_channel(schema_id, TOPIC, ENCODING, &BTreeMap::new())?;
        // Times of the container are positive whole nanoseconds; the exact one is in the message.
        let start_s = self.t_s.first().map_or(0.0, |t| t.min(0.0));
        let mut next_fix = 0;
        for (row, t_s) in self.t_s.iter().enumerate() {
            let has_fix = self.fixes.row.get(next_fix) == Some(&row);
            let cells = columns
                .iter()
                .filter_map(|column| Some((column.name, column.cell(row, has_fix.then_some(next_fix))?)));
            let fields: Vec<String> = cells.map(|(name, cell)| format!("\"{name}\":{cell}")).collect();
            let time_ns = ((t_s - start_s) * 1e9).round() as u64;
            let header =
                MessageHeader { channel_id, sequence: row as u32, log_time: time_ns, publish_time: time_ns };
            writer.write_to_known_channel(&header, format!("{{{}}}", fields.join(",")).as_bytes())?;
            next_fix += usize::from(has_fix);
        }
        writer.finish()?;
        writer.into_inner().flush()?;
        Ok(())
    }
}

/// A JSON schema: every column a number, all but the marker's in every message.
fn schema(columns: &[Column<'_>]) -> String {
    let number = |column: &Column<'_>| (column.name.to_owned(), serde_json::json!({"type": "number"}));
    let properties: serde_json::Map<_, _> = columns.iter().map(number).collect();
    let required: Vec<&str> =
        columns.iter().filter(|column| column.is_dense()).map(|column| column.name).collect();
    serde_json::json!({"title": SCHEMA, "type": "object", "properties": properties, "required": required})
        .to_string()
}
