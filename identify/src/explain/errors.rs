//! Errors of prediction on flights that the fit never saw: from an estimated state, by the commands alone, so
//! and so far ahead.

use std::ops::Range;

use rayon::prelude::*;

use crate::fit::filter::{Disturbances, filter_fixed};
use crate::fit::flight::{Flight, Window};
use crate::fit::hypothesis::Hypothesis;
use crate::fit::predict::{MeanSimulator, PredictedMeasurement};
use crazyflie_statistics::paired_p_value;

/// Prediction horizons, in seconds; the free run goes from the start to the end.
pub const HORIZONS_S: [f64; 4] = [0.02, 0.1, 0.5, 2.0];
/// Names of the horizons with the free run.
pub const HORIZONS: [&str; 5] = ["one_step", "0.1_s", "0.5_s", "2_s", "free_run"];
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
/// Components of position, velocity and attitude.
const QUANTITY_COMPONENTS: [Range<usize>; 3] = [0..3, 3..6, 6..9];
/// Components of each of [`AXES`].
pub const AXIS_COMPONENTS: [Range<usize>; 6] = [0..2, 2..3, 3..5, 5..6, 6..8, 8..9];
/// Fewest stretches of a paired test: five that all agree still do so by chance in one of sixteen tests (sign test,
/// two-sided).
pub const LEAST_STRETCHES: usize = 6;
/// Root mean square error per component and horizon, in the order of [`COMPONENTS`] and [`HORIZONS`].
pub type ComponentTable = [[f64; 5]; 9];

/// Errors of two models, by rows and horizons.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorTable<const ROWS: usize> {
    /// Errors of the model before the change.
    pub before: [[f64; 5]; ROWS],
    /// Errors of the model after the change.
    pub after: [[f64; 5]; ROWS],
    /// Errors of the prediction that position, velocity and attitude stay as they were at its start.
    pub naive: [[f64; 5]; ROWS],
    /// Two-sided p value of the paired differences between before and after, over stretches of the flights.
    pub p_value: [[f64; 5]; ROWS],
    /// Stretches behind each p value; below [`LEAST_STRETCHES`] it is not conclusive.
    pub stretches: [[usize; 5]; ROWS],
}

impl<const ROWS: usize> ErrorTable<ROWS> {
    fn new([before, after, naive]: [&[Stretch]; 3], rows: &[Range<usize>; ROWS]) -> Self {
        let square =
            |row: usize| move |s: &SquaredErrors, h: usize| rows[row].clone().map(|c| s[c][h]).sum::<f64>();
        let means = |all| std::array::from_fn(|row| root_means(all, &square(row)));
        let tests: [_; ROWS] = std::array::from_fn(|row| paired_test(before, after, &square(row)));
        ErrorTable {
            before: means(before),
            after: means(after),
            naive: means(naive),
            p_value: tests.map(|row| row.map(|test| test.0)),
            stretches: tests.map(|row| row.map(|test| test.1)),
        }
    }
}

/// Errors by component of one flight, or of all.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorsByComponent {
    /// Errors of the model before the change.
    pub before: ComponentTable,
    /// Errors of the model after the change.
    pub after: ComponentTable,
}

/// Errors on the test flights.
#[derive(Debug, Clone, PartialEq)]
pub struct Errors {
    /// Errors by quantity.
    pub quantities: ErrorTable<3>,
    /// The same errors, axis by axis.
    pub axes: ErrorTable<6>,
    /// The same errors, component by component, over all flights.
    pub components: ErrorsByComponent,
    /// The same of each flight alone, in the order of the flights.
    pub flights: Vec<ErrorsByComponent>,
}

/// Squared errors of one prediction: per component and horizon; NaN where there is nothing to compare with.
type SquaredErrors = ComponentTable;
/// Predictions of a stretch of a flight.
type Stretch = Vec<SquaredErrors>;
/// A square of a prediction at a horizon.
type Square<'a> = dyn Fn(&SquaredErrors, usize) -> f64 + 'a;

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
    let flights = before.iter().zip(&after).map(|(b, a)| ErrorsByComponent::new(b, a)).collect();
    let [b, a, n] = [before, after, naive].map(|flights| flights.concat());
    let all = [&b[..], &a[..], &n[..]];
    Errors {
        quantities: ErrorTable::new(all, &QUANTITY_COMPONENTS),
        axes: ErrorTable::new(all, &AXIS_COMPONENTS),
        components: ErrorsByComponent::new(&b, &a),
        flights,
    }
}

