//! Fit of the motor-level form by output error over windows that start from the measured state.

use crazyflie_env::dual::Dual;
use crazyflie_env::scalar::Scalar;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use serde::Serialize;
use thiserror::Error;

use super::flight::{MotorFlight, STEP_S, median_speed};
use super::model::{
    FORM, MotionState, MotorTrim, PARAMETERS, accelerations, into_body, lag_rotors, rotation, step,
};
use crate::fit::solve::NormalEquations;

/// Predictions start this long after the first row, so that trims are learnt.
pub const LEARNING_ROWS: usize = 200;
/// Length of a prediction.
pub const HORIZON_ROWS: usize = 50;
/// Rows from one window of a fit to the next.
const FIT_STRIDE: usize = 60;
/// Rows of a window that count, so that early and late ones do alike.
const COUNTED: [usize; 6] = [5, 10, 20, 30, 40, 50];
/// Errors of the four quantities that weigh alike: near the published ones after 50 steps.
const SCALES: [f64; 4] = [0.1, 0.5, 0.2, 0.6];
const G_MPS2: f64 = 9.81;
const MOST_STEPS: usize = 40;
/// Relative fall of the loss that ends a fit.
const CONVERGED: f64 = 1e-5;

/// A fitted motor-level model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MotorModel {
    /// Unit of the rotor speeds.
    pub median_speed: f64,
    /// Fitted parameters, in the order and units of [`FORM`].
    pub values: [f64; PARAMETERS],
    /// Standard errors, clustered by flight; zero for what lies at a bound.
    pub stderr: [f64; PARAMETERS],
    /// Whether each parameter stands at one of its bounds in [`FORM`].
    pub at_bound: [bool; PARAMETERS],
}

/// Reason why a form cannot be fitted.
#[derive(Debug, Error, PartialEq)]
#[allow(missing_docs, reason = "each variant's message says what went wrong")]
pub enum MotorFitError {
    #[error("no flight to fit")]
    NoFlights,
    #[error("the fit does not converge: its loss is not a number")]
    Diverged,
}

/// A start of a prediction: the row, rotor speeds and the trims learnt up to it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start<R> {
    pub row: usize,
    pub speeds: [R; 4],
    pub trim: MotorTrim<R>,
}

/// Starts every `stride` rows. Trims are exponential means of how far the model was off from row to row, up
/// to the start and no further.
pub(super) fn starts<R: Scalar>(
    p: &[R; PARAMETERS],
    flight: &MotorFlight,
    median_speed: f64,
    stride: usize,
) -> Vec<Start<R>> {
    let keep = [p[PARAMETERS - 2], p[PARAMETERS - 1]].map(|memory| (-R::from_f64(STEP_S) / memory).exp());
    let mut weight = [R::zero(); 2];
    let mut sum = MotorTrim::<R>::zero();
    let mut speeds = scale_speeds(flight.speeds[0], median_speed).map(R::from_f64);
    let mut found = Vec::new();
    for row in 1..flight.motion.len().saturating_sub(HORIZON_ROWS) {
        let (before, now) = (&flight.motion[row - 1], &flight.motion[row]);
        let turn = rotation([before[6], before[7], before[8]]);
        let difference = |i: usize| (now[i] - before[i]) / STEP_S;
        let force = into_body(&turn, [difference(3), difference(4), difference(5) + G_MPS2]);
        let model =
            accelerations(p, &before.map(R::from_f64), &turn.map(|row| row.map(R::from_f64)), &speeds);
        for i in 0..3 {
            sum.force_mps2[i] = keep[0] * sum.force_mps2[i] + R::from_f64(force[i]) - model.force_mps2[i];
            sum.torque_radps2[i] =
                keep[1] * sum.torque_radps2[i] + R::from_f64(difference(9 + i)) - model.torque_radps2[i];
        }
        weight = [0, 1].map(|i| keep[i] * weight[i] + R::from_f64(1.0));
        speeds = lag_rotors(p, speeds, scale_speeds(flight.speeds[row - 1], median_speed), STEP_S);
        if row >= LEARNING_ROWS && (row - LEARNING_ROWS).is_multiple_of(stride) {
            let trim = MotorTrim {
                force_mps2: sum.force_mps2.map(|s| s / weight[0]),
                torque_radps2: sum.torque_radps2.map(|s| s / weight[1]),
            };
            found.push(Start { row, speeds, trim });
        }
    }
    found
}

