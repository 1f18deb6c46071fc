//! Verdicts by signal: how much of the error of each part of the motion is explained, and what is left of it.

use std::ops::Range;

use crazyflie_statistics::paired_bound;
use serde::Serialize;

use super::calibration::signals::{
    LEAST_CLIMB_MPS, LEAST_SPEED_MPS, LEAST_TILT_RAD, LEAST_TURN_RAD, LEAST_WORSE, LEVEL, MATTERS_MPS,
    MATTERS_SHARE, MATTERS_TILT_RAD, MATTERS_YAW_RAD, NEGLIGIBLE_ERROR, NEGLIGIBLE_SHARE, REFIT,
    TIMES_UNTESTED,
};
use super::calibration::verdict::WORTH_BOTH;
use super::errors::{AXES, AXIS_COMPONENTS, EVERY_S, Errors, HORIZONS_S, LEAST_STRETCHES, STRETCH_S};
use super::verdict::{Finding, Leftover, Structure};
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

    /// Returns the row of [`Errors::axes`] with the accuracy of the signal's predictions: velocities, and angles.
    pub fn error_row(self) -> usize {
        [2, 3, 4, 5][self as usize]
    }

    /// Unit of the errors by which the signal is judged.
    pub fn unit(self) -> &'static str {
        AXES[self.error_row()].1
    }

    /// Errors smaller than this do not matter, whatever the flight, in [`Signal::unit`].
    pub(super) fn negligible_size(self) -> f64 {
        [MATTERS_MPS, MATTERS_MPS, MATTERS_TILT_RAD, MATTERS_YAW_RAD][self as usize]
    }

    /// Least change of the signal within 2 s (root mean square) that a flight needs to test it, in
    /// [`Signal::unit`].
    pub fn least_motion(self) -> f64 {
        [LEAST_SPEED_MPS, LEAST_CLIMB_MPS, LEAST_TILT_RAD, LEAST_TURN_RAD][self as usize]
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
    /// Structure is left that no effect accounts for, or the model errs by more than no model or than its own
    /// numbers fitted anew.
    Unexplained,
    /// Nothing was found, and the test could not have found what matters.
    NotTested,
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
    /// Error that is left, 0.5 s and 2 s ahead (root mean square).
    pub error: [f64; 2],
    /// The same for a prediction that the state stays as at its start.
    pub no_model: [f64; 2],
    /// Error of the declared model over that of its numbers fitted anew, 0.5 s and 2 s ahead; `None` where they
    /// were not.
    pub over_refit: Option<[f64; 2]>,
    /// The smallest error 2 s ahead whose removal this test would have found.
    pub detectable: Option<f64>,
    /// Unit of the errors.
    pub unit: &'static str,
    /// Independent stretches of the test flights.
    pub stretches: usize,
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

/// Returns whether the errors of a signal are negligible, before and after, 0.5 s and 2 s ahead: then there is
/// nothing to explain, and a share of them has no meaning.
pub fn is_negligible(errors: &Errors, signal: Signal) -> bool {
    let (axes, row) = (&errors.axes, signal.error_row());
    HORIZONS.iter().all(|h| {
        let error = axes.before[row][*h].max(axes.after[row][*h]);
        error < NEGLIGIBLE_ERROR.max(NEGLIGIBLE_SHARE * axes.naive[row][*h])
    })
}

/// Returns whether structure is left in a signal.
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
    let worth = |signal: &Signal| effect.worth_by_signal[*signal as usize];
    let best = Signal::ALL.into_iter().max_by(|a, b| worth(a).total_cmp(&worth(b)));
    best.unwrap_or(Signal::Sideways)
}

/// The kind of evidence about flights, which decides what counts as left and as tested.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Evidence {
    /// The likelihood of a camera's log: every structure counts, and a signal at rest is reported too.
    Likelihood,
    /// Held-out predictions of flights under motion capture. Something always shakes a real vehicle: the residual
    /// counts if it is large, and a signal at rest is not conclusive.
    HeldOut,
}

