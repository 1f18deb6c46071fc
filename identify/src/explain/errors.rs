//! Errors of prediction on flights that the fit never saw: from an estimated state, by the commands alone, so
//! and so far ahead.

use std::ops::Range;

use rayon::prelude::*;
use serde::Serialize;

use crate::fit::filter::{Disturbances, filter_fixed};
use crate::fit::flight::{Flight, Window};
use crate::fit::hypothesis::Hypothesis;
use crate::fit::predict::{MeanSimulator, PredictedMeasurement};
use crazyflie_statistics::paired_p_value;

/// Prediction horizons, in seconds; the free run goes from the start to the end.
pub const HORIZONS_S: [f64; 4] = [0.02, 0.1, 0.5, 2.0];
/// Names of the horizons with the free run.
pub const HORIZONS: [&str; 5] = ["one_step", "0.1_s", "0.5_s", "2_s", "free_run"];
/// Predicted quantities and their units.
pub const QUANTITIES: [(&str, &str); 3] = [("position", "m"), ("velocity", "m/s"), ("attitude", "rad")];
/// Predictions start this far apart.
pub const EVERY_S: f64 = 0.25;
/// Stretches of a flight that are taken as independent of each other.
pub const STRETCH_S: f64 = 5.0;
/// Time that the filter needs to find the state.
const SETTLE_S: f64 = 2.0;
/// A free run does not go on further than this from the start.
const FREE_S: f64 = 20.0;

/// Axes of the errors, with their units.
pub const AXES: [(&str, &str); 6] = [
    ("sideways position", "m"),
    ("vertical position", "m"),
    ("sideways velocity", "m/s"),
    ("vertical velocity", "m/s"),
    ("roll and pitch", "rad"),
    ("yaw", "rad"),
];
/// Components of the errors, with their units.
pub const COMPONENTS: [(&str, &str); 9] = [
    ("x", "m"),
    ("y", "m"),
    ("z", "m"),
    ("x velocity", "m/s"),
    ("y velocity", "m/s"),
    ("z velocity", "m/s"),
    ("roll", "rad"),
    ("pitch", "rad"),
    ("yaw", "rad"),
];
/// Components of each of [`QUANTITIES`].
const QUANTITY_COMPONENTS: [Range<usize>; 3] = [0..3, 3..6, 6..9];
/// Components of each of [`AXES`].
pub const AXIS_COMPONENTS: [Range<usize>; 6] = [0..2, 2..3, 3..5, 5..6, 6..8, 8..9];
/// Fewest stretches of a paired test: five that all agree still do so by chance in one of sixteen tests (sign test,
/// two-sided).
pub const LEAST_STRETCHES: usize = 6;
/// Root mean square error per quantity and horizon, in the order of [`QUANTITIES`] and [`HORIZONS`].
pub type QuantityTable = [[f64; 5]; 3];
/// Root mean square error per axis and horizon, in the order of [`AXES`] and [`HORIZONS`].
pub type AxisTable = [[f64; 5]; 6];
/// Root mean square error per component and horizon, in the order of [`COMPONENTS`] and [`HORIZONS`].
pub type ComponentTable = [[f64; 5]; 9];

/// Errors by axis. A mean over three axes hides one that grew worse.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ErrorsByAxis {
    /// Errors of the model before the change.
    pub before: AxisTable,
    /// Errors of the model after the change.
    pub after: AxisTable,
    /// Errors of a constant start, as in [`Errors::naive`].
    pub naive: AxisTable,
    /// Significance, like that in [`Errors`].
    pub p_value: AxisTable,
    /// Stretches behind each p value.
    pub stretches: [[usize; 5]; 6],
}

/// Errors by component of one flight, or of all.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ErrorsByComponent {
    /// Errors of the model before the change.
    pub before: ComponentTable,
    /// Errors of the model after the change.
    pub after: ComponentTable,
}

/// Errors on the test flights.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Errors {
    /// Errors of the model before the change.
    pub before: QuantityTable,
    /// Errors of the model after the change.
    pub after: QuantityTable,
    /// Errors of the prediction that position, velocity and attitude stay as they were at its start.
    pub naive: QuantityTable,
    /// Two-sided p value of the paired differences between before and after, per quantity and horizon, over
    /// stretches of the flights.
    pub p_value: QuantityTable,
    /// Stretches behind each p value; below [`LEAST_STRETCHES`] it is not conclusive.
    pub stretches: [[usize; 5]; 3],
    /// The same errors, axis by axis.
    pub axes: ErrorsByAxis,
    /// The same errors, component by component, over all flights.
    pub components: ErrorsByComponent,
    /// The same of each flight alone, in the order of the flights.
    pub flights: Vec<ErrorsByComponent>,
}

