//! The micro-SD deck of a Crazyflie.

use crate::firmware::{self, Variables};
use crate::series::Series;
use crate::usd;
use crate::{Columns, Content, Note, Reader, Result};

pub(crate) static READER: Reader = Reader {
    name: "micro_sd",
    title: "a micro-SD log",
    magic: &[usd::MAGIC],
    read: |content, mut notes| {
        let events = usd::parse(content.file, content.bytes, &mut notes)?;
        let variables = Variables::from_events(content.file, events, &mut notes)?;
        firmware::flight(READER.name, &variables, notes)
    },
    columns,
    ..Reader::TEXT
};

fn columns(content: &Content<'_>, notes: &mut Vec<Note>) -> Result<Option<Columns>> {
    let events = usd::parse(content.file, content.bytes, notes)?;
    let series = events.into_iter().flat_map(|event| {
        let t_s = event.t_s;
        let named = event.variables.into_iter().zip(event.columns);
        named.map(move |(name, values)| Series { name, t_s: t_s.clone(), values }).collect::<Vec<_>>()
    });
    Ok(Some(Columns(series.map(|series| series.finite(notes)).collect())))
}
