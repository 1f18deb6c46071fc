//! Fit of the motor-level form by output error over windows that start from the measured state.

use crazyflie_env::dual::DualNumber;
use crazyflie_env::plant::Accelerations;
use crazyflie_env::scalar::Scalar;
use serde::Serialize;

use super::flight::{MotorFlight, STEP_S, median_speed};
use super::model::{FORM, MotionRow, MotorForm, PARAMETERS, into_body, motion_of_row, row_of_motion};
use super::regression::known;
use crate::estimate::at_bound;
use crate::fit::solve::{NormalEquations, Prior, Problem, cluster_robust_covariance, solve_within};
use crate::{Error, Result};

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
const MOST_STEPS: usize = 40;
/// A fall of the loss by less ends a fit.
const ENOUGH: f64 = 1e-6;

/// A fitted motor-level model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MotorModel {
    /// Unit of the rotor speeds.
    pub median_speed: f64,
    /// Fitted parameters, in the order and units of [`FORM`].
    pub values: [f64; PARAMETERS],
    /// Cluster-robust standard errors (CR3), clustered by flight; of parameters that rows determine without a
    /// prediction, by leaving out quarters of flights; zero for those at a bound.
    pub stderr: [f64; PARAMETERS],
    /// Flags of the parameters at one of their bounds in [`FORM`].
    pub at_bound: [bool; PARAMETERS],
}

/// A start of a prediction: the row, the PWM of the motors and the trims learnt up to it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start<R> {
    pub row: usize,
    pwm: [R; 4],
    trim: Accelerations<R>,
}

/// Starts every `stride` rows. Trims are exponential means of how far the model was off from row to row, up
/// to the start and no further.
pub(super) fn starts<R: Scalar>(form: &MotorForm<R>, flight: &MotorFlight, stride: usize) -> Vec<Start<R>> {
    let rows = &flight.motion;
    let step_s = R::from_f64(STEP_S);
    let keep = form.memories_s().map(|memory_s| (-step_s / memory_s).exp());
    let mut weight = [R::zero(); 2];
    let mut sum = Accelerations::none();
    let mut pwm = form.pwm(flight.speeds[0]);
    let mut found = Vec::new();
    for row in 1..rows.len().saturating_sub(HORIZON_ROWS) {
        let mut motion = motion_of_row(&rows[row - 1]);
        let turn = motion.attitude.rotation();
        form.advance(&mut motion, &mut pwm, flight.speeds[row - 1], &Accelerations::none());
        let missed = |first: usize, predicted: [R; 3]| {
            std::array::from_fn(|i| (R::from_f64(rows[row][first + i]) - predicted[i]) / step_s)
        };
        let (force, torque) = (into_body(&turn, missed(3, motion.vel_mps)), missed(9, motion.rate_radps));
        for i in 0..3 {
            sum.acc_mps2[i] = keep[0] * sum.acc_mps2[i] + force[i];
            sum.ang_radps2[i] = keep[1] * sum.ang_radps2[i] + torque[i];
        }
        weight = [0, 1].map(|i| keep[i] * weight[i] + R::from_f64(1.0));
        if row >= LEARNING_ROWS && (row - LEARNING_ROWS).is_multiple_of(stride) {
            let acc_mps2 = sum.acc_mps2.map(|s| s / weight[0]);
            let trim = Accelerations { acc_mps2, ang_radps2: sum.ang_radps2.map(|s| s / weight[1]) };
            found.push(Start { row, pwm, trim });
        }
    }
    found
}

/// The motion predicted from a start by the motors alone, after 1, 2, ... rows.
pub(super) fn predict<R: Scalar>(
    form: &MotorForm<R>,
    flight: &MotorFlight,
    start: &Start<R>,
) -> Vec<MotionRow<R>> {
    let (mut motion, mut pwm) = (motion_of_row(&flight.motion[start.row]), start.pwm);
    let advance = |row: usize| {
        form.advance(&mut motion, &mut pwm, flight.speeds[row], &start.trim);
        row_of_motion(&motion)
    };
    (start.row..start.row + HORIZON_ROWS).map(advance).collect()
}