impl ErrorsByComponent {
    fn new(before: &[Stretch], after: &[Stretch]) -> Self {
        let table = |all| std::array::from_fn(|row| root_means(all, &|s, h| s[row][h]));
        ErrorsByComponent { before: table(before), after: table(after) }
    }
}

/// Mean over predictions of some square at a horizon, where there is one.
fn mean_square(all: &mut dyn Iterator<Item = &SquaredErrors>, square: &Square, horizon: usize) -> f64 {
    let known: Vec<f64> = all.map(|s| square(s, horizon)).filter(|v| v.is_finite()).collect();
    known.iter().sum::<f64>() / known.len() as f64
}

fn root_means(stretches: &[Stretch], square: &Square) -> [f64; 5] {
    std::array::from_fn(|horizon| mean_square(&mut stretches.iter().flatten(), square, horizon).sqrt())
}

/// Per horizon, the p value of the paired differences between two models over stretches of the flights, and
/// of how many.
fn paired_test(before: &[Stretch], after: &[Stretch], square: &Square) -> [(f64, usize); 5] {
    std::array::from_fn(|horizon| {
        let mean = |stretch: &Stretch| mean_square(&mut stretch.iter(), square, horizon);
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
) -> Vec<Vec<Stretch>> {
    let per_flight = |flight: &Flight| -> Vec<Stretch> {
        let Some(filtered) = filter_fixed(flight, hypothesis, disturbances) else { return Vec::new() };
        let ticks = |s: f64| (s / flight.tick_s).round() as usize;
        // the filter has to find the state first
        let firsts = ticks(SETTLE_S)..flight.ticks.saturating_sub(ticks(0.5 * STRETCH_S));
        let firsts: Vec<usize> = firsts.step_by(ticks(STRETCH_S)).collect();
        let stretch_errors = |first: &usize| {
            let mut simulator = MeanSimulator::new(hypothesis, flight, false).ok();
            let mut errors = |start: usize| {
                let (simulator, free) = (simulator.as_mut()?, start == ticks(SETTLE_S));
                prediction_errors(simulator, flight, &filtered.states[start], start, free, naive)
            };
            let starts = (*first..(first + ticks(STRETCH_S)).min(flight.ticks)).step_by(ticks(EVERY_S));
            starts.filter_map(&mut errors).collect()
        };
        firsts.par_iter().map(stretch_errors).collect()
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
    (end > start).then_some(())?;
    simulator.predict(flight, &Window { flight: 0, ticks: start..end }, own);
    let from = flight.measured_state(start);
    let mut velocity = |tick: usize| -> [f64; 3] {
        let predicted =
            if naive { Some(from.vel_mps) } else { simulator.reported_velocity(flight, tick - start) };
        let measured = flight.measured_state(tick).vel_mps;
        predicted.map_or([f64::NAN; 3], |v| std::array::from_fn(|i| (v[i] - measured[i]).powi(2)))
    };
    let is_reached = |s: f64| start + ahead(s) <= end;
    let velocities = HORIZONS_S.map(|s| is_reached(s).then(|| velocity(start + ahead(s))));
    let freely: Vec<[f64; 3]> = if free { (start + 1..=end).map(velocity).collect() } else { Vec::new() };
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
    for (horizon, velocity) in velocities.iter().enumerate().filter_map(|(h, v)| Some((h, v.as_ref()?))) {
        let about_s = (start + ahead(HORIZONS_S[horizon])) as f64 * flight.tick_s;
        for i in 0..3 {
            // frames do not fall on ticks
            out[i][horizon] = mean(3 + i, about_s, 0.02);
            out[3 + i][horizon] = velocity[i];
            out[6 + i][horizon] = mean(i, about_s, 0.6 * flight.tick_s);
        }
    }
    if free {
        let (about_s, reach_s) =
            (0.5 * (start + end) as f64 * flight.tick_s, 0.5 * (end - start) as f64 * flight.tick_s);
        for i in 0..3 {
            (out[i][4], out[6 + i][4]) = (mean(3 + i, about_s, reach_s), mean(i, about_s, reach_s));
            out[3 + i][4] = freely.iter().map(|v| v[i]).sum::<f64>() / freely.len() as f64;
        }
    }
    Some(out)
}
