//! MCAP files: the project's own rows, or the ROS messages of the thesis's rig.
//!
//! The crate that writes them is not used to read them: it allocates by a damaged length.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use csv::ByteRecord;
use mcap::records::op;
use serde_json::value::RawValue;

use super::project;
use crate::bytes::{Bytes, Room};
use crate::mcap_write::{ENCODING, SCHEMA};
use crate::message::{Encoding, Kind};
use crate::table::Table;
use crate::topics::{StoredMessage, Topics};
use crate::{Columns, Content, FlightLog, LogError, Note, Reader, Result, ros};

/// The project's form has 35 columns.
const MOST_COLUMNS: usize = 256;

pub(crate) static READER: Reader =
    Reader { name: "mcap", title: "an MCAP recording", magic: mcap::MAGIC, read, columns, ..Reader::TEXT };

fn read(content: &Content<'_>, mut notes: Vec<Note>) -> Result<FlightLog> {
    let recording = Recording::read(content, &mut notes)?;
    if recording.rows.is_empty() {
        return ros::read(READER.name, content, recording.topics, notes);
    }
    let name = format!("{} (topic {}, a line per message)", content.file, recording.rows_topic);
    let table = table(name, &recording)?;
    project::LAYOUT.check(project::READER.title, &table, &mut notes)?;
    project::read(&table, notes)
}

fn columns(content: &Content<'_>, notes: &mut Vec<Note>) -> Result<Option<Columns>> {
    Recording::read(content, notes)?.topics.columns(content.file, content.part, notes)
}

/// Decoding of a channel's messages.
#[derive(Debug, Clone)]
struct Channel {
    topic: String,
    type_name: String,
    /// The project's own rows.
    is_row: bool,
    read_as: Option<(Kind, Encoding)>,
}

/// A file while it is read.
#[derive(Default)]
struct Recording<'f> {
    file: &'f str,
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, Channel>,
    /// The project's own messages, JSON.
    rows: Vec<Vec<u8>>,
    rows_topic: String,
    topics: Topics,
    room: Room<'f>,
}

impl<'f> Recording<'f> {
    fn read(content: &Content<'f>, notes: &mut Vec<Note>) -> Result<Self> {
        let room = Room { file: content.file, limit_mib: content.limit_mib, unpacked: 0 };
        let mut recording = Self { file: content.file, room, ..Self::default() };
        recording.take_all(content.bytes, notes)?;
        Ok(recording)
    }

    /// Reads all records. A truncated or damaged record ends the reading with a note.
    fn take_all(&mut self, data: &[u8], notes: &mut Vec<Note>) -> Result<()> {
        let mut bytes = Bytes::new(data);
        bytes.take(mcap::MAGIC.len());
        loop {
            let start = bytes.position();
            let reason = match record(&mut bytes) {
                // After it, only an index and statistics follow.
                Some((op::DATA_END, _)) => return Ok(()),
                Some((op::CHUNK, body)) => self.chunk(body)?,
                Some((opcode, body)) => self.take(opcode, body),
                None => {
                    self.cut_chunk(&data[start..])?;
                    Some("the file ends in the middle of its records")
                }
            };
            if let Some(reason) = reason {
                let kept = self.rows.len() + self.topics.messages();
                notes.push(Note::cut_short(start, kept, "messages", reason));
                return Ok(());
            }
        }
    }

    /// Takes what there is of a chunk that is cut off.
    fn cut_chunk(&mut self, data: &[u8]) -> Result<()> {
        let mut bytes = Bytes::new(data);
        if let (Some(op::CHUNK), Some(_length)) = (bytes.u8(), bytes.u64()) {
            self.chunk(bytes.rest())?;
        }
        Ok(())
    }

