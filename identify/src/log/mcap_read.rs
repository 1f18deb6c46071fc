//! MCAP files: the project's own rows, or the ROS messages of the thesis's rig.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use csv::ByteRecord;
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use serde_json::value::RawValue;

use super::mcap_write::{ENCODING, SCHEMA};
use super::message::{Encoding, Kind};
use super::table::Table;
use super::topics::{Recorded, Topics};
use super::{FlightLog, LogError, Note, detect, project, ros};

/// A message of a flight has some hundred bytes; pictures, which are passed over, some MiB.
const LONGEST_RECORD: usize = 64 << 20;
/// What all records together may hold once unpacked.
const MOST_UNPACKED: usize = 512 << 20;
const READ_AT_ONCE: usize = 1 << 20;
/// The project's form has 35 columns.
const MOST_COLUMNS: usize = 256;

pub(super) fn read(file: &str, data: &[u8], mut notes: Vec<Note>) -> Result<FlightLog, LogError> {
    let mut content = Content {
        file,
        schemas: HashMap::new(),
        channels: HashMap::new(),
        rows: Vec::new(),
        rows_topic: String::new(),
        topics: Topics::default(),
    };
    content.read(data, &mut notes)?;
    if content.rows.is_empty() {
        return ros::read(file, &content.topics, notes);
    }
    let name = format!("{file} (topic {}, a line per message)", content.rows_topic);
    let table = table(name, &content)?;
    detect::format(&table, &mut notes)?;
    project::read(&table, notes)
}

/// How the messages of a channel are read.
#[derive(Debug, Clone)]
struct Channel {
    topic: String,
    type_name: String,
    /// The project's own rows.
    is_row: bool,
    read_as: Option<(Kind, Encoding)>,
}

/// A file while it is read.
struct Content<'f> {
    file: &'f str,
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, Channel>,
    /// The project's own messages, JSON.
    rows: Vec<Vec<u8>>,
    rows_topic: String,
    topics: Topics,
}

impl Content<'_> {
    /// Reads all records. What is cut off or damaged ends the reading with a note.
    fn read(&mut self, data: &[u8], notes: &mut Vec<Note>) -> Result<(), LogError> {
        let options = LinearReaderOptions::default().with_validate_chunk_crcs(true).with_record_length_limit(LONGEST_RECORD);
        let mut reader = LinearReader::new_with_options(options);
        let (mut fed, mut unpacked) = (0, 0);
        while let Some(event) = reader.next_event() {
            let failed = match event {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    let count = wanted.clamp(1, READ_AT_ONCE).min(data.len() - fed);
                    // An empty piece tells the reader that the file ends.
                    reader.insert(count).copy_from_slice(&data[fed..fed + count]);
                    reader.notify_read(count);
                    fed += count;
                    None
                }
                Ok(LinearReadEvent::Record { data, opcode }) => {
                    unpacked += data.len();
                    if unpacked > MOST_UNPACKED {
                        return Err(LogError::TooLarge { file: self.file.to_owned(), limit_mib: MOST_UNPACKED as u64 >> 20 });
                    }
                    mcap::parse_record(opcode, data).map(|record| self.take(record)).err()
                }
                Err(error) => Some(error),
            };
            if let Some(error) = failed {
                let kept = self.rows.len() + self.topics.messages();
                notes.push(Note::CutShort { byte: fed, kept, unit: "messages", reason: error.to_string() });
                break;
            }
        }
        Ok(())
    }

    fn take(&mut self, record: Record<'_>) {
        match record {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let type_name = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                let encoding = match channel.message_encoding.as_str() {
                    "ros1" => Some(Encoding::Ros1),
                    "cdr" => Some(Encoding::Cdr),
                    _ => None,
                };
                let is_row = type_name == SCHEMA && channel.message_encoding == ENCODING;
                let read_as = Kind::named(&type_name).zip(encoding);
                self.channels.insert(channel.id, Channel { topic: channel.topic, type_name, is_row, read_as });
            }
            Record::Message { header, data } => match self.channels.get(&header.channel_id) {
                Some(channel) if channel.is_row => {
                    self.rows_topic.clone_from(&channel.topic);
                    self.rows.push(data.into_owned());
                }
                Some(channel) => {
                    let message = Recorded { recorded_ns: header.log_time, data: &data };
                    self.topics.add(&channel.topic, &channel.type_name, message, channel.read_as);
                }
                None => self.topics.add("?", "a channel that is not declared", Recorded { recorded_ns: 0, data: &[] }, None),
            },
            _ => {}
        }
    }
}

/// The rows as a table of the very digits that the messages hold.
fn table(name: String, content: &Content<'_>) -> Result<Table, LogError> {
    let bad = |index, reason: String| LogError::BadMessage {
        file: content.file.to_owned(),
        topic: content.rows_topic.clone(),
        index,
        expected: "a JSON object of numbers",
        reason,
    };
    let mut rows: Vec<BTreeMap<String, &RawValue>> = Vec::new();
    for (index, row) in content.rows.iter().enumerate() {
        rows.push(serde_json::from_slice(row).map_err(|error| bad(index, error.to_string()))?);
    }
    let mut header: BTreeSet<&String> = BTreeSet::new();
    for (index, row) in rows.iter().enumerate() {
        header.extend(row.keys());
        if header.len() > MOST_COLUMNS {
            return Err(bad(index, format!("more than {MOST_COLUMNS} names")));
        }
    }
    let cell = |value: Option<&&RawValue>| value.map(|raw| raw.get()).filter(|text| *text != "null").unwrap_or_default().to_owned();
    let records = rows.iter().map(|row| header.iter().map(|name| cell(row.get(*name))).collect::<Vec<String>>());
    let records = records.map(|cells| ByteRecord::from(cells)).collect();
    Ok(Table::of_cells(name, header.into_iter().cloned().collect(), records))
}
