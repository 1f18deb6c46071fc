//! Verdicts by signal: how much of the error of each part of the motion is explained, and what is left of it.

use std::ops::Range;

use crazyflie_logs::inspect::Motion;
use serde::Serialize;

use super::calibration::signals::{
    LEAST_CLIMB_MPS, LEAST_SPEED_MPS, LEAST_TILT_DEG, LEAST_TURN_DEG, NEGLIGIBLE_ERROR, NEGLIGIBLE_SHARE,
};
use super::errors::{AXIS_COMPONENTS, Errors};
use super::verdict::{Finding, Leftover};
use crate::fit::filter::{Disturbances, FilterResult};

/// A part of the motion that is judged by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Signal {
    /// Horizontal motion.
    Sideways,
    /// Motion along the world's z axis.
    Vertical,
    /// Roll and pitch.
    Tilt,
    /// Heading.
    Yaw,
}

impl Signal {
    /// All signals, in the order of every table by signal.
    pub const ALL: [Signal; 4] = [Signal::Sideways, Signal::Vertical, Signal::Tilt, Signal::Yaw];

    /// Returns the signal's word in reports, in lower case.
    pub fn name(self) -> &'static str {
        ["sideways", "vertical", "tilt", "yaw"][self as usize]
    }

    /// The signal that a measured channel belongs to (see
    /// [`crate::fit::predict::PredictedMeasurement::channel`]).
    pub fn from_channel(channel: usize) -> Self {
        match channel {
            0 | 1 => Signal::Tilt,
            2 => Signal::Yaw,
            3 | 4 => Signal::Sideways,
            _ => Signal::Vertical,
        }
    }

    /// Row of [`Errors::axes`] that tells how well the signal is predicted: velocities, and angles.
    pub fn error_row(self) -> usize {
        [2, 3, 4, 5][self as usize]
    }

    /// Size of a flight's motion in this signal.
    pub fn motion(self, of: &Motion) -> f64 {
        [of.speed_mps, of.climb_mps, of.tilt_deg, of.yaw_turned_deg][self as usize]
    }

    /// With a smaller [`Signal::motion`] a flight says little of the signal.
    pub fn least_motion(self) -> f64 {
        [LEAST_SPEED_MPS, LEAST_CLIMB_MPS, LEAST_TILT_DEG, LEAST_TURN_DEG][self as usize]
    }

    /// Rows of [`Errors::components`] that the row of the axes is made of.
    pub fn components(self) -> Range<usize> {
        AXIS_COMPONENTS[self.error_row()].clone()
    }

    /// Size and unit of what still shakes the signal.
    pub fn disturbance(self, disturbances: &Disturbances) -> (f64, &'static str) {
        match self {
            Signal::Sideways => (disturbances.force.sigma, "m/s^2"),
            Signal::Vertical => (disturbances.lift.sigma, "m/s^2"),
            Signal::Tilt => (disturbances.torque.sigma, "rad/s^2"),
            Signal::Yaw => (disturbances.turn.sigma, "rad/s^2"),
        }
    }
}

/// Negative log-likelihood of filtered flights by signal, in the order of [`Signal::ALL`].
pub fn losses_by_signal<'a>(flights: impl IntoIterator<Item = &'a FilterResult>) -> [f64; 4] {
    let mut losses = [0.0; 4];
    for innovation in flights.into_iter().flat_map(|f| &f.innovations) {
        losses[Signal::from_channel(innovation.channel) as usize] += innovation.loss;
    }
    losses
}

/// The state of a signal in the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SignalState {
    /// The declared model accounts for it.
    NothingMissing,
    /// Named effects account for it.
    Explained,
    /// Named effects account for most of its error; structure is left.
    PartlyExplained,
    /// Structure is left that no effect accounts for.
    Unexplained,
}

