//! The clock of a log: counters that wrap, clocks that begin anew, and stamps that repeat.

use std::ops::Range;

use crate::signal::usual_step;
use crate::{LogError, Note, Result};

/// Counters of stamps wrap after so many ticks: 16, 24 and 32 bits.
const WRAPS: [f64; 3] = [65_536.0, 16_777_216.0, 4_294_967_296.0];
/// Clocks of the day wrap at midnight; some scripts keep the minute or the hour of the start.
const DAY_WRAPS_S: [f64; 4] = [60.0, 3600.0, 43_200.0, 86_400.0];
/// A clock that falls back by more than this, or by more than so many usual steps, began anew: stamps of
/// several blocks and late packets are out of order by less.
pub(crate) const BEGINS_ANEW_S: f64 = 1.0;
const BEGINS_ANEW_STEPS: f64 = 20.0;

/// Makes a counter continuous over its wraps. `tick_s` is the unit of the stamps in seconds. Returns the
/// number of wraps.
pub(crate) fn unwrap_counter(stamps: &mut [f64], tick_s: f64) -> usize {
    if stamps.iter().any(|stamp| stamp.fract() != 0.0) {
        return 0;
    }
    let longest = longest_step(stamps, tick_s);
    unwrap(stamps, |previous, stamp| {
        let fits = |wrap: &&f64| {
            previous < **wrap && previous > 0.5 * **wrap && stamp + **wrap - previous <= longest
        };
        WRAPS.iter().find(fits).copied()
    })
}

/// Makes dates and times of the day continuous, as above.
pub(crate) fn unwrap_day(stamps: &mut [f64]) -> usize {
    let longest_s = longest_step(stamps, 1.0);
    unwrap(stamps, |previous, stamp| {
        DAY_WRAPS_S.into_iter().find(|wrap_s| (0.0..=longest_s).contains(&(stamp + wrap_s - previous)))
    })
}

/// Adds the wraps that `wrap` finds between a stamp and a smaller one after it.
fn unwrap(stamps: &mut [f64], wrap: impl Fn(f64, f64) -> Option<f64>) -> usize {
    let (mut turns, mut wraps) = (0.0, 0);
    let mut previous = stamps.first().copied().unwrap_or(0.0);
    for stamp in stamps {
        if let Some(wrap) = (*stamp < previous).then(|| wrap(previous, *stamp)).flatten() {
            turns += wrap;
            wraps += 1;
        }
        previous = *stamp;
        *stamp += turns;
    }
    wraps
}

/// The stretches of rows between which the clock begins anew.
pub(crate) fn flights(stamps: &[f64], tick_s: f64) -> Vec<Range<usize>> {
    let longest = longest_step(stamps, tick_s);
    let mut starts = vec![0];
    starts.extend((1..stamps.len()).filter(|row| stamps[row - 1] - stamps[*row] > longest));
    let ends = starts.iter().skip(1).copied().chain([stamps.len()]);
    starts.iter().zip(ends).map(|(from, to)| *from..to).collect()
}

/// The index of the wanted flight (from 1, the first unless given) of `count`, which are noted.
pub(crate) fn choose_flight(
    file: &str,
    count: usize,
    wanted: Option<usize>,
    notes: &mut Vec<Note>,
) -> Result<usize> {
    let wanted = wanted.unwrap_or(1);
    if !(1..=count).contains(&wanted) {
        return Err(LogError::NoSuchFlight { file: file.to_owned(), wanted, count });
    }
    if count > 1 {
        notes.push(Note::Flights { count, read: wanted });
    }
    Ok(wanted - 1)
}

/// A step, forth or back, that a clock which runs makes at most; in ticks.
fn longest_step(stamps: &[f64], tick_s: f64) -> f64 {
    (BEGINS_ANEW_S / tick_s).max(BEGINS_ANEW_STEPS * usual_step(stamps).abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(from: f64, step: f64, wrap: f64) -> Vec<f64> {
        (0..400).map(|i| (from + f64::from(i) * step) % wrap).collect()
    }

    #[test]
    fn counters_of_every_width_are_continuous() {
        for (wrap, tick_s, step) in
            [(WRAPS[0], 1e-3, 10.0), (WRAPS[1], 1e-3, 40.0), (WRAPS[2], 1e-6, 10_000.0)]
        {
            let mut stamps = counted(wrap - 55.0 * step, step, wrap);
            assert_eq!(unwrap_counter(&mut stamps, tick_s), 1);
            assert!(stamps.windows(2).all(|pair| pair[1] - pair[0] == step), "{wrap}");
        }
    }

    #[test]
    fn a_clock_that_begins_anew_is_no_wrap() {
        let mut stamps = [counted(120_000.0, 40.0, 1e9), counted(4000.0, 40.0, 1e9)].concat();
        assert_eq!(unwrap_counter(&mut stamps, 1e-3), 0);
        assert_eq!(flights(&stamps, 1e-3), [0..400, 400..800]);
        // two blocks whose stamps take turns
        let blocks: Vec<f64> = (0..200).map(|i| f64::from(i / 2) * 40.0 - f64::from(i % 2) * 3.0).collect();
        assert_eq!(flights(&blocks, 1e-3).len(), 1);
    }
}
