//! The micro-SD deck of a Crazyflie.

use crate::firmware::{self, Variables};
use crate::series::Series;
use crate::usd;
use crate::{Columns, Content, FlightLog, LogError, Note, Reader};

pub(crate) struct MicroSd;

impl Reader for MicroSd {
    fn name(&self) -> &'static str {
        "micro_sd"
    }

    fn title(&self) -> &'static str {
        "a micro-SD log"
    }

    fn magic(&self) -> &'static [u8] {
        &[usd::MAGIC]
    }

    fn read(&self, content: &Content<'_>, mut notes: Vec<Note>) -> Result<FlightLog, LogError> {
        let events = usd::parse(content.file, content.bytes, &mut notes)?;
        let variables = Variables::from_events(content.file, events, &mut notes)?;
        firmware::flight(self.name(), &variables, notes)
    }

    fn columns(&self, content: &Content<'_>, notes: &mut Vec<Note>) -> Result<Option<Columns>, LogError> {
        let events = usd::parse(content.file, content.bytes, notes)?;
        let series = events.into_iter().flat_map(|event| {
            let t_s = event.t_s;
            let named = event.variables.into_iter().zip(event.columns);
            named.map(move |(name, values)| Series { name, t_s: t_s.clone(), values }).collect::<Vec<_>>()
        });
        Ok(Some(Columns(series.map(|series| series.finite(notes)).collect())))
    }
}
