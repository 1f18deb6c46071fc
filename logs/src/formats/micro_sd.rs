//! The micro-SD deck of a Crazyflie.

use crate::firmware::{self, Variables};
use crate::usd;
use crate::{Content, FlightLog, LogError, Note, Reader};

pub(crate) struct MicroSd;

impl Reader for MicroSd {
    fn name(&self) -> &'static str {
        "micro_sd"
    }

    fn title(&self) -> &'static str {
        "a micro-SD log"
    }

    fn share(&self, content: &Content<'_>) -> f64 {
        content.magic_share(&[usd::MAGIC])
    }

    fn read(&self, content: &Content<'_>, mut notes: Vec<Note>) -> Result<FlightLog, LogError> {
        let events = usd::parse(content.file, content.bytes, &mut notes)?;
        let variables = Variables::from_events(content.file, events, &mut notes)?;
        firmware::flight(self.name(), &variables, notes)
    }
}
