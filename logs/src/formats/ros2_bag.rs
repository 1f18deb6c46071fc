//! ROS 2 bags as SQLite databases (`.db3`), the storage of rosbag2 up to Humble and still its second one.

use std::collections::HashMap;

use rusqlite::config::DbConfig;
use rusqlite::types::ValueRef;
use rusqlite::{Connection, MAIN_DB, Row};

use crate::message::{Encoding, Kind};
use crate::topics::{StoredMessage, Topics};
use crate::{Columns, Content, FlightLog, LogError, Note, Reader, Result, ros};

const MAGIC: &[u8] = b"SQLite format 3\0";
/// A virtual machine of SQLite that runs longer than a thousand times this many instructions reads no
/// recording: a flight of an hour has a million messages.
const MOST_KILO_STEPS: u32 = 1_000_000;

pub(crate) static READER: Reader =
    Reader { name: "ros2_bag", title: "a ROS 2 bag (SQLite)", magic: MAGIC, read, columns, ..Reader::TEXT };

fn read(content: &Content<'_>, mut notes: Vec<Note>) -> Result<FlightLog> {
    ros::read(READER.name, content, topics(content, &mut notes)?, notes)
}

fn columns(content: &Content<'_>, notes: &mut Vec<Note>) -> Result<Option<Columns>> {
    topics(content, notes)?.columns(content.file, content.part, notes)
}

fn topics(content: &Content<'_>, notes: &mut Vec<Note>) -> Result<Topics> {
    let bad = |error: rusqlite::Error| LogError::BadDatabase {
        file: content.file.to_owned(),
        reason: error.to_string(),
    };
    let connection = open(content.bytes).map_err(bad)?;
    let sources = sources(&connection).map_err(bad)?;
    let mut topics = Topics::default();
    if let Err(error) = messages(&connection, &sources, &mut topics) {
        notes.push(Note::DamagedDatabase { kept: topics.messages(), reason: error.to_string() });
    }
    Ok(topics)
}

/// The database in memory. Nothing in it is executed but what reads rows.
fn open(bytes: &[u8]) -> rusqlite::Result<Connection> {
    let mut connection = Connection::open_in_memory()?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
    let mut bytes = bytes.to_vec();
    // A bag whose recorder was killed says that its journal is a file beside it (versions 2); alone, it is
    // read as it is.
    bytes.iter_mut().skip(18).take(2).for_each(|version| *version = 1);
    connection.deserialize_read_exact(MAIN_DB, &bytes[..], bytes.len(), true)?;
    let mut left = MOST_KILO_STEPS;
    let is_over = move || {
        left = left.saturating_sub(1);
        left == 0
    };
    connection.progress_handler(1000, Some(is_over))?;
    Ok(connection)
}

/// A topic of the database.
struct Source {
    name: String,
    type_name: String,
    read_as: Option<(Kind, Encoding)>,
}

fn sources(connection: &Connection) -> rusqlite::Result<HashMap<i64, Source>> {
    // A view in place of the table could compute without end.
    let tables = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name IN ('topics', 'messages')";
    if connection.query_row(tables, [], |row| row.get::<_, i64>(0))? != 2 {
        return Err(rusqlite::Error::InvalidQuery);
    }
    let mut statement = connection.prepare("SELECT id, name, type, serialization_format FROM topics")?;
    let source = |row: &Row<'_>| {
        let (name, type_name, format): (String, String, String) = (row.get(1)?, row.get(2)?, row.get(3)?);
        let read_as =
            Kind::from_name(&type_name).filter(|_| format == "cdr").map(|kind| (kind, Encoding::Cdr));
        Ok((row.get(0)?, Source { name, type_name, read_as }))
    };
    statement.query_map([], source)?.collect()
}

/// Adds the messages in the order of the file.
fn messages(
    connection: &Connection,
    sources: &HashMap<i64, Source>,
    topics: &mut Topics,
) -> rusqlite::Result<()> {
    let mut statement = connection.prepare("SELECT topic_id, timestamp, data FROM messages")?;
    let mut rows = statement.query([])?;
    while let Some(row) = rows.next()? {
        let (id, recorded_ns): (i64, i64) = (row.get(0)?, row.get(1)?);
        let (Some(source), Ok(recorded_ns), ValueRef::Blob(data)) =
            (sources.get(&id), u64::try_from(recorded_ns), row.get_ref(2)?)
        else {
            continue;
        };
        topics.add(&source.name, &source.type_name, StoredMessage { recorded_ns, data }, source.read_as);
    }
    Ok(())
}