fn scale_speeds(speeds: [f64; 4], median_speed: f64) -> [f64; 4] {
    speeds.map(|w| w / median_speed)
}

/// The motion predicted from a start by the motors alone, after 1, 2, ... rows.
pub(super) fn predict<R: Scalar>(
    p: &[R; PARAMETERS],
    flight: &MotorFlight,
    median_speed: f64,
    start: &Start<R>,
) -> Vec<MotionState<R>> {
    let mut x: MotionState<R> = flight.motion[start.row].map(R::from_f64);
    let mut speeds = start.speeds;
    (0..HORIZON_ROWS)
        .map(|k| {
            x = step(p, &x, &speeds, &start.trim, STEP_S);
            speeds = lag_rotors(p, speeds, scale_speeds(flight.speeds[start.row + k], median_speed), STEP_S);
            x
        })
        .collect()
}

/// Fits all parameters.
///
/// # Errors
/// [`MotorFitError`].
pub fn fit(flights: &[MotorFlight]) -> Result<MotorModel, MotorFitError> {
    if flights.is_empty() {
        return Err(MotorFitError::NoFlights);
    }
    let median_speed = median_speed(flights);
    let mut values = FORM.map(|p| p.start);
    let (mut normals, mut damping) = (normal_equations(&values, flights, median_speed), 1e-2);
    for _ in 0..MOST_STEPS {
        let total = sum(&normals);
        if !total.loss.is_finite() {
            return Err(MotorFitError::Diverged);
        }
        let mut next = None;
        while next.is_none() && damping < 1e8 {
            let trial = bounded_step(&values, &total, damping);
            let there = normal_equations(&trial, flights, median_speed);
            let loss = sum(&there).loss;
            if loss < total.loss {
                next = Some((trial, there, total.loss - loss));
                damping *= 0.2;
            } else {
                damping *= 5.0;
            }
        }
        let Some((trial, there, fall)) = next else { break };
        (values, normals) = (trial, there);
        if fall < CONVERGED * total.loss {
            break;
        }
    }
    let at_bound = std::array::from_fn(|i| values[i] <= FORM[i].low || values[i] >= FORM[i].high);
    Ok(MotorModel { median_speed, values, stderr: cluster_robust_errors(&normals, &at_bound), at_bound })
}

fn sum(normals: &[NormalEquations]) -> NormalEquations {
    let mut total = NormalEquations::new(PARAMETERS);
    for n in normals {
        total.loss += n.loss;
        total.rows += n.rows;
        total.gradient += &n.gradient;
        total.curvature += &n.curvature;
    }
    total
}

/// One set of normal equations for each flight.
fn normal_equations(
    values: &[f64; PARAMETERS],
    flights: &[MotorFlight],
    median_speed: f64,
) -> Vec<NormalEquations> {
    let p: [Dual; PARAMETERS] = std::array::from_fn(|i| Dual::variable(values[i], i));
    let equations = |flight: &MotorFlight| {
        let mut normal = NormalEquations::new(PARAMETERS);
        for start in starts(&p, flight, median_speed, FIT_STRIDE) {
            let predicted = predict(&p, flight, median_speed, &start);
            for row in COUNTED {
                let measured = &flight.motion[start.row + row];
                for i in 0..12 {
                    let by = 1.0 / SCALES[i / 3];
                    let slopes: [f64; PARAMETERS] =
                        std::array::from_fn(|j| by * f64::from(predicted[row - 1][i].slope[j]));
                    normal.add(by * (predicted[row - 1][i].value - measured[i]), &slopes);
                }
            }
        }
        normal.symmetrise();
        normal
    };
    flights.par_iter().map(equations).collect()
}

