//! The file format of the Crazyflie's micro-SD deck: typed variables of the firmware, in events.
//!
//! `0xBC`, u16 version, u16 number of event types; for each its u16 id, name, u16 number of variables and
//! those as `name(t)` with a type letter of Python's `struct`; then records of u16 event id, time stamp
//! (version 1: u32 ms, version 2: u64 us) and values; at the end a CRC-32 of all before. Text ends with a
//! zero byte; little endian, packed.

use super::bytes::Bytes;
use super::clock::unwrap_counter;
use super::{LogError, Note, Result};

pub(super) const MAGIC: u8 = 0xbc;
/// The firmware's own limit on names is far below this.
const LONGEST_NAME: usize = 255;
/// The firmware logs up to 10 events with up to a few dozen variables.
const MOST_VARIABLES: usize = 1024;
/// 512 MiB of values; an hour at 1 kHz with 20 variables is a tenth.
const MOST_VALUES: usize = 1 << 26;
const CRC_BYTES: usize = 4;

/// All records of one event type: one column per variable.
#[derive(Debug)]
pub(super) struct Event {
    id: u16,
    pub(super) name: String,
    pub(super) variables: Vec<String>,
    /// Letters of the types in Python's `struct`.
    types: Vec<u8>,
    pub(super) t_s: Vec<f64>,
    pub(super) columns: Vec<Vec<f64>>,
}

/// Reads the events of a file. Truncation or damage after the table of events ends the reading with a note.
pub(super) fn parse(file: &str, data: &[u8], notes: &mut Vec<Note>) -> Result<Vec<Event>> {
    let mut bytes = Bytes::new(data);
    let (version, mut events) = table(&mut bytes).map_err(|expected| LogError::BadBinary {
        file: file.to_owned(),
        byte: bytes.position(),
        expected,
    })?;
    let (mut records, mut values) = (0, 0);
    let ticks_per_s = if version == 1 { 1e3 } else { 1e6 };
    let finish = |mut events: Vec<Event>, notes: &mut Vec<Note>| {
        for event in &mut events {
            let wraps = unwrap_counter(&mut event.t_s, 1.0 / ticks_per_s);
            if wraps > 0 {
                notes.push(Note::ClockWraps { column: event.name.clone(), wraps });
            }
            event.t_s.iter_mut().for_each(|t| *t /= ticks_per_s);
        }
        events
    };
    while bytes.remaining() > CRC_BYTES {
        let start = bytes.position();
        match record(&mut bytes, version, &mut events) {
            Ok(count) => values += count,
            Err(reason) => {
                notes.push(Note::cut_short(start, records, "records", reason));
                return Ok(finish(events, notes));
            }
        }
        records += 1;
        if values > MOST_VALUES {
            return Err(LogError::TooLarge {
                file: file.to_owned(),
                limit_mib: (MOST_VALUES * 8) as u64 >> 20,
            });
        }
    }
    let sum = crc32fast::hash(&data[..bytes.position()]);
    if bytes.remaining() < CRC_BYTES {
        notes.push(Note::cut_short(bytes.position(), records, "records", "the check sum is missing"));
    } else if bytes.u32() != Some(sum) {
        notes.push(Note::WrongChecksum);
    }
    Ok(finish(events, notes))
}

/// The version and the event types; on failure what was expected.
fn table(bytes: &mut Bytes<'_>) -> Result<(u16, Vec<Event>), &'static str> {
    if bytes.u8() != Some(MAGIC) {
        return Err("the magic byte 0xBC");
    }
    let version = bytes.u16().filter(|version| matches!(version, 1 | 2));
    let version = version.ok_or("version 1 or 2 of the micro-SD format")?;
    let count = bytes.u16().ok_or("the number of event types")?;
    let mut events: Vec<Event> = Vec::new();
    let mut variables = 0;
    for _ in 0..count {
        let event = event(bytes)?;
        variables += event.variables.len();
        if variables > MOST_VARIABLES {
            return Err("at most 1024 variables");
        }
        if events.iter().any(|known| known.id == event.id) {
            return Err("event types with different ids");
        }
        events.push(event);
    }
    Ok((version, events))
}

fn event(bytes: &mut Bytes<'_>) -> Result<Event, &'static str> {
    let id = bytes.u16().ok_or("the id of an event type")?;
    let name = bytes.c_string(LONGEST_NAME).ok_or("the name of an event type")?.to_owned();
    let count = bytes.u16().ok_or("the number of variables of an event type")?;
    let mut event =
        Event { id, name, variables: Vec::new(), types: Vec::new(), t_s: Vec::new(), columns: Vec::new() };
    for _ in 0..count {
        let expected = "a variable as name(type), the type one of bBhHiIqQfd";
        let text = bytes.c_string(LONGEST_NAME).ok_or(expected)?;
        let (name, rest) = text.split_once('(').ok_or(expected)?;
        let [letter @ (b'b' | b'B' | b'h' | b'H' | b'i' | b'I' | b'q' | b'Q' | b'f' | b'd'), b')'] =
            rest.as_bytes()
        else {
            return Err(expected);
        };
        event.types.push(*letter);
        event.variables.push(name.to_owned());
        event.columns.push(Vec::new());
    }
    Ok(event)
}

/// Reads one whole record, or nothing of it. Returns the number of values.
fn record(bytes: &mut Bytes<'_>, version: u16, events: &mut [Event]) -> Result<usize, &'static str> {
    const CUT: &str = "the last record is not whole";
    let id = bytes.u16().ok_or(CUT)?;
    let event = events.iter_mut().find(|event| event.id == id).ok_or("a record is of no known event type")?;
    let ticks = if version == 1 { bytes.u32().map(f64::from) } else { bytes.u64().map(|us| us as f64) };
    let ticks = ticks.ok_or(CUT)?;
    let values: Option<Vec<f64>> = event.types.iter().map(|letter| bytes.number(*letter)).collect();
    let values = values.ok_or(CUT)?;
    event.t_s.push(ticks);
    for (column, value) in event.columns.iter_mut().zip(&values) {
        column.push(*value);
    }
    Ok(values.len() + 1)
}
