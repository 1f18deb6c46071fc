//! Errors of prediction axis by axis, flight by flight: from the state at one instant the commands alone drive a
//! model, so and so far ahead. Sideways, vertical and attitude errors are separate, because a norm over all of them
//! hides changes of the smaller ones.

use std::ops::Range;

use rayon::prelude::*;
use serde::Serialize;

use crate::fit::flight::{Flight, Window};
use crate::fit::hypothesis::Hypothesis;
use crate::fit::predict::MeanSimulator;
use crazyflie_statistics::paired_p_value;

/// Prediction horizons.
pub const HORIZONS_S: [f64; 2] = [0.5, 2.0];
/// The axes with their units: horizontal velocity, vertical velocity, velocity in space, roll and pitch.
pub const AXES: [(&str, &str); 4] =
    [("sideways", "m/s"), ("vertical", "m/s"), ("velocity", "m/s"), ("attitude", "rad")];
/// Predictions start this far apart.
const EVERY_S: f64 = 0.25;
/// Fewer flights do not distinguish a change from chance.
pub const LEAST_FLIGHTS: usize = 6;

/// Root mean square errors on one flight, per axis ([`AXES`]) and horizon ([`HORIZONS_S`]).
#[derive(Debug, Clone, PartialEq)]
pub struct AxisErrors {
    /// Name of the flight, as [`Flight::name`].
    pub flight: String,
    /// Number of predictions behind each error.
    pub predictions: usize,
    /// Errors as `[axis][horizon]`, in the units of [`AXES`]; roll and pitch are one axis.
    pub rms: [[f64; 2]; 4],
}

/// Squared errors of one prediction.
type SquaredErrors = [[f64; 2]; 4];

/// Errors of a hypothesis without free numbers from `from_s` seconds into the flight on. Predictions start
/// from what was measured. `None` where the flight is too short or the hypothesis cannot be simulated.
pub fn axis_errors(hypothesis: &Hypothesis, flight: &Flight, from_s: f64) -> Option<AxisErrors> {
    stretch_errors(hypothesis, flight, (from_s / flight.tick_s).round() as usize..flight.ticks)
}

/// Computes [`axis_errors`] of predictions that start and end between two ticks.
pub fn stretch_errors(hypothesis: &Hypothesis, flight: &Flight, stretch: Range<usize>) -> Option<AxisErrors> {
    let ticks = |s: f64| (s / flight.tick_s).round() as usize;
    let last = stretch.end.checked_sub(ticks(HORIZONS_S[1]) + 1)?;
    let starts: Vec<usize> = (stretch.start..last).step_by(ticks(EVERY_S).max(1)).collect();
    let squares = |simulator: &mut Option<MeanSimulator>, start: &usize| {
        squared_errors(simulator.as_mut()?, flight, *start)
    };
    let simulator = || MeanSimulator::new(hypothesis, flight, false).ok();
    let all: Vec<SquaredErrors> = starts.par_iter().map_init(simulator, squares).collect::<Option<_>>()?;
    let mean =
        |axis: usize, horizon: usize| all.iter().map(|s| s[axis][horizon]).sum::<f64>() / all.len() as f64;
    let rms = std::array::from_fn(|axis| std::array::from_fn(|horizon| mean(axis, horizon).sqrt()));
    (!all.is_empty()).then(|| AxisErrors { flight: flight.name.clone(), predictions: all.len(), rms })
}

fn squared_errors(simulator: &mut MeanSimulator, flight: &Flight, start: usize) -> Option<SquaredErrors> {
    let own = simulator.measured_start(flight, start);
    let ahead = HORIZONS_S.map(|s| (s / flight.tick_s).round() as usize);
    simulator.predict(flight, &Window { flight: 0, ticks: start..start + ahead[1] + 1 }, &own);
    let mut squares = [[f64::NAN; 2]; 4];
    for (horizon, ticks) in ahead.into_iter().enumerate() {
        let (predicted, measured) =
            (simulator.reported_velocity(flight, ticks)?, flight.measured_state(start + ticks).vel_mps);
        let [x, y, z]: [f64; 3] = std::array::from_fn(|i| (predicted[i] - measured[i]).powi(2));
        (squares[0][horizon], squares[1][horizon], squares[2][horizon]) = (x + y, z, x + y + z);
        let about_s = (start + ticks) as f64 * flight.tick_s;
        let near = simulator
            .rows()
            .iter()
            .filter(|row| row.channel < 2 && (row.t_s - about_s).abs() < 0.6 * flight.tick_s);
        let (sum, count) = near.fold((0.0, 0.0), |(sum, count), row| {
            (sum + (row.measured - row.predicted).powi(2), count + 1.0)
        });
        // roll and pitch together
        squares[3][horizon] = 2.0 * sum / count;
    }
    Some(squares)
}

