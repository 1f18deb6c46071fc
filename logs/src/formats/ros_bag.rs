//! ROS 1 bags, format 2.0: records of named header fields and data, messages in chunks that may be
//! compressed.
//!
//! Read here rather than by a crate: the existing one maps files by unsafe code, panics on a bag whose recorder was
//! killed (its index position is 0), and allocates by a damaged header.

use std::collections::HashMap;

use crate::bytes::{Bytes, Room};
use crate::message::{Encoding, Kind};
use crate::topics::{StoredMessage, Topics};
use crate::{Columns, Content, FlightLog, LogError, Note, Reader, Result, ros};

const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

const OP_MESSAGE: u8 = 2;
const OP_HEADER: u8 = 3;
const OP_CHUNK: u8 = 5;
const OP_CONNECTION: u8 = 7;

/// The header fields of a record that are used.
#[derive(Debug, Default)]
struct Header<'a> {
    op: u8,
    connection: Option<u32>,
    time_ns: Option<u64>,
    topic: Option<&'a str>,
    kind: Option<&'a str>,
    compression: Option<&'a str>,
    size: Option<u32>,
}

/// A record: its header fields and its data.
fn record<'a>(bytes: &mut Bytes<'a>) -> Option<(Header<'a>, &'a [u8])> {
    let header = header(bytes.block()?)?;
    Some((header, bytes.block()?))
}

fn header(fields: &[u8]) -> Option<Header<'_>> {
    let mut bytes = Bytes::new(fields);
    let mut header = Header::default();
    while bytes.remaining() > 0 {
        let field = bytes.block()?;
        let name_ends = field.iter().position(|byte| *byte == b'=')?;
        let (name, value) = (&field[..name_ends], &field[name_ends + 1..]);
        let mut number = Bytes::new(value);
        match name {
            b"op" => header.op = number.u8()?,
            b"conn" => header.connection = number.u32(),
            b"time" => {
                header.time_ns = Some(u64::from(number.u32()?) * 1_000_000_000 + u64::from(number.u32()?))
            }
            b"topic" => header.topic = std::str::from_utf8(value).ok(),
            b"type" => header.kind = std::str::from_utf8(value).ok(),
            b"compression" => header.compression = std::str::from_utf8(value).ok(),
            b"size" => header.size = number.u32(),
            _ => {}
        }
    }
    Some(header)
}

pub(crate) static READER: Reader =
    Reader { name: "ros_bag", title: "a ROS 1 bag", magic: MAGIC, read, columns, ..Reader::TEXT };

fn read(content: &Content<'_>, mut notes: Vec<Note>) -> Result<FlightLog> {
    ros::read(READER.name, content, topics(content, &mut notes)?, notes)
}

fn columns(content: &Content<'_>, notes: &mut Vec<Note>) -> Result<Option<Columns>> {
    topics(content, notes)?.columns(content.file, content.part, notes)
}

/// Returns the messages of a bag, by topic. Truncation or damage after the first record ends the reading with a note.
fn topics(content: &Content<'_>, notes: &mut Vec<Note>) -> Result<Topics> {
    let (file, data) = (content.file, content.bytes);
    let mut bytes = Bytes::new(data);
    bytes.take(MAGIC.len());
    let room = Room { file, limit_mib: content.limit_mib, unpacked: 0 };
    let mut bag = Bag { connections: HashMap::new(), topics: Topics::default(), room };
    if record(&mut bytes).is_none_or(|(header, _)| header.op != OP_HEADER) {
        let expected = "the header record of a bag";
        return Err(LogError::BadBinary { file: file.to_owned(), byte: bytes.position(), expected });
    }
    while bytes.remaining() > 0 {
        let start = bytes.position();
        let reason = match record(&mut bytes) {
            None => {
                bag.cut_chunk(&data[start..])?;
                Some("the last record is not whole")
            }
            Some((header, data)) if header.op == OP_CHUNK => bag.chunk(&header, data)?,
            Some((header, data)) => bag.take(&header, data),
        };
        if let Some(reason) = reason {
            notes.push(Note::cut_short(start, bag.topics.messages(), "messages", reason));
            break;
        }
    }
    Ok(bag.topics)
}

/// A bag while it is read.
struct Bag<'f> {
    /// Topic and message type by connection.
    connections: HashMap<u32, (String, String)>,
    topics: Topics,
    room: Room<'f>,
}

impl Bag<'_> {
    /// Takes what there is of a chunk that is cut off.
    fn cut_chunk(&mut self, data: &[u8]) -> Result<()> {
        let mut bytes = Bytes::new(data);
        let header = bytes.block().and_then(header).filter(|header| header.op == OP_CHUNK);
        if let (Some(header), Some(_length)) = (header, bytes.u32()) {
            self.chunk(&header, bytes.rest())?;
        }
        Ok(())
    }

    /// Takes the records of a chunk. Returns why the reading has to end here, if so.
    fn chunk(&mut self, header: &Header<'_>, data: &[u8]) -> Result<Option<&'static str>> {
        let (unpacked, is_whole) = match header.compression {
            Some("none") => self.room.unpack(Ok(data))?,
            Some("lz4") => self.room.unpack(lz4::Decoder::new(data))?,
            Some("bz2") => self.room.unpack(Ok(bzip2::read::BzDecoder::new(data)))?,
            _ => return Ok(Some("a chunk is compressed by something else than lz4 or bz2")),
        };
        let mut bytes = Bytes::new(&unpacked);
        while bytes.remaining() > 0 {
            let Some((header, data)) = record(&mut bytes) else {
                return Ok(Some("a record in a chunk is not whole"));
            };
            if let Some(reason) = self.take(&header, data) {
                return Ok(Some(reason));
            }
        }
        let short = !is_whole || header.size.is_some_and(|size| size as usize != unpacked.len());
        Ok(short.then_some("a chunk is not as long as it says"))
    }

    /// Takes a connection or a message. Returns why the reading has to end here, if so.
    fn take(&mut self, header: &Header<'_>, data: &[u8]) -> Option<&'static str> {
        match (header.op, header.connection) {
            (OP_CONNECTION, Some(id)) => {
                // The data repeats the topic as the publisher named it, and holds the type.
                let Some(inner) = self::header(data) else { return Some("a connection is damaged") };
                let topic = header.topic.or(inner.topic).unwrap_or_default().to_owned();
                self.connections.insert(id, (topic, inner.kind.unwrap_or_default().to_owned()));
            }
            (OP_MESSAGE, Some(id)) => {
                let Some(((topic, kind), recorded_ns)) = self.connections.get(&id).zip(header.time_ns) else {
                    return Some("a message belongs to no connection");
                };
                let read_as = Kind::from_name(kind).map(|kind| (kind, Encoding::Ros1));
                self.topics.add(topic, kind, StoredMessage { recorded_ns, data }, read_as);
            }
            (OP_CONNECTION | OP_MESSAGE, None) => return Some("a record names no connection"),
            // Index and chunk information repeat what the chunks hold.
            _ => {}
        }
        None
    }
}
