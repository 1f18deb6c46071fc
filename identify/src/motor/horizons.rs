//! Errors of predictions from the motors alone, by horizon: the table of the nano-drone system-identification
//! benchmark.

use crazyflie_env::vector::state_index::{POS, RATE, ROLL, VEL};
use serde::Serialize;

use super::fit::{MotorModel, predict, starts};
use super::flight::{MotorFlight, STEP_S};
use super::model::{MotionRow, MotorForm, attitude};

/// Horizons in steps of 10 ms.
pub const HORIZON_STEPS: [usize; 3] = [1, 10, 50];
/// Quantities of the table and their units.
pub const QUANTITIES: [(&str, &str); 4] =
    [("position", "m"), ("velocity", "m/s"), ("attitude", "rad"), ("body rate", "rad/s")];

/// Mean absolute errors, `[quantity][horizon]`: the mean over all predictions of the error's length; of
/// attitude, of the angle between.
pub type HorizonErrors = [[f64; 3]; 4];

/// Errors of a model, and of a vehicle that goes on at its velocity and its body rates.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HorizonTable {
    /// Errors of the fitted model.
    pub model: HorizonErrors,
    /// Errors of a vehicle that keeps its velocity and its body rates.
    pub unchanged: HorizonErrors,
    /// Sum of the model's errors after 1, 2, ... 50 steps, one per quantity: the benchmark's figure.
    pub sums: [f64; 4],
    /// Number of predictions over all flights.
    pub predictions: usize,
}

/// A published row, after 50 steps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PublishedRow {
    /// Label of the row in a table.
    pub name: &'static str,
    /// In the order of [`QUANTITIES`]; `None` if it was not measured.
    pub errors: [Option<f64>; 4],
}

/// Best published figures of Busetto, Cereda et al., "Nonlinear System Identification Nano-drone Benchmark"
/// (arXiv 2512.14450, 2025), on its own flights of a Crazyflie 2.1 Brushless with measured rotor speeds.
pub const PUBLISHED: [PublishedRow; 2] = [
    PublishedRow { name: "published, physics", errors: [Some(0.127), None, None, None] },
    PublishedRow {
        name: "published, hybrid or best",
        errors: [Some(0.112), Some(0.556), Some(0.227), Some(0.598)],
    },
];

/// Best published sums over the first 50 steps, on the same flights as [`PUBLISHED`], in the order of [`QUANTITIES`].
pub const PUBLISHED_SUMS: [f64; 4] = [2.32, 10.40, 5.10, 28.99];

/// Errors over the flights, with a prediction every `stride` rows.
#[must_use]
pub fn horizon_table(model: &MotorModel, flights: &[MotorFlight], stride: usize) -> HorizonTable {
    let none = [[0.0; 3]; 4];
    let mut table = HorizonTable { model: none, unchanged: none, sums: [0.0; 4], predictions: 0 };
    let form = MotorForm::new(model.values, model.median_speed);
    for flight in flights {
        for start in starts(&form, flight, stride) {
            let predicted = predict(&form, flight, &start);
            let begin = flight.motion[start.row];
            table.predictions += 1;
            for (predicted, measured) in predicted.iter().zip(&flight.motion[start.row + 1..]) {
                table.sums.iter_mut().zip(lengths(predicted, measured)).for_each(|(sum, e)| *sum += e);
            }
            for (h, steps) in HORIZON_STEPS.into_iter().enumerate() {
                let measured = &flight.motion[start.row + steps];
                let still = hold_motion(&begin, steps as f64 * STEP_S);
                let (model, naive) = (lengths(&predicted[steps - 1], measured), lengths(&still, measured));
                for q in 0..QUANTITIES.len() {
                    table.model[q][h] += model[q];
                    table.unchanged[q][h] += naive[q];
                }
            }
        }
    }
    let count = table.predictions.max(1) as f64;
    let horizons = table.model.iter_mut().chain(&mut table.unchanged).flatten();
    horizons.chain(&mut table.sums).for_each(|e| *e /= count);
    table
}

/// Extrapolates with constant velocity and Euler rates.
fn hold_motion(x: &MotionRow<f64>, time_s: f64) -> MotionRow<f64> {
    let turning = attitude(x).angle_rates(&[x[RATE], x[RATE + 1], x[RATE + 2]]);
    std::array::from_fn(|i| match i {
        POS..VEL => x[i] + time_s * x[VEL + i],
        ROLL..RATE => x[i] + time_s * turning[i - ROLL],
        _ => x[i],
    })
}

fn lengths(predicted: &MotionRow<f64>, measured: &MotionRow<f64>) -> [f64; 4] {
    let length =
        |first: usize| (first..first + 3).map(|i| (predicted[i] - measured[i]).powi(2)).sum::<f64>().sqrt();
    [length(0), length(3), angle_between(predicted, measured), length(9)]
}

/// Angle of the rotation from one attitude to the other.
fn angle_between(a: &MotionRow<f64>, b: &MotionRow<f64>) -> f64 {
    let [p, q] = [a, b].map(|x| attitude(x).rotation());
    let distance: f64 =
        (0..3).flat_map(|i| (0..3).map(move |j| (i, j))).map(|(i, j)| (p[i][j] - q[i][j]).powi(2)).sum();
    // |P - Q| = 2 sqrt(2) |sin(angle / 2)|, exact near zero where a cosine is not
    2.0 * (distance / 8.0).sqrt().min(1.0).asin()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_angle_between_attitudes_is_that_of_the_turn() {
        let at = |roll: f64, yaw: f64| {
            std::array::from_fn(|i| {
                if i == 6 {
                    roll
                } else if i == 8 {
                    yaw
                } else {
                    0.0
                }
            })
        };
        assert!((angle_between(&at(0.0, 1.0), &at(0.0, 1.3)) - 0.3).abs() < 1e-12);
        assert!((angle_between(&at(0.2, 0.7), &at(-0.1, 0.7)) - 0.3).abs() < 1e-12);
        assert!(angle_between(&at(0.2, 0.7), &at(0.2, 0.7)) < 1e-12);
    }

    #[test]
    fn a_vehicle_that_goes_on_is_predicted_by_going_on() {
        let x = [0.0, 0.0, 1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2];
        let later = hold_motion(&x, 0.5);
        assert!(
            (later[0] - 0.25).abs() < 1e-12 && (later[8] - 0.1).abs() < 1e-12 && lengths(&x, &later)[0] > 0.2
        );
    }
}
