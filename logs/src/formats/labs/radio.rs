//! Finds the stretches of real radio data in a log that was resampled to another clock.
//!
//! NanoBench interpolates each group of onboard channels linearly between its packets and extrapolates the
//! last two packets to the end of the file. On such a stretch every channel of the group has exactly constant
//! slope, to the rounding of the file; measured data never has, since at least one channel of a group carries
//! noise.

use std::ops::Range;

/// Decimals are cut at 1e-9, so a value is off by up to 0.5e-9; twice that for each end of a step.
const ROUNDING: f64 = 1e-9;
/// Unix time as a double steps by 2.4e-7 s: 5e-5 of a step of 10 ms.
const TIME_ROUNDING: f64 = 5e-5;
/// Packets of a group arrive every 10 to 30 ms; this long a straight line is no coincidence and no ordinary interval.
pub(super) const SHORTEST_TAIL_S: f64 = 0.05;
/// Motors are cut up to 0.1 s before the vehicle is below the airborne height; 1 s is safely more.
const TOUCH_DOWN_S: f64 = 1.0;
/// A stretch of interpolation this long is worth knowing about.
const SHORTEST_GAP_S: f64 = 0.1;

/// Kinds of ends of one group's data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    /// Packets to the end of the file, or values that are constant there.
    Live,
    /// The last row with real data.
    At(usize),
    /// No packets during the flight.
    Dead,
}

/// The channels of one radio packet, sampled at the times `t_s`.
pub(super) struct Group<'a> {
    t_s: &'a [f64],
    channels: Vec<&'a [f64]>,
    /// For each inner row: whether every channel goes straight through it.
    straight: Vec<bool>,
}

impl<'a> Group<'a> {
    pub(super) fn new(t_s: &'a [f64], channels: Vec<&'a [f64]>) -> Self {
        let inner = 1..t_s.len().saturating_sub(1);
        let straight = inner.map(|row| channels.iter().all(|x| is_straight(t_s, x, row))).collect();
        Self { t_s, channels, straight }
    }

    /// The first row of the straight line that leads to the end of the file.
    pub(super) fn tail_start(&self) -> usize {
        let bend = self.straight.iter().rposition(|straight| !straight);
        bend.map_or(0, |at| at + 1)
    }

    /// Judges the straight line at the end of the file, given the rows in which the vehicle `flies` and whether the
    /// group's real values may be constant in flight (setpoints may, anything measured or controlled is not).
    pub(super) fn end(&self, flies: &Range<usize>, may_stand_still: bool) -> End {
        let start = self.tail_start();
        let end = self.t_s.len().saturating_sub(1);
        if self.t_s.len() < 3 || self.t_s[end] - self.t_s[start] < SHORTEST_TAIL_S {
            return End::Live;
        }
        let stands_still = self.is_constant(start..end + 1);
        // Commands and motors stand still at 0 around touch-down and after: that is real, or harmless.
        let flight_end = self.t_s[flies.end.clamp(1, end + 1) - 1];
        let landed = flies.is_empty() || self.t_s[start] > flight_end - TOUCH_DOWN_S;
        if stands_still && (may_stand_still || landed) {
            return End::Live;
        }
        if start <= flies.start && !flies.is_empty() {
            return End::Dead;
        }
        End::At(start)
    }

    /// Number of stretches in `rows` that are interpolated over lost packets, and the longest, seconds.
    pub(super) fn gaps(&self, rows: &Range<usize>) -> (usize, f64) {
        let mut count = 0;
        let mut longest_s = 0.0_f64;
        let mut row = rows.start;
        while row < rows.end {
            let run = self.straight_run(row, rows.end);
            let last = run.end - 1;
            let length_s = self.t_s[last] - self.t_s[run.start];
            if length_s >= SHORTEST_GAP_S && !self.is_constant(run.clone()) {
                count += 1;
                longest_s = longest_s.max(length_s);
            }
            row = last.max(row + 1);
        }
        (count, longest_s)
    }

