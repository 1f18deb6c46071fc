//! Committed cases for tests.

use std::path::Path;

use crate::FlightLog;
use crate::case::Case;
use crate::fit::flight::Flight;
use crate::fit::hypothesis::Hypothesis;

/// A committed case: the flight to fit, the one to judge on, and what is declared of the vehicle.
pub struct CommittedCase {
    pub fit: FlightLog,
    pub test: FlightLog,
    pub declared: Hypothesis,
}

impl CommittedCase {
    pub fn read(name: &str) -> Self {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/cases"));
        let case = Case::read(&folder.join(format!("{name}.json"))).unwrap();
        let declared = Hypothesis::from_model(&case.model().unwrap());
        let [fit, test] = [&case.identify_on, &case.held_out].map(|path| FlightLog::read(path).unwrap());
        CommittedCase { fit, test, declared }
    }

    /// A log as a search takes it.
    pub fn flights(&self, log: &FlightLog) -> [Flight; 1] {
        [Flight::from_log("a", log, &self.declared.model, None).unwrap()]
    }
}