/// The verdict on one signal.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SignalVerdict {
    /// Part of the motion that is judged.
    pub signal: Signal,
    /// Outcome for this part of the motion.
    pub state: SignalState,
    /// Share of the declared model's error on the test flights that the completed model removes, 0.5 s and 2
    /// s ahead (root mean square).
    pub explained_share: [f64; 2],
    /// Standard deviation of what still shakes the signal, whatever the commands, and its unit.
    pub left: f64,
    /// Unit of [`SignalVerdict::left`].
    pub left_unit: &'static str,
}

/// Horizons that verdicts speak of, among those of the errors: 0.5 s and 2 s.
pub const HORIZONS: [usize; 2] = [2, 3];

/// Share of a signal's error that is gone, 0.5 s and 2 s ahead.
pub fn explained_share(errors: &Errors, signal: Signal) -> [f64; 2] {
    let row = signal.error_row();
    HORIZONS.map(|h| 1.0 - errors.axes.after[row][h] / errors.axes.before[row][h])
}

/// Whether the errors of a signal are negligible, before and after, 0.5 s and 2 s ahead: there is nothing to be
/// explained, and a share of them means nothing.
pub fn is_negligible(errors: &Errors, signal: Signal) -> bool {
    let (axes, row) = (&errors.axes, signal.error_row());
    HORIZONS.iter().all(|h| {
        let error = axes.before[row][*h].max(axes.after[row][*h]);
        error < NEGLIGIBLE_ERROR.max(NEGLIGIBLE_SHARE * axes.naive[row][*h])
    })
}

/// Whether structure is left in a signal.
pub fn is_structured(leftover: &[Leftover], signal: Signal) -> bool {
    structure_worth(leftover, signal).is_some()
}

/// Log-likelihood that the strongest structure left in a signal is worth: half the square of a test statistic in
/// standard deviations. `None` where none is left.
pub fn structure_worth(leftover: &[Leftover], signal: Signal) -> Option<f64> {
    let structure = leftover.iter().filter(|l| l.part == signal && l.is_structure());
    structure.map(|l| 0.5 * l.size * l.size).max_by(f64::total_cmp)
}

/// The signal that an effect is worth most in.
pub fn main_signal(effect: &Finding) -> Signal {
    let best = Signal::ALL
        .into_iter()
        .max_by(|a, b| effect.worth_by_signal[*a as usize].total_cmp(&effect.worth_by_signal[*b as usize]));
    best.unwrap_or(Signal::Sideways)
}

/// The verdict on every signal: in which effects were named, and in which structure is left.
pub fn signal_verdicts(
    is_named: impl Fn(Signal) -> bool,
    is_left: impl Fn(Signal) -> bool,
    errors: &Errors,
    disturbances: &Disturbances,
) -> Vec<SignalVerdict> {
    let verdict = |signal: Signal| {
        let state = match (is_named(signal), is_left(signal)) {
            (true, false) => SignalState::Explained,
            (true, true) => SignalState::PartlyExplained,
            (false, true) => SignalState::Unexplained,
            (false, false) => SignalState::NothingMissing,
        };
        let (left, left_unit) = signal.disturbance(disturbances);
        SignalVerdict { signal, state, explained_share: explained_share(errors, signal), left, left_unit }
    };
    Signal::ALL.into_iter().map(verdict).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_strongest_structure_of_a_signal_says_what_a_name_must_outweigh() {
        let finding = |part: Signal, size: f64| Leftover::new(part, "roll", "a correlation".into(), size);
        // roll of d0014, seed 3939 of `hidden_flights.py`, where a delay is worth 7067
        let left = [finding(Signal::Tilt, 9.77), finding(Signal::Tilt, -6.38), finding(Signal::Yaw, -12.0)];
        assert!((structure_worth(&left, Signal::Tilt).unwrap() - 47.7).abs() < 0.1);
        assert_eq!(structure_worth(&left, Signal::Yaw), Some(72.0));
        // below what counts as structure
        assert_eq!(structure_worth(&left[1..], Signal::Tilt), None);
        assert!(!is_structured(&left, Signal::Vertical) && is_structured(&left, Signal::Tilt));
    }
}