    /// The rows from `row` on that lie on one straight line, before `end`.
    fn straight_run(&self, row: usize, end: usize) -> Range<usize> {
        let mut last = (row + 1).min(end - 1);
        // `straight[i]` belongs to row i + 1.
        while last + 1 < end && self.straight.get(last - 1) == Some(&true) {
            last += 1;
        }
        row..last + 1
    }

    fn is_constant(&self, rows: Range<usize>) -> bool {
        self.channels.iter().all(|x| x[rows.clone()].iter().all(|v| *v == x[rows.start]))
    }
}

/// Returns whether the slope before `row` equals the slope after it, to the rounding of the file.
fn is_straight(t_s: &[f64], x: &[f64], row: usize) -> bool {
    let before_s = t_s[row] - t_s[row - 1];
    let after_s = t_s[row + 1] - t_s[row];
    let before = (x[row] - x[row - 1]) / before_s;
    let after = (x[row + 1] - x[row]) / after_s;
    let tolerance =
        ROUNDING * (1.0 / before_s + 1.0 / after_s) + TIME_ROUNDING * before.abs().max(after.abs());
    (after - before).abs() <= tolerance
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROWS: usize = 1000;

    fn times() -> Vec<f64> {
        (0..ROWS).map(|i| i as f64 * 0.01).collect()
    }

    /// Noise without a generator: an irrational multiple, folded.
    fn noise(i: usize) -> f64 {
        (i as f64 * 0.754_877_666).fract() - 0.5
    }

    /// Noisy until row `last`, extrapolated from the two values before it afterwards.
    fn extrapolate_from(last: usize) -> Vec<f64> {
        let slope = noise(last) - noise(last - 1);
        (0..ROWS)
            .map(|i| if i <= last { noise(i) } else { noise(last) + slope * (i - last) as f64 })
            .collect()
    }

    #[test]
    fn the_end_of_real_data_is_found_exactly_in_flight() {
        let t = times();
        let x = extrapolate_from(400);
        let steady = vec![0.0; ROWS];
        let group = Group::new(&t, vec![&x, &steady]);
        // The last two packets are rows 399 and 400: the line starts at 399.
        assert_eq!(group.end(&(100..900), false), End::At(399));
    }

    #[test]
    fn channels_that_stop_before_take_off_are_dead() {
        let t = times();
        let x = extrapolate_from(50);
        assert_eq!(Group::new(&t, vec![&x]).end(&(100..900), false), End::Dead);
        let frozen = vec![73.75; ROWS];
        assert_eq!(Group::new(&t, vec![&frozen]).end(&(100..900), false), End::Dead);
    }

    #[test]
    fn a_setpoint_may_stand_still_in_flight_but_not_drift() {
        let t = times();
        let hover = vec![1.0; ROWS];
        assert_eq!(Group::new(&t, vec![&hover]).end(&(100..900), true), End::Live);
        let x = extrapolate_from(400);
        assert_eq!(Group::new(&t, vec![&x]).end(&(100..900), true), End::At(399));
    }

    #[test]
    fn zero_after_landing_and_noise_to_the_end_are_alive() {
        let t = times();
        let landed: Vec<f64> = (0..ROWS).map(|i| if i < 900 { noise(i) } else { 0.0 }).collect();
        assert_eq!(Group::new(&t, vec![&landed]).end(&(100..900), false), End::Live);
        let noisy: Vec<f64> = (0..ROWS).map(noise).collect();
        assert_eq!(Group::new(&t, vec![&noisy]).end(&(100..900), false), End::Live);
    }

    #[test]
    fn a_lost_stretch_in_the_middle_is_a_gap() {
        let t = times();
        let mut x: Vec<f64> = (0..ROWS).map(noise).collect();
        let (from, to) = (x[500], x[530]);
        for (i, v) in x[500..=530].iter_mut().enumerate() {
            *v = from + (to - from) * i as f64 / 30.0;
        }
        let (count, longest_s) = Group::new(&t, vec![&x]).gaps(&(100..900));
        assert_eq!(count, 1);
        assert!((longest_s - 0.3).abs() < 1e-9);
    }
}
