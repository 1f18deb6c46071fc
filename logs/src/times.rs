//! Time columns of text logs: their usual names, and their unit.

use crate::names::is_in;
use crate::signal::usual_step;

/// Names of a time column, in lower case and without a unit.
const NAMES: &str = "timestamp time t tick ticks stamp ts secs seconds elapsed";

/// A unit of time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TimeUnit {
    pub(crate) name: &'static str,
    pub(crate) seconds: f64,
}

/// All units, the finest last.
pub(crate) const TIME_UNITS: [TimeUnit; 4] = [
    TimeUnit::SECOND,
    TimeUnit { name: "ms", seconds: 1e-3 },
    TimeUnit { name: "us", seconds: 1e-6 },
    TimeUnit { name: "ns", seconds: 1e-9 },
];
/// Words in the names of time columns, in the order of [`TIME_UNITS`].
const UNIT_WORDS: [&str; 4] = ["s sec secs seconds", "ms msec", "us usec", "ns"];

/// Flights are logged with 2.5 to 20000 rows per second.
const SLOWEST_STEP_S: f64 = 0.4;
const FASTEST_STEP_S: f64 = 5e-5;

/// The time column of a table, if a mapping gives it.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct TimeSpec {
    pub(crate) column: Option<String>,
    pub(crate) unit: Option<TimeUnit>,
    /// Rows per second, of a table without a time column.
    pub(crate) rate_hz: Option<f64>,
}

impl TimeUnit {
    pub(crate) const SECOND: Self = Self { name: "s", seconds: 1.0 };

    /// Returns whether the usual step in this unit is that of a flight log; also true if the stamps have no step.
    pub(crate) fn is_plausible(self, stamps: &[f64]) -> bool {
        let step = usual_step(stamps);
        step <= 0.0 || (FASTEST_STEP_S..=SLOWEST_STEP_S).contains(&(step * self.seconds))
    }
}

/// The unit in which a column's usual step is that of a flight log.
pub(crate) fn guess_unit(times: &[f64]) -> TimeUnit {
    let step = usual_step(times);
    let fits = |unit: &&TimeUnit| step * unit.seconds <= SLOWEST_STEP_S;
    TIME_UNITS.iter().find(fits).copied().unwrap_or(TIME_UNITS[3])
}

/// The first column that is named like a time.
pub(crate) fn time_column(header: &[String]) -> Option<&str> {
    header.iter().find(|name| is_time_name(name)).map(String::as_str)
}

/// Returns whether a column is named like a time: by its first word, or by a unit of time after a clock's name.
pub(crate) fn is_time_name(name: &str) -> bool {
    let words = words(name);
    let has = |word: &str| words.iter().any(|known| known == word);
    words.first().is_some_and(|first| is_in(NAMES, first))
        || words.last().is_some_and(|last| last == "timestamp")
        || (["host", "vehicle", "clock", "stamp", "system"].into_iter().any(has)
            && unit_of_name(name).is_some())
}

/// Returns the unit in a name or a word.
pub(crate) fn unit_of_name(name: &str) -> Option<TimeUnit> {
    let last = words(name).pop()?;
    UNIT_WORDS.iter().position(|words| is_in(words, &last)).map(|at| TIME_UNITS[at])
}

fn words(name: &str) -> Vec<String> {
    let parts = name.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty());
    parts.map(str::to_lowercase).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_follows_from_the_rate() {
        for (unit, step) in [("s", 0.01), ("ms", 10.0), ("us", 2e3), ("ns", 1e7)] {
            let times: Vec<f64> = (0..100).map(|i| 5.0 + f64::from(i) * step).collect();
            assert_eq!(guess_unit(&times).name, unit);
        }
    }

    #[test]
    fn times_are_known_by_name() {
        for name in ["Timestamp", "t", "time_ms", "Time [s]", "t_s", "vehicle_ms", "Time (Seconds)"] {
            assert_eq!(time_column(&["x".to_owned(), name.to_owned()]), Some(name));
        }
        assert_eq!(
            ["time_ms", "Time (Seconds)", "t"].map(|name| unit_of_name(name).map(|u| u.name)),
            [Some("ms"), Some("s"), None]
        );
        assert_eq!(time_column(&["thrust".to_owned(), "target_x".to_owned()]), None);
    }
}
