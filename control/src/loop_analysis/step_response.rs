//! The answer of a closed loop to a step of its set-point.

use crazyflie_env::transfer_function::TransferFunction;
use nalgebra::{DMatrix, DVector};

use super::FeedbackLoop;

/// Parts of a tick at which the answer is known; the dead time is rounded to them.
const PARTS: usize = 8;
/// Settled within this share of the step.
const BAND: f64 = 0.05;
/// An answer beyond this many steps is unstable; what follows would only overflow.
const RUNAWAY: f64 = 1e3;

/// The answer to a step from 0 to 1, without the limits of integral and output.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct StepResponse {
    /// Time from the step, in seconds.
    pub t_s: Vec<f64>,
    /// The loop's output, in shares of the step; shorter than requested if the loop diverges.
    pub value: Vec<f64>,
    /// Figures of the answer.
    pub figures: StepFigures,
}

/// Figures of a step response.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct StepFigures {
    /// From 10 to 90 percent of the step; none if it does not get there.
    pub rise_s: Option<f64>,
    /// Largest value beyond the step, in shares of it.
    pub overshoot: f64,
    /// Time until it stays within 5 percent of the step; none if it does not within the time looked at.
    pub settling_s: Option<f64>,
    /// Distance from the step at the end, in shares of it.
    pub final_error: f64,
}

impl FeedbackLoop {
    /// Simulates the step as the controller flies: an error each tick, a command constant over a tick, and the dead
    /// time besides.
    pub fn step_response(&self, tick_s: f64, seconds: f64) -> StepResponse {
        let part_s = tick_s / PARTS as f64;
        let (a, b, c) = held(&self.plant, part_s);
        // a held command is half a tick old on average, which is part of the dead time
        let late = ((self.dead_time_s - 0.5 * tick_s).max(0.0) / part_s).round() as usize;
        let mut x = DVector::zeros(a.nrows());
        let (mut value, mut integral, mut last, mut u) = (vec![0.0], 0.0, 0.0, 0.0);
        for part in 0..(seconds / part_s).round() as usize {
            if part % PARTS == 0 {
                let measured = part.checked_sub(late).map_or(0.0, |at| value[at]);
                let error = 1.0 - measured;
                integral += error * tick_s;
                let slope = (error - last) / tick_s;
                last = error;
                u = self.gains.kp * error + self.gains.ki * integral + self.gains.kd * slope;
            }
            x = &a * &x + &b * u;
            let y = c.dot(&x);
            value.push(y);
            if y.abs() > RUNAWAY {
                break;
            }
        }
        let t_s: Vec<f64> = (0..value.len()).map(|part| part as f64 * part_s).collect();
        let figures = figures(&t_s, &value);
        StepResponse { t_s, value, figures }
    }
}

/// A strictly proper transfer function over a time with the input held: x' = A x + B u, y = C x in
/// controllable form, exact by the matrix exponential.
fn held(plant: &TransferFunction, seconds: f64) -> (DMatrix<f64>, DVector<f64>, DVector<f64>) {
    let order = plant.denominator.len() - 1;
    let mut augmented = DMatrix::zeros(order + 1, order + 1);
    for i in 0..order {
        // z^(n) = u - a1 z^(n-1) - ... - an z
        augmented[(order - 1, i)] = -plant.denominator[order - i];
        if i + 1 < order {
            augmented[(i, i + 1)] = 1.0;
        }
    }
    augmented[(order - 1, order)] = 1.0;
    let e = (augmented * seconds).exp();
    let c = DVector::from_fn(order, |i, _| {
        plant.numerator.len().checked_sub(i + 1).map_or(0.0, |at| plant.numerator[at])
    });
    (e.view((0, 0), (order, order)).into_owned(), e.view((0, order), (order, 1)).column(0).into_owned(), c)
}

fn figures(t_s: &[f64], value: &[f64]) -> StepFigures {
    let reached = |share: f64| value.iter().position(|v| *v >= share).map(|i| t_s[i]);
    let last_outside = value.iter().rposition(|v| (v - 1.0).abs() > BAND);
    let final_error = value.last().map_or(f64::INFINITY, |v| (v - 1.0).abs());
    StepFigures {
        rise_s: reached(0.1).zip(reached(0.9)).map(|(from, to)| to - from),
        overshoot: value.iter().map(|v| v - 1.0).fold(0.0, f64::max),
        settling_s: match last_outside {
            Some(i) if i + 1 == value.len() => None,
            Some(i) => Some(t_s[i + 1]),
            None => Some(0.0),
        },
        final_error,
    }
}

#[cfg(test)]
mod tests {
    use crazyflie_env::model::{Model, VerticalInput};

    use super::*;
    use crate::loop_analysis::LoopAxis;
    use crate::pid::{Gains, Loop};

    /// 1/s with gain k answers 1 - exp(-k t): it rises within ln 9 / k and settles within ln 20 / k.
    #[test]
    fn an_integrator_answers_as_in_the_book() {
        let gains = Loop { kp: 2.0, ki: 0.0, kd: 0.0, integral: [0.0; 2], output: [0.0; 2] };
        let plant = TransferFunction { numerator: vec![1.0], denominator: vec![1.0, 0.0] };
        let answer = FeedbackLoop { plant, gains, dead_time_s: 0.0 }.step_response(0.001, 5.0);
        for (t_s, value) in answer.t_s.iter().zip(&answer.value) {
            assert!((value - (1.0 - (-2.0 * t_s).exp())).abs() < 2e-3, "{t_s} {value}");
        }
        let f = answer.figures;
        assert!((f.rise_s.unwrap() - 9.0_f64.ln() / 2.0).abs() < 0.01 && f.overshoot < 1e-6, "{f:?}");
        assert!((f.settling_s.unwrap() - 20.0_f64.ln() / 2.0).abs() < 0.01, "{f:?}");
    }

    /// The answer grows if the phase margin is negative, and settles if it is large.
    #[test]
    fn margins_and_answers_agree() {
        let model = Model::thesis();
        for gains in [Gains::THESIS, Gains::CRAZYFLIE_ROS] {
            for axis in LoopAxis::ALL {
                let own =
                    FeedbackLoop::from_model(&model, VerticalInput::Thrust, axis, &gains, 0.077).unwrap();
                let (phase_deg, answer) = (own.margins().phase_deg, own.step_response(0.02, 60.0));
                let settles = answer.figures.settling_s.is_some();
                assert!((phase_deg > 0.0) == settles, "{axis:?} {phase_deg} {:?}", answer.figures);
            }
        }
    }
}
