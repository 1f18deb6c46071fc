//! Committed flights with hidden effects.

use std::path::Path;

use crazyflie_env::model::Model;
use crazyflie_identify::FlightLog;
use crazyflie_identify::case::Case;
use crazyflie_identify::fit::flight::Flight;

/// The flight of a case that is fitted to, and what is declared of its vehicle.
pub fn flight_and_model(case: &str) -> (Flight, Model) {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/cases"));
    let case = Case::read(&folder.join(format!("{case}.json"))).unwrap();
    let model = case.model().unwrap();
    let log = FlightLog::read(&case.identify_on).unwrap();
    (Flight::from_log("a", &log, &model, None).unwrap(), model)
}