/// Squared errors of one prediction: per component and horizon; NaN where there is nothing to compare with.
type SquaredErrors = ComponentTable;
/// Predictions by the stretches of a flight.
type StretchErrors = Vec<Vec<SquaredErrors>>;

/// A hypothesis with its disturbances, and the flights as it sees them: without what each has of its own.
pub type PredictionSetup<'a> = (&'a Hypothesis, &'a Disturbances, &'a [Flight]);

/// Errors of two hypotheses on the same flights. Predictions start from what the filter of each knows then;
/// from there on the commands alone decide.
pub fn compare_errors(before: PredictionSetup, after: PredictionSetup) -> Errors {
    let errors_of = |(hypothesis, disturbances, flights): PredictionSetup, naive| {
        squared_errors(&hypothesis.without_free(), disturbances, flights, naive)
    };
    let (before, (after, naive)) = rayon::join(
        || errors_of(before, false),
        || rayon::join(|| errors_of(after, false), || errors_of(before, true)),
    );
    let of_flight = |(b, a): (&StretchErrors, &StretchErrors)| ErrorsByComponent {
        before: component_table(b),
        after: component_table(a),
    };
    let flights = before.iter().zip(&after).map(of_flight).collect();
    let [b, a, n] = [before, after, naive].map(|flights| flights.concat());
    let quantity = |q: usize| {
        move |s: &SquaredErrors, h: usize| QUANTITY_COMPONENTS[q].clone().map(|row| s[row][h]).sum::<f64>()
    };
    let axis = |axis: usize| {
        move |s: &SquaredErrors, h: usize| AXIS_COMPONENTS[axis].clone().map(|row| s[row][h]).sum::<f64>()
    };
    Errors {
        before: std::array::from_fn(|q| root_means(&b, quantity(q))),
        after: std::array::from_fn(|q| root_means(&a, quantity(q))),
        naive: std::array::from_fn(|q| root_means(&n, quantity(q))),
        p_value: std::array::from_fn(|q| paired_test(&b, &a, quantity(q)).map(|test| test.0)),
        stretches: std::array::from_fn(|q| paired_test(&b, &a, quantity(q)).map(|test| test.1)),
        axes: ErrorsByAxis {
            before: std::array::from_fn(|row| root_means(&b, axis(row))),
            after: std::array::from_fn(|row| root_means(&a, axis(row))),
            naive: std::array::from_fn(|row| root_means(&n, axis(row))),
            p_value: std::array::from_fn(|row| paired_test(&b, &a, axis(row)).map(|test| test.0)),
            stretches: std::array::from_fn(|row| paired_test(&b, &a, axis(row)).map(|test| test.1)),
        },
        components: ErrorsByComponent { before: component_table(&b), after: component_table(&a) },
        flights,
    }
}

fn component_table(stretches: &[Vec<SquaredErrors>]) -> ComponentTable {
    std::array::from_fn(|row| root_means(stretches, |s: &SquaredErrors, h: usize| s[row][h]))
}

/// Mean over predictions of some square at a horizon, where there is one.
fn mean_square<'a>(
    all: impl Iterator<Item = &'a SquaredErrors>,
    square: impl Fn(&SquaredErrors, usize) -> f64,
    horizon: usize,
) -> f64 {
    let known: Vec<f64> = all.map(|s| square(s, horizon)).filter(|v| v.is_finite()).collect();
    known.iter().sum::<f64>() / known.len() as f64
}

fn root_means(stretches: &[Vec<SquaredErrors>], square: impl Fn(&SquaredErrors, usize) -> f64) -> [f64; 5] {
    std::array::from_fn(|horizon| mean_square(stretches.iter().flatten(), &square, horizon).sqrt())
}

/// Per horizon, the p value of the paired differences between two models over stretches of the flights, and
/// of how many.
fn paired_test(
    before: &[Vec<SquaredErrors>],
    after: &[Vec<SquaredErrors>],
    square: impl Fn(&SquaredErrors, usize) -> f64,
) -> [(f64, usize); 5] {
    std::array::from_fn(|horizon| {
        let mean = |stretch: &Vec<SquaredErrors>| mean_square(stretch.iter(), &square, horizon);
        let differences = before.iter().zip(after).map(|(b, a)| mean(b) - mean(a));
        let known: Vec<f64> = differences.filter(|d| d.is_finite()).collect();
        (paired_p_value(&known).unwrap_or(1.0), known.len())
    })
}

