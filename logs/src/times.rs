//! Time columns of text logs: their usual names, and their unit.

use crate::signal::usual_step;

/// Names of a time column, in lower case and without a unit.
const NAMES: [&str; 9] = ["timestamp", "time", "t", "tick", "stamp", "ts", "secs", "seconds", "elapsed"];

/// A unit of time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TimeUnit {
    pub(crate) name: &'static str,
    pub(crate) seconds: f64,
}

/// All units, the finest last.
pub(crate) const TIME_UNITS: [TimeUnit; 4] = [
    TimeUnit { name: "s", seconds: 1.0 },
    TimeUnit { name: "ms", seconds: 1e-3 },
    TimeUnit { name: "us", seconds: 1e-6 },
    TimeUnit { name: "ns", seconds: 1e-9 },
];

/// Flights are logged with 2.5 to 2500 rows per second.
const SLOWEST_STEP_S: f64 = 0.4;

/// The unit in which a column's usual step is that of a flight log.
pub(crate) fn guess_unit(times: &[f64]) -> TimeUnit {
    let step = usual_step(times);
    let fits = |unit: &&TimeUnit| step * unit.seconds <= SLOWEST_STEP_S;
    TIME_UNITS.iter().find(fits).copied().unwrap_or(TIME_UNITS[3])
}

/// The first column that is named like a time.
pub(crate) fn time_column(header: &[String]) -> Option<&str> {
    let is_time = |name: &&String| {
        let lower = name.to_lowercase();
        let stem = lower.split(['_', '[', '(', ' ']).next().unwrap_or_default();
        NAMES.contains(&stem)
    };
    header.iter().find(is_time).map(String::as_str)
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
        for name in ["Timestamp", "t", "time_ms", "Time [s]", "t_s"] {
            assert_eq!(time_column(&["x".to_owned(), name.to_owned()]), Some(name));
        }
        assert_eq!(time_column(&["thrust".to_owned(), "target_x".to_owned()]), None);
    }
}