/// One axis at one horizon before and after a change of the model, over all flights.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisChange {
    /// Name of the axis, out of [`AXES`].
    pub axis: &'static str,
    /// Unit of [`AxisChange::before`] and [`AxisChange::after`].
    pub unit: &'static str,
    /// Time from the start of a prediction, out of [`HORIZONS_S`].
    pub horizon_s: f64,
    /// Root mean square over all predictions.
    pub before: f64,
    /// The same figure after the change.
    pub after: f64,
    /// Flights on which the error fell, of how many.
    pub better: usize,
    /// Number of flights compared.
    pub flights: usize,
    /// Significance of the logarithm of the ratio, flight by flight; `None` below [`LEAST_FLIGHTS`].
    pub p_value: Option<f64>,
}

/// The change of each axis and horizon. Both lists have the same flights in the same order.
pub fn axis_changes(before: &[AxisErrors], after: &[AxisErrors]) -> Vec<AxisChange> {
    let cells = (0..AXES.len()).flat_map(|axis| (0..HORIZONS_S.len()).map(move |horizon| (axis, horizon)));
    let change = |(axis, horizon): (usize, usize)| {
        let rms = |all: &[AxisErrors]| {
            let sums = all
                .iter()
                .map(|e| (e.predictions as f64 * e.rms[axis][horizon].powi(2), e.predictions as f64));
            let (sum, count) = sums.fold((0.0, 0.0), |(a, b), (c, d)| (a + c, b + d));
            f64::sqrt(sum / count)
        };
        let ratios: Vec<f64> = before
            .iter()
            .zip(after)
            .map(|(b, a)| (a.rms[axis][horizon] / b.rms[axis][horizon]).ln())
            .collect();
        AxisChange {
            axis: AXES[axis].0,
            unit: AXES[axis].1,
            horizon_s: HORIZONS_S[horizon],
            before: rms(before),
            after: rms(after),
            better: ratios.iter().filter(|ratio| **ratio < 0.0).count(),
            flights: ratios.len(),
            p_value: if ratios.len() < LEAST_FLIGHTS { None } else { paired_p_value(&ratios) },
        }
    };
    cells.map(change).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errors(scale: f64) -> Vec<AxisErrors> {
        let rms = |i: usize| std::array::from_fn(|axis| [scale * (1.0 + i as f64) * (axis as f64 + 1.0); 2]);
        (0..6).map(|i| AxisErrors { flight: i.to_string(), predictions: 10 + i, rms: rms(i) }).collect()
    }

    #[test]
    fn changes_are_those_of_each_axis() {
        let (before, mut after) = (errors(1.0), errors(1.0));
        for (i, flight) in after.iter_mut().enumerate() {
            // vertical errors fall on every flight by a third or so, the others stay
            flight.rms[1] = flight.rms[1].map(|e| e * (0.7 - 0.01 * i as f64));
        }
        let changes = axis_changes(&before, &after);
        assert_eq!(changes.len(), 8);
        for change in &changes {
            match change.axis {
                "vertical" => {
                    assert!(
                        change.p_value.unwrap() < 1e-6
                            && change.better == 6
                            && change.after < 0.7 * change.before,
                        "{change:?}"
                    )
                }
                _ => assert!(
                    change.p_value.is_none() && change.better == 0 && change.after == change.before,
                    "{change:?}"
                ),
            }
        }
        assert_eq!(axis_changes(&before[..5], &after[..5])[2].p_value, None);
    }
}
