//! Channels with times of their own, brought to the rows of a flight.

use std::f64::consts::TAU;

use crate::Note;

/// Beyond this no value of a flight makes sense.
const LARGEST: f64 = 1e12;

/// One channel and its own times, which increase.
#[derive(Debug, Clone)]
pub(crate) struct Series {
    pub(crate) name: String,
    pub(crate) t_s: Vec<f64>,
    pub(crate) values: Vec<f64>,
}

/// Named columns of a binary file, as logged, each with its own times in seconds.
pub struct Columns(pub(crate) Vec<Series>);

/// The course of a channel between two samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Interpolation {
    /// A command is in force until the next.
    Held,
    /// A measurement goes straight to the next.
    Line,
}

impl Series {
    /// Without the samples that are not later than the one before, which are noted.
    pub(crate) fn in_order(self, notes: &mut Vec<Note>) -> Self {
        let mut kept = Self { name: self.name, t_s: Vec::new(), values: Vec::new() };
        for (t_s, value) in self.t_s.iter().zip(&self.values) {
            if kept.t_s.last().is_none_or(|last| t_s > last) {
                kept.t_s.push(*t_s);
                kept.values.push(*value);
            }
        }
        let count = self.t_s.len() - kept.t_s.len();
        if count > 0 {
            notes.push(Note::StampsOutOfOrder { name: kept.name.clone(), count });
        }
        kept
    }

    /// Without the values that are not finite or that nothing that flies has, in order of time.
    pub(crate) fn finite(self, notes: &mut Vec<Note>) -> Self {
        let sound = |(t_s, value): &(f64, f64)| t_s.abs() <= LARGEST && value.abs() <= LARGEST;
        let (t_s, values) = self.t_s.into_iter().zip(self.values).filter(sound).unzip();
        Self { name: self.name, t_s, values }.in_order(notes)
    }

    /// Returns the values at the times of the rows; the first and last extend beyond the ends. A channel that wraps
    /// after `turn` goes the shorter way round.
    pub(crate) fn resample(&self, rows_s: &[f64], between: Interpolation, turn: Option<f64>) -> Vec<f64> {
        rows_s.iter().map(|t| value_at(&self.t_s, &self.values, *t, between, turn)).collect()
    }
}

/// The times of the longest series.
pub(crate) fn longest_times(all: &[Series]) -> Vec<f64> {
    all.iter().max_by_key(|series| series.t_s.len()).map_or(Vec::new(), |series| series.t_s.clone())
}

/// The value of samples at a time: the first and last extend beyond the ends, 0 without samples.
pub(crate) fn value_at(
    t_s: &[f64],
    values: &[f64],
    at_s: f64,
    between: Interpolation,
    turn: Option<f64>,
) -> f64 {
    let after = t_s.partition_point(|t| *t <= at_s);
    let Some(before) = after.checked_sub(1) else { return values.first().copied().unwrap_or(0.0) };
    let from = values[before];
    let (Some(to), Interpolation::Line) = (values.get(after), between) else { return from };
    let share = (at_s - t_s[before]) / (t_s[after] - t_s[before]);
    let way = to - from;
    let way = turn.map_or(way, |turn| way - turn * (way / turn).round());
    from + share * way
}

/// A full turn of a channel in radians, for [`Series::resample`].
pub(crate) const TURN_RAD: Option<f64> = Some(TAU);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_hold_and_measurements_go_the_short_way_round() {
        let series = Series { name: "yaw".into(), t_s: vec![1.0, 2.0], values: vec![170.0, -170.0] };
        assert_eq!(
            series.resample(&[0.0, 1.5, 2.0, 9.0], Interpolation::Held, None),
            [170.0, 170.0, -170.0, -170.0]
        );
        assert_eq!(series.resample(&[1.5], Interpolation::Line, None), [0.0]);
        assert_eq!(series.resample(&[1.25, 1.5], Interpolation::Line, Some(360.0)), [175.0, 180.0]);
    }
}