/// Flights to fit, each a window without unknowns of its own.
struct HorizonProblem<'a> {
    flights: &'a [MotorFlight],
    median_speed: f64,
    /// Parameters that are not fitted to predictions.
    known: [Option<Prior>; PARAMETERS],
}

impl Problem for HorizonProblem<'_> {
    type Worker = MotorForm<DualNumber<PARAMETERS>>;

    fn windows(&self) -> usize {
        self.flights.len()
    }
    fn own_unknowns(&self) -> usize {
        0
    }
    fn bounds(&self) -> Vec<[f64; 2]> {
        FORM.map(|p| [p.low, p.high]).to_vec()
    }
    fn windows_per_worker(&self) -> usize {
        1
    }
    fn worker(&self, shared: &[f64]) -> Self::Worker {
        let number = |i: usize| match self.known[i] {
            Some(_) => DualNumber::from_f64(shared[i]),
            None => DualNumber::variable(shared[i], i),
        };
        MotorForm::new(std::array::from_fn(number), self.median_speed)
    }
    fn priors(&self) -> Vec<Option<Prior>> {
        self.known.to_vec()
    }
    fn normal_equations(&self, form: &mut Self::Worker, window: usize, _: &[f64]) -> NormalEquations {
        let flight = &self.flights[window];
        let mut normal = NormalEquations::new(PARAMETERS);
        for start in starts(form, flight, FIT_STRIDE) {
            let predicted = predict(form, flight, &start);
            for row in COUNTED {
                for i in 0..12 {
                    let (by, prediction) = (1.0 / SCALES[i / 3], predicted[row - 1][i]);
                    let slopes = prediction.slope.map(|slope| by * f64::from(slope));
                    normal.add(by * (flight.motion[start.row + row][i] - prediction.value), &slopes);
                }
            }
        }
        normal.symmetrise();
        normal
    }
}

/// Fits all parameters of aligned flights ([`super::regression::align`]), whose motor lag is `lag_s`.
///
/// # Errors
/// No flights, or a fit that does not converge.
pub fn fit(flights: &[MotorFlight], lag_s: f64) -> Result<MotorModel> {
    if flights.is_empty() {
        return Error::logs("no flight to fit");
    }
    let median_speed = median_speed(flights);
    let known = known(flights, median_speed, lag_s);
    let problem = HorizonProblem { flights, median_speed, known };
    let start = |i: usize| known[i].map_or(FORM[i].start, |known| known.mean);
    let (own, start) = (vec![Vec::new(); flights.len()], (0..PARAMETERS).map(start).collect());
    let solution = solve_within(&problem, own, start, MOST_STEPS, ENOUGH);
    if !solution.loss.is_finite() {
        return Error::logs("the fit does not converge: its loss is not a number");
    }
    let values: [f64; PARAMETERS] = std::array::from_fn(|i| solution.shared[i]);
    let at_bound = std::array::from_fn(|i| at_bound(values[i], [FORM[i].low, FORM[i].high]));
    let free: Vec<usize> = (0..PARAMETERS).filter(|i| !at_bound[*i] && known[*i].is_none()).collect();
    let cluster = |flight: &NormalEquations| NormalEquations {
        loss: flight.loss,
        gradient: flight.gradient.select_rows(&free),
        information: flight.information.select_rows(&free).select_columns(&free),
    };
    let covariance = cluster_robust_covariance(&solution.reduced.iter().map(cluster).collect::<Vec<_>>());
    let error = |i: usize| match free.iter().position(|free| *free == i) {
        Some(k) => covariance.as_ref().map_or(f64::NAN, |covariance| covariance[(k, k)].sqrt()),
        None => known[i].map_or(0.0, |known| known.sd),
    };
    Ok(MotorModel { median_speed, values, stderr: std::array::from_fn(error), at_bound })
}

