//! The same flight under another name, or another cut of it.

use std::collections::HashSet;

use crate::FlightLog;

/// No two flights pass through the same places to this, but files of one flight are rounded differently.
const GRID_M: f64 = 1e-6;
/// So much of the shorter log is found in the other; flights of a simulator without noise may begin alike.
const LEAST_SHARE: f64 = 0.9;
/// With fewer places in flight the whole logs are compared.
const LEAST_PLACES: usize = 50;

impl FlightLog {
    /// Returns whether two logs contain the same flight, by the vehicle's positions: under other names, in other
    /// formats, or as cuts of one recording.
    pub fn is_same_flight(&self, other: &FlightLog) -> bool {
        let (ours, theirs) = (self.places(), other.places());
        let least = ours.len().min(theirs.len());
        if least < LEAST_PLACES {
            return self.fixes == other.fixes && self.roll_rad == other.roll_rad;
        }
        ours.intersection(&theirs).count() as f64 >= LEAST_SHARE * least as f64
    }

    /// Measured places in flight, on a grid.
    fn places(&self) -> HashSet<[i64; 3]> {
        let flown = (0..self.fixes.row.len()).filter(|i| self.airborne.contains(&self.fixes.row[*i]));
        flown.map(|i| self.fixes.pos_m.each_ref().map(|axis| (axis[i] / GRID_M).round() as i64)).collect()
    }
}

/// Returns the first two logs of the same flight, by their places in the list.
pub fn first_duplicate(logs: &[&FlightLog]) -> Option<[usize; 2]> {
    let pairs = (0..logs.len()).flat_map(|later| (0..later).map(move |earlier| [earlier, later]));
    pairs.into_iter().find(|[earlier, later]| logs[*earlier].is_same_flight(logs[*later]))
}