/// Results of a search that the verdicts on signals follow from.
pub struct SignalEvidence<'a> {
    /// Kind of the evidence.
    pub kind: Evidence,
    /// Errors before and after.
    pub errors: &'a Errors,
    /// Errors of the declared form with its numbers fitted anew, as `after`.
    pub refitted: Option<&'a Errors>,
    /// Remaining disturbances of the flights.
    pub disturbances: &'a Disturbances,
    /// Structure left over.
    pub leftover: &'a [Leftover],
}

impl SignalEvidence<'_> {
    /// Returns the verdict on every signal: `is_named` is whether effects were named in it, `is_described` whether a
    /// term without a name was learned.
    pub fn verdicts(
        &self,
        is_named: impl Fn(Signal) -> bool,
        is_described: impl Fn(Signal) -> bool,
    ) -> Vec<SignalVerdict> {
        let verdict = |signal: Signal| {
            let stretches = self.errors.axes.stretches[signal.error_row()][HORIZONS[1]];
            let (left, left_unit) = signal.disturbance(self.disturbances);
            let error = HORIZONS.map(|h| self.errors.axes.after[signal.error_row()][h]);
            let mut verdict = SignalVerdict {
                signal,
                state: SignalState::NotTested,
                explained_share: explained_share(self.errors, signal),
                error,
                no_model: HORIZONS.map(|h| self.errors.axes.naive[signal.error_row()][h]),
                over_refit: self.over_refit(signal),
                detectable: self.kind.detectable(error[1], stretches),
                unit: signal.unit(),
                stretches,
                left,
                left_unit,
            };
            let is_left = is_described(signal) || self.is_left(&verdict);
            verdict.state = match (is_named(signal), is_left) {
                (true, false) => SignalState::Explained,
                (true, true) => SignalState::PartlyExplained,
                (false, true) => SignalState::Unexplained,
                (false, false) if self.is_tested(&verdict) => SignalState::NothingMissing,
                (false, false) => SignalState::NotTested,
            };
            verdict
        };
        Signal::ALL.into_iter().map(verdict).collect()
    }

    fn over_refit(&self, signal: Signal) -> Option<[f64; 2]> {
        let (refitted, row) = (self.refitted?, signal.error_row());
        Some(HORIZONS.map(|h| self.errors.axes.after[row][h] / refitted.axes.after[row][h]))
    }

    /// Returns whether something is left that no effect accounts for.
    fn is_left(&self, verdict: &SignalVerdict) -> bool {
        let structured = match self.kind {
            Evidence::Likelihood => is_structured(self.leftover, verdict.signal),
            Evidence::HeldOut => {
                let counts = |l: &Leftover| matches!(l.kind, Structure::Line | Structure::State);
                verdict.stretches >= LEAST_STRETCHES
                    && verdict.error[1] > least_that_matters(verdict)
                    && self.leftover.iter().any(|l| l.part == verdict.signal && l.is_structure() && counts(l))
            }
        };
        let over_refit = verdict.over_refit.is_some_and(|ratios| {
            let exceeds = |(ratio, error): (f64, f64)| {
                ratio > REFIT && error * (1.0 - 1.0 / ratio) > least_that_matters(verdict)
            };
            ratios.into_iter().zip(verdict.error).any(exceeds)
        });
        structured || over_refit || self.is_worse_than_no_model(verdict)
    }

    /// Returns whether a constant state predicts better, in place or in velocity, by more than is negligible, and, on
    /// too few stretches for a test, several times better.
    fn is_worse_than_no_model(&self, verdict: &SignalVerdict) -> bool {
        let (axes, signal) = (&self.errors.axes, verdict.signal);
        let times = if verdict.stretches < LEAST_STRETCHES { TIMES_UNTESTED } else { 1.0 };
        let rows = match signal {
            Signal::Sideways | Signal::Vertical => vec![signal as usize, signal.error_row()],
            Signal::Tilt | Signal::Yaw => vec![signal.error_row()],
        };
        let cells = rows.into_iter().flat_map(|row| HORIZONS.map(|h| (row, h)));
        let mut excess = cells.map(|(row, h)| axes.after[row][h] - times * axes.naive[row][h]);
        verdict.stretches >= LEAST_WORSE && excess.any(|excess| excess > signal.negligible_size())
    }

    /// Returns whether an effect of a size that matters would have been found.
    fn is_tested(&self, verdict: &SignalVerdict) -> bool {
        let moves = verdict.no_model[1] >= verdict.signal.least_motion();
        verdict.stretches >= LEAST_STRETCHES
            && (moves || self.kind == Evidence::Likelihood)
            && verdict.detectable.is_some_and(|size| size <= least_that_matters(verdict))
    }
}