#[cfg(test)]
mod tests {
    use super::super::regression::align;
    use super::*;

    /// Returns a vehicle of known numbers, kept up by a rate controller that excites it.
    fn flight(seed: u32) -> MotorFlight {
        let mut p = FORM.map(|p| p.start);
        (p[0], p[1], p[2], p[3], p[5], p[8], p[9]) = (9.81, 0.08, 70.0, 60.0, 0.5, 2.0, 3.0);
        let form = MotorForm::new(p, 3.0);
        let mut x = [0.0; 12];
        x[2] = 1.0;
        let (mut rows, mut commands) = (Vec::new(), Vec::new());
        let (mut motion, mut pwm) = (motion_of_row(&x), form.pwm([3.0; 4]));
        let phase = f64::from(seed);
        for k in 0..1500 {
            let t = f64::from(k) * STEP_S;
            let wanted = [0.15 * (1.3 * t + phase).sin(), 0.15 * (1.7 * t + 2.0 * phase).cos()];
            let moment = [0, 1].map(|i| 0.1 * (wanted[i] - x[6 + i]) - 0.02 * x[9 + i]);
            let lift = 0.05 * (0.9 * t + phase).sin() - 0.1 * (x[2] - 1.0) - 0.1 * x[5];
            let command: [f64; 4] = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)]
                .map(|(r, q)| 1.0 + lift + r * moment[0] + q * moment[1]);
            rows.push(x);
            commands.push(command.map(|c| 3.0 * c));
            form.advance(&mut motion, &mut pwm, command.map(|c| 3.0 * c), &Accelerations::none());
            x = row_of_motion(&motion);
        }
        MotorFlight { name: format!("made {seed}"), motion: rows, speeds: commands, rotors_later: 0 }
    }

    #[test]
    fn known_numbers_are_found() {
        let flights = [flight(1), flight(2), flight(3)];
        let model = fit(&flights, 0.08).unwrap();
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

    /// Noise of 3 % once made the torque weak, and drag took its place. The rotors of one flight are logged late.
    #[test]
    fn noise_and_delay_of_rotors_change_neither_torque_nor_drag() {
        let mut seed = 1_u64;
        let mut uniform = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut flights = [flight(1), flight(2), flight(3)];
        for flight in &mut flights {
            for speed in flight.speeds.iter_mut().flatten() {
                *speed *= 1.0 + 0.03 * ((0..12).map(|_| uniform()).sum::<f64>() - 6.0);
            }
            for rate in flight.motion.iter_mut().flat_map(|row| &mut row[9..]) {
                *rate += 0.002 * ((0..12).map(|_| uniform()).sum::<f64>() - 6.0);
            }
        }
        flights[1].delay_rotors(3);
        flights[1].rotors_later = 0;
        let median_speed = median_speed(&flights);
        let lag_s = align(&mut flights, median_speed, None);
        let model = fit(&flights, lag_s).unwrap();
        for (i, truth, error) in [(2, 70.0, 10.0), (3, 60.0, 10.0), (5, 0.5, 0.05)] {
            assert!((model.values[i] - truth).abs() < error, "{}: {model:?}", FORM[i].name);
        }
    }

    /// One flight has no spread between flights: its errors are those of white noise.
    #[test]
    fn one_flight_has_standard_errors() {
        let model = fit(&[flight(1)], 0.08).unwrap();
        for (i, error) in model.stderr.iter().enumerate() {
            assert_eq!(*error > 0.0, !model.at_bound[i], "{}: {model:?}", FORM[i].name);
        }
        assert!(model.stderr[5] > 0.0, "{model:?}");
    }

    #[test]
    fn nothing_to_fit_is_an_error() {
        assert_eq!(fit(&[], 0.08).unwrap_err().to_string(), "no flight to fit");
    }
}
