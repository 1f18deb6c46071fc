//! Which flights choose what is kept, and which only judge.

use super::calibration::validation::{EVERY, LEAST_FLIGHTS};
use crate::fit::flight::Flight;

/// Flights that are fitted, and flights by which what was fitted is kept or not.
pub struct Split {
    pub fitted: Vec<Flight>,
    pub choosing: Vec<Flight>,
    /// No choosing flight belongs to the test.
    pub spares_test: bool,
}

impl Split {
    pub fn new(fit: &[Flight], test: &[Flight]) -> Self {
        if fit.len() < LEAST_FLIGHTS {
            return Split { fitted: fit.to_vec(), choosing: test.to_vec(), spares_test: false };
        }
        let chooses = |i: usize| i % EVERY == EVERY - 1;
        let part = |choosing: bool| {
            fit.iter().enumerate().filter(|(i, _)| chooses(*i) == choosing).map(|(_, f)| f.clone()).collect()
        };
        Split { fitted: part(false), choosing: part(true), spares_test: true }
    }
}