    /// Takes the records of a chunk. Returns why the reading has to end here, if so.
    fn chunk(&mut self, body: &[u8]) -> Result<Option<&'static str>> {
        let Some(chunk) = Chunk::parse(body) else { return Ok(Some("a chunk is damaged")) };
        let (unpacked, is_whole) = match chunk.compression {
            b"" => self.room.unpack(Ok(chunk.packed))?,
            b"zstd" => self.room.unpack(zstd::Decoder::new(chunk.packed))?,
            b"lz4" => self.room.unpack(lz4::Decoder::new(chunk.packed))?,
            _ => return Ok(Some("a chunk is compressed by something else than zstd or lz4")),
        };
        // Bits that changed would be taken for measurements: a chunk counts as a whole or, if it is cut, up
        // to the cut.
        let is_whole = is_whole && chunk.is_whole;
        if is_whole && chunk.sum != 0 && chunk.sum != crc32fast::hash(&unpacked) {
            return Ok(Some("a chunk's check sum does not match"));
        }
        let mut bytes = Bytes::new(&unpacked);
        while bytes.remaining() > 0 {
            let Some((opcode, body)) = record(&mut bytes) else {
                return Ok(Some("a record in a chunk is not whole"));
            };
            if let Some(reason) = self.take(opcode, body) {
                return Ok(Some(reason));
            }
        }
        Ok((!is_whole).then_some("a chunk cannot be unpacked to its end"))
    }

    /// Takes a schema, a channel or a message. Returns why the reading has to end here, if so.
    fn take(&mut self, opcode: u8, body: &[u8]) -> Option<&'static str> {
        let taken = match opcode {
            op::SCHEMA => self.schema(Bytes::new(body)),
            op::CHANNEL => self.channel(Bytes::new(body)),
            op::MESSAGE => self.message(Bytes::new(body)),
            _ => Some(()),
        };
        if taken.is_some() { None } else { Some("a record is damaged or a message belongs to no channel") }
    }

    fn schema(&mut self, mut bytes: Bytes<'_>) -> Option<()> {
        let id = bytes.u16()?;
        self.schemas.insert(id, text(&mut bytes)?);
        Some(())
    }

    fn channel(&mut self, mut bytes: Bytes<'_>) -> Option<()> {
        let (id, schema_id) = (bytes.u16()?, bytes.u16()?);
        let (topic, encoding) = (text(&mut bytes)?, text(&mut bytes)?);
        let type_name = self.schemas.get(&schema_id).cloned().unwrap_or_default();
        let is_row = type_name == SCHEMA && encoding == ENCODING;
        let encoding = match encoding.as_str() {
            "ros1" => Some(Encoding::Ros1),
            "cdr" => Some(Encoding::Cdr),
            _ => None,
        };
        let read_as = Kind::from_name(&type_name).zip(encoding);
        self.channels.insert(id, Channel { topic, type_name, is_row, read_as });
        Some(())
    }

    fn message(&mut self, mut bytes: Bytes<'_>) -> Option<()> {
        let (id, _sequence) = (bytes.u16()?, bytes.u32()?);
        let (recorded_ns, _published_ns) = (bytes.u64()?, bytes.u64()?);
        let data = bytes.rest();
        let channel = self.channels.get(&id)?;
        if channel.is_row {
            self.rows_topic.clone_from(&channel.topic);
            self.rows.push(data.to_vec());
        } else {
            let message = StoredMessage { recorded_ns, data };
            self.topics.add(&channel.topic, &channel.type_name, message, channel.read_as);
        }
        Some(())
    }
}

/// Opcode and body of a record; `None` if it is not whole.
fn record<'a>(bytes: &mut Bytes<'a>) -> Option<(u8, &'a [u8])> {
    let (opcode, length) = (bytes.u8()?, bytes.u64()?);
    Some((opcode, bytes.take(usize::try_from(length).ok()?)?))
}

fn text(bytes: &mut Bytes<'_>) -> Option<String> {
    bytes.block().map(|text| String::from_utf8_lossy(text).into_owned())
}

/// The parts of a chunk that are used.
struct Chunk<'a> {
    sum: u32,
    compression: &'a [u8],
    packed: &'a [u8],
    is_whole: bool,
}

impl<'a> Chunk<'a> {
    fn parse(body: &'a [u8]) -> Option<Self> {
        let mut bytes = Bytes::new(body);
        // first and last time, unpacked size
        bytes.take(24)?;
        let (sum, compression) = (bytes.u32()?, bytes.block()?);
        let length = bytes.u64()?;
        let packed = bytes.rest();
        let is_whole = packed.len() as u64 == length;
        Some(Self { sum, compression, packed, is_whole })
    }
}

/// Returns the rows as a table of the very digits in the messages.
fn table(name: String, content: &Recording<'_>) -> Result<Table> {
    let bad = |index, reason: String| {
        let (file, topic) = (content.file.to_owned(), content.rows_topic.clone());
        LogError::BadMessage { file, topic, index, expected: "a JSON object of numbers", reason }
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
    let cell = |value: Option<&&RawValue>| {
        value.map(|raw| raw.get()).filter(|text| *text != "null").unwrap_or_default().to_owned()
    };
    let records =
        rows.iter().map(|row| header.iter().map(|name| cell(row.get(*name))).collect::<Vec<String>>());
    let records = records.map(ByteRecord::from).collect();
    Ok(Table::of_cells(name, header.into_iter().cloned().collect(), records))
}