/// An effect matters that makes such an error 2 s ahead.
fn least_that_matters(verdict: &SignalVerdict) -> f64 {
    verdict.signal.negligible_size().max(MATTERS_SHARE * verdict.no_model[1])
}

impl Evidence {
    /// The smallest error 2 s ahead whose removal is found beside a remaining `error` that is independent of it.
    fn detectable(self, error: f64, stretches: usize) -> Option<f64> {
        let seconds = stretches as f64 * STRETCH_S;
        let share = match self {
            // N ln(1 + share^2) / 2 of N predictions is what an effect must be worth
            Evidence::Likelihood => (2.0 * WORTH_BOTH.get() / (seconds / EVERY_S)).exp_m1().sqrt(),
            // Its square must exceed the bound of a paired test times the standard error of the mean cross product
            // of the two, of which a stretch holds as many independent ones as predictions fit into it.
            Evidence::HeldOut => {
                2.0 * paired_bound(stretches, LEVEL)? / (seconds / HORIZONS_S[HORIZONS[1]]).sqrt()
            }
        };
        Some(share * error).filter(|size| size.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use crazyflie_statistics::paired_p_value;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64Mcg;

    use super::super::errors::{ErrorTable, ErrorsByComponent};
    use super::*;

    /// Errors of so many stretches, one number on every axis and at every horizon.
    fn errors(declared: f64, after: f64, no_model: f64, stretches: usize) -> Errors {
        fn table<const ROWS: usize>([before, after, naive]: [f64; 3], stretches: usize) -> ErrorTable<ROWS> {
            let [before, after, naive, p_value] = [before, after, naive, 0.5].map(|error| [[error; 5]; ROWS]);
            ErrorTable { before, after, naive, p_value, stretches: [[stretches; 5]; ROWS] }
        }
        let all = [declared, after, no_model];
        let components = ErrorsByComponent { before: [[declared; 5]; 9], after: [[after; 5]; 9] };
        let (quantities, axes) = (table(all, stretches), table(all, stretches));
        Errors { quantities, axes, components, flights: Vec::new() }
    }

    fn states(
        kind: Evidence,
        errors: &Errors,
        refitted: Option<&Errors>,
        leftover: &[Leftover],
    ) -> [SignalState; 4] {
        let disturbances = &crate::explain::noise::FLOOR;
        let evidence = SignalEvidence { kind, errors, refitted, disturbances, leftover };
        let verdicts = evidence.verdicts(|_| false, |_| false);
        [0, 1, 2, 3].map(|i| verdicts[i].state)
    }

    #[test]
    fn nothing_is_missing_only_where_the_test_could_have_found_something() {
        use SignalState::{NotTested, NothingMissing, Unexplained};
        let judge = |kind, errors: &Errors| states(kind, errors, None, &[]);
        for kind in [Evidence::Likelihood, Evidence::HeldOut] {
            assert_eq!(judge(kind, &errors(0.02, 0.02, 1.0, 12)), [NothingMissing; 4], "{kind:?}");
            // too short
            assert_eq!(judge(kind, &errors(0.02, 0.02, 1.0, 5)), [NotTested; 4], "{kind:?}");
            // the remainder hides an effect of this size
            assert_eq!(judge(kind, &errors(0.5, 0.5, 1.0, 12)), [NotTested; 4], "{kind:?}");
            // to hold the state predicts better: twice says nothing on few stretches, five times does
            assert_eq!(judge(kind, &errors(0.2, 0.2, 0.1, 12)), [Unexplained; 4], "{kind:?}");
            assert_eq!(judge(kind, &errors(0.2, 0.2, 0.1, 4)), [NotTested; 4], "{kind:?}");
            assert_eq!(judge(kind, &errors(0.5, 0.5, 0.1, 4)), [Unexplained; 4], "{kind:?}");
            assert_eq!(judge(kind, &errors(0.5, 0.5, 0.1, 1)), [NotTested; 4], "{kind:?}");
        }
        // a vehicle that stands still tells nothing, but to a filter that knows the noise of its camera
        let still = errors(0.002, 0.002, 0.01, 60);
        assert_eq!(judge(Evidence::HeldOut, &still), [NotTested; 4]);
        assert_eq!(judge(Evidence::Likelihood, &still), [NothingMissing; 4]);
    }

    #[test]
    fn on_recorded_flights_structure_counts_where_it_is_large_and_no_filter_makes_it() {
        let line = |kind| [Leftover::new(kind, Signal::Sideways, "x", "a line".into(), 20.0)];
        let sideways = |errors: &Errors, refitted: Option<&Errors>, leftover: &[Leftover]| {
            states(Evidence::HeldOut, errors, refitted, leftover)[0]
        };
        let (small, large) = (errors(0.02, 0.02, 1.0, 60), errors(0.12, 0.12, 1.0, 60));
        assert_eq!(sideways(&small, None, &line(Structure::Line)), SignalState::NothingMissing);
        assert_eq!(sideways(&large, None, &line(Structure::Line)), SignalState::Unexplained);
        assert_eq!(sideways(&large, None, &line(Structure::Memory)), SignalState::NothingMissing);
        // the model's own numbers, fitted anew, err by less
        let refit = |after| errors(0.4, after, 1.0, 400);
        let beside = |after| sideways(&refit(0.4), Some(&refit(after)), &[]);
        assert_eq!([beside(0.2), beside(0.35)], [SignalState::Unexplained, SignalState::NothingMissing]);
    }

    #[test]
    fn the_detectable_size_is_that_of_the_test() {
        // about half of 100 tests find an effect of this size beside an independent error
        let size = Evidence::HeldOut.detectable(1.0, 30).unwrap();
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut normal = || rng.sample::<f64, _>(StandardNormal);
        let found = (0..400).filter(|_| {
            let mut stretch = || {
                let predictions = (STRETCH_S / HORIZONS_S[HORIZONS[1]]).round() as usize;
                let differences = (0..predictions).map(|_| {
                    let (effect, error) = (size * normal(), normal());
                    (effect + error).powi(2) - error.powi(2)
                });
                differences.sum::<f64>() / predictions as f64
            };
            let differences: Vec<f64> = (0..30).map(|_| stretch()).collect();
            paired_p_value(&differences).is_some_and(|p| p < LEVEL)
        });
        let share = found.count() as f64 / 400.0;
        assert!((0.3..0.8).contains(&share), "{size}: {share}");
    }

    #[test]
    fn the_strongest_structure_of_a_signal_says_what_a_name_must_outweigh() {
        let finding = |part: Signal, size: f64| {
            Leftover::new(Structure::Memory, part, "roll", "a correlation".into(), size)
        };
        // roll of d0014, seed 3939 of `hidden_flights.py`, where a delay is worth 7067
        let left = [finding(Signal::Tilt, 9.77), finding(Signal::Tilt, -6.38), finding(Signal::Yaw, -12.0)];
        assert!((structure_worth(&left, Signal::Tilt).unwrap() - 47.7).abs() < 0.1);
        assert_eq!(structure_worth(&left, Signal::Yaw), Some(72.0));
        // below what counts as structure
        assert_eq!(structure_worth(&left[1..], Signal::Tilt), None);
        assert!(!is_structured(&left, Signal::Vertical) && is_structured(&left, Signal::Tilt));
    }
}