/// Squared errors of all predictions, by flights and their stretches.
fn squared_errors(
    hypothesis: &Hypothesis,
    disturbances: &Disturbances,
    flights: &[Flight],
    naive: bool,
) -> Vec<StretchErrors> {
    let per_flight = |flight: &Flight| -> StretchErrors {
        let Some(filtered) = filter_fixed(flight, hypothesis, disturbances) else {
            return Vec::new();
        };
        let ticks = |s: f64| (s / flight.tick_s).round() as usize;
        // the filter has to find the state first
        let stretches: Vec<usize> = (ticks(SETTLE_S)..flight.ticks.saturating_sub(ticks(0.5 * STRETCH_S)))
            .step_by(ticks(STRETCH_S))
            .collect();
        let stretch_errors = |first: &usize| {
            let mut simulator = MeanSimulator::new(hypothesis, flight, false).ok();
            let starts = (*first..(first + ticks(STRETCH_S)).min(flight.ticks)).step_by(ticks(EVERY_S));
            starts
                .filter_map(|start| {
                    prediction_errors(
                        simulator.as_mut()?,
                        flight,
                        &filtered.states[start],
                        start,
                        start == ticks(SETTLE_S),
                        naive,
                    )
                })
                .collect()
        };
        stretches.par_iter().map(stretch_errors).collect()
    };
    flights.iter().map(per_flight).collect()
}

/// One prediction from a tick: at each horizon the error at its end, for the free run the mean over it.
fn prediction_errors(
    simulator: &mut MeanSimulator,
    flight: &Flight,
    own: &[f64],
    start: usize,
    free: bool,
    naive: bool,
) -> Option<SquaredErrors> {
    let ahead = |s: f64| ((s / flight.tick_s).round() as usize).max(1);
    let end = (start + if free { ahead(FREE_S) } else { ahead(HORIZONS_S[3]) }).min(flight.ticks);
    if end <= start {
        return None;
    }
    simulator.predict(flight, &Window { flight: 0, ticks: start..end }, own);
    let from = flight.measured_state(start);
    let held = |r: &PredictedMeasurement| {
        if r.channel < 3 { from.att_rad[r.channel] } else { from.pos_m[r.channel - 3] }
    };
    let mean = |channel: usize, about_s: f64, reach_s: f64| -> f64 {
        let near =
            simulator.rows().iter().filter(|r| r.channel == channel && (r.t_s - about_s).abs() <= reach_s);
        let errors: Vec<f64> =
            near.map(|r| (r.measured - if naive { held(r) } else { r.predicted }).powi(2)).collect();
        errors.iter().sum::<f64>() / errors.len() as f64
    };
    let mut out = [[f64::NAN; 5]; 9];
    for (horizon, seconds) in HORIZONS_S.iter().enumerate().filter(|(_, s)| start + ahead(**s) <= end) {
        let about_s = (start + ahead(*seconds)) as f64 * flight.tick_s;
        for i in 0..3 {
            // frames do not fall on ticks
            out[i][horizon] = mean(3 + i, about_s, 0.02);
            out[6 + i][horizon] = mean(i, about_s, 0.6 * flight.tick_s);
        }
    }
    if free {
        let (about_s, reach_s) =
            (0.5 * (start + end) as f64 * flight.tick_s, 0.5 * (end - start) as f64 * flight.tick_s);
        for i in 0..3 {
            (out[i][4], out[6 + i][4]) = (mean(3 + i, about_s, reach_s), mean(i, about_s, reach_s));
        }
    }
    let mut velocity = |tick: usize| -> [f64; 3] {
        let predicted =
            if naive { Some(from.vel_mps) } else { simulator.reported_velocity(flight, tick - start) };
        let measured = flight.measured_state(tick).vel_mps;
        predicted.map_or([f64::NAN; 3], |v| std::array::from_fn(|i| (v[i] - measured[i]).powi(2)))
    };
    for (horizon, seconds) in HORIZONS_S.iter().enumerate().filter(|(_, s)| start + ahead(**s) <= end) {
        let errors = velocity(start + ahead(*seconds));
        (0..3).for_each(|i| out[3 + i][horizon] = errors[i]);
    }
    if free {
        let all: Vec<[f64; 3]> = (start + 1..=end).map(velocity).collect();
        (0..3).for_each(|i| out[3 + i][4] = all.iter().map(|v| v[i]).sum::<f64>() / all.len() as f64);
    }
    Some(out)
}