/// A damped Gauss-Newton step; what would leave its range stays at its end.
fn bounded_step(values: &[f64; PARAMETERS], total: &NormalEquations, damping: f64) -> [f64; PARAMETERS] {
    let mut held = [false; PARAMETERS];
    loop {
        let free: Vec<usize> = (0..PARAMETERS).filter(|i| !held[*i]).collect();
        let curvature = DMatrix::from_fn(free.len(), free.len(), |a, b| {
            let c = total.curvature[(free[a], free[b])];
            if a == b { c * (1.0 + damping) + 1e-12 } else { c }
        });
        let gradient = DVector::from_iterator(free.len(), free.iter().map(|i| total.gradient[*i]));
        let Some(by) = curvature.cholesky().map(|c| c.solve(&gradient)) else { return *values };
        let mut trial = *values;
        free.iter().zip(by.iter()).for_each(|(i, by)| trial[*i] -= by);
        // one that stands at its end and would go on is held, and the others solved anew
        let leaves = |i: &&usize| {
            let (p, v) = (&FORM[**i], trial[**i]);
            (v < p.low && values[**i] <= p.low) || (v > p.high && values[**i] >= p.high)
        };
        match free.iter().find(leaves) {
            Some(i) => held[*i] = true,
            None => return std::array::from_fn(|i| trial[i].clamp(FORM[i].low, FORM[i].high)),
        }
    }
}

/// Sandwich over flights, whose windows go together.
fn cluster_robust_errors(normals: &[NormalEquations], at_bound: &[bool; PARAMETERS]) -> [f64; PARAMETERS] {
    let free: Vec<usize> = (0..PARAMETERS).filter(|i| !at_bound[*i]).collect();
    let total = sum(normals);
    let pick = |m: &DMatrix<f64>| DMatrix::from_fn(free.len(), free.len(), |a, b| m[(free[a], free[b])]);
    let mut errors = [0.0; PARAMETERS];
    let Some(bread) = pick(&total.curvature).try_inverse() else { return [f64::NAN; PARAMETERS] };
    let mut meat = DMatrix::zeros(free.len(), free.len());
    for n in normals {
        let g = DVector::from_iterator(free.len(), free.iter().map(|i| n.gradient[*i]));
        meat += &g * g.transpose();
    }
    let clusters = normals.len() as f64;
    let covariance = &bread * meat * &bread * (clusters / (clusters - 1.0).max(1.0));
    free.iter().enumerate().for_each(|(a, i)| errors[*i] = covariance[(a, a)].max(0.0).sqrt());
    errors
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A vehicle of known numbers, held up by a rate controller that stirs.
    fn flight(seed: u32) -> MotorFlight {
        let mut p = FORM.map(|p| p.start);
        (p[0], p[1], p[2], p[3], p[5], p[8], p[9]) = (9.81, 0.08, 70.0, 60.0, 0.5, 2.0, 3.0);
        let mut x = [0.0; 12];
        x[2] = 1.0;
        let (mut motion, mut commands) = (Vec::new(), Vec::new());
        let mut speeds = [1.0; 4];
        let phase = f64::from(seed);
        for k in 0..1500 {
            let t = f64::from(k) * STEP_S;
            let wanted = [0.15 * (1.3 * t + phase).sin(), 0.15 * (1.7 * t + 2.0 * phase).cos()];
            let moment = [0, 1].map(|i| 0.1 * (wanted[i] - x[6 + i]) - 0.02 * x[9 + i]);
            let lift = 0.05 * (0.9 * t + phase).sin() - 0.1 * (x[2] - 1.0) - 0.1 * x[5];
            let command: [f64; 4] = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)]
                .map(|(r, q)| 1.0 + lift + r * moment[0] + q * moment[1]);
            motion.push(x);
            commands.push(command.map(|c| 3.0 * c));
            x = step(&p, &x, &speeds, &MotorTrim::zero(), STEP_S);
            speeds = lag_rotors(&p, speeds, command, STEP_S);
        }
        MotorFlight { name: format!("made {seed}"), motion, speeds: commands }
    }

    #[test]
    fn known_numbers_are_found() {
        let flights = [flight(1), flight(2), flight(3)];
        let model = fit(&flights).unwrap();
        let value_of = |name: &str| model.values[FORM.iter().position(|p| p.name == name).unwrap()];
        for (name, truth) in
            [("motor_lag", 0.08), ("roll_authority", 70.0), ("pitch_authority", 60.0), ("roll_damping", 2.0)]
        {
            // the unit of the speeds is their median, which is not quite hover
            assert!(
                (value_of(name) / truth - 1.0).abs() < 0.1,
                "{name}: {} for {truth}: {model:?}",
                value_of(name)
            );
        }
        assert!((value_of("drag_x") - 0.5).abs() < 0.1, "{model:?}");
    }

    #[test]
    fn nothing_to_fit_is_an_error() {
        assert_eq!(fit(&[]), Err(MotorFitError::NoFlights));
    }
}
