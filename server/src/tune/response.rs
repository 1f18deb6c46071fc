//! Response of a flight with some gains: to a step, or in a task.

use super::LoopRequirements;
use crate::flight::{
    FlightScenario, RESPONSE_S, STEP_S, Setup, Trace, fly, pid_setup, signal_indices, step_options,
    step_setup,
};
use crazyflie_control::loop_analysis::LoopAxis;
use crazyflie_control::pid::Gains;
use crazyflie_env::Error;
use crazyflie_env::config::EffectTable;
use crazyflie_env::model::{Model, VerticalInput};

/// Settled within this share of the step.
const BAND: f64 = 0.05;

/// Setup of the flights that gains are tuned on.
#[derive(Debug, Clone)]
pub struct TuningSetup<'a> {
    /// Vehicle that flies.
    pub model: &'a Model,
    /// Height input that is commanded.
    pub vertical: VerticalInput,
    /// Effects that are on.
    pub effects: EffectTable,
    /// A task or flight whose error counts besides that of a step of each axis.
    pub task: Option<&'static FlightScenario>,
    /// One flight for each.
    pub seeds: Vec<u64>,
    /// Requirements on every loop.
    pub requirements: LoopRequirements,
}

/// The mean over all flights of one axis.
#[derive(Debug, Clone)]
pub struct Response {
    /// Time from the start of the flight.
    pub t_s: Vec<f64>,
    /// True value, metres or radians.
    pub value: Vec<f64>,
    /// Set-point, metres or radians.
    pub target: Vec<f64>,
    /// Travel of the command of the axis per second, in shares of its range.
    pub travel_per_s: f64,
}

/// Figures of a step response, shares of the step and seconds.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct StepFigures {
    /// Beyond the set-point, the largest.
    pub overshoot: f64,
    /// Time from the step on until the response stays within 5 %; none if it does not.
    pub settling_s: Option<f64>,
    /// Time integral of the absolute error.
    pub error_s: f64,
    /// Travel of the command per second, in shares of its range.
    pub travel_per_s: f64,
}

impl TuningSetup<'_> {
    pub(super) fn setup(&self, gains: &Gains, scenario: &'static FlightScenario) -> Result<Setup, Error> {
        pid_setup(self.model, self.vertical, self.effects.clone(), gains, scenario)
    }

    /// The answer to a step of an axis.
    ///
    /// # Errors
    /// Those of the flight.
    pub fn response(&self, gains: &Gains, axis: LoopAxis) -> Result<Response, Error> {
        let setup = step_setup(self.model, self.vertical, self.effects.clone(), gains, axis)?;
        Ok(mean(&fly(&setup, &self.seeds)?, axis))
    }

    /// Time integral of the absolute error of an axis in the task, in steps and per as many seconds as a step
    /// is watched; a flight that ends early goes on as it ended.
    ///
    /// # Errors
    /// Those of the flight.
    pub fn task_error_s(&self, gains: &Gains, axis: LoopAxis) -> Result<Option<f64>, Error> {
        let Some(task) = self.task else { return Ok(None) };
        let setup = self.setup(gains, task)?;
        let ([state, setpoint, _], size) = (signal_indices(axis), step_options(axis).1);
        let flights = fly(&setup, &self.seeds)?;
        let absolute_error_s = |trace: &Trace| {
            let errors: Vec<f64> = trace
                .rows
                .iter()
                .map(|r| f64::from((r.state[state] - r.observation[setpoint]).abs()))
                .collect();
            let missing = setup.seconds - errors.len() as f64 * trace.tick_s;
            errors.iter().sum::<f64>() * trace.tick_s
                + errors.last().copied().unwrap_or(0.0) * missing.max(0.0)
        };
        let all: f64 = flights.iter().map(absolute_error_s).sum();
        Ok(Some(all / (flights.len().max(1) as f64 * size) * RESPONSE_S / setup.seconds))
    }
}

/// A flight that ended early stays where it ended.
fn mean(traces: &[Trace], axis: LoopAxis) -> Response {
    let [state, setpoint, action] = signal_indices(axis);
    let length = traces.iter().map(|t| t.rows.len()).max().unwrap_or(0);
    let row_of = |trace: &Trace, row: usize| trace.rows.get(row).or(trace.rows.last()).copied();
    let (mut value, mut target) = (vec![0.0; length], vec![0.0; length]);
    let share = 1.0 / traces.len().max(1) as f64;
    for row in 0..length {
        let rows = || traces.iter().filter_map(|trace| row_of(trace, row));
        value[row] = rows().map(|r| f64::from(r.state[state])).sum::<f64>() * share;
        target[row] = rows().map(|r| f64::from(r.observation[setpoint])).sum::<f64>() * share;
    }
    let travel = |t: &Trace| {
        t.rows
            .windows(2)
            .map(|pair| f64::from((pair[1].action[action] - pair[0].action[action]).abs()))
            .sum::<f64>()
    };
    let tick_s = traces.first().map_or(1.0, |t| t.tick_s);
    Response {
        t_s: (0..length).map(|row| row as f64 * tick_s).collect(),
        value,
        target,
        travel_per_s: traces.iter().map(travel).sum::<f64>() * share / (2.0 * length as f64 * tick_s),
    }
}

impl Response {
    /// Computes the figures of the step of an axis.
    pub fn figures(&self, axis: LoopAxis) -> StepFigures {
        let size = step_options(axis).1;
        let dt_s = self.t_s.get(1).copied().unwrap_or(1.0);
        let error: Vec<f64> = self.value.iter().zip(&self.target).map(|(v, t)| (v - t) / size).collect();
        let first = (STEP_S / dt_s).round() as usize;
        let start = error.get(first).copied().unwrap_or(0.0);
        // beyond the set-point is on the other side of it than the start
        let beyond = error.iter().skip(first).map(|e| if start < 0.0 { *e } else { -e });
        let last_out = error.iter().rposition(|e| e.abs() > BAND);
        StepFigures {
            overshoot: beyond.fold(0.0, f64::max),
            settling_s: match last_out {
                Some(row) if row + 1 == error.len() => None,
                Some(row) => Some((row as f64 * dt_s - STEP_S).max(0.0)),
                None => Some(0.0),
            },
            error_s: error.iter().map(|e| e.abs()).sum::<f64>() * dt_s,
            travel_per_s: self.travel_per_s,
        }
    }
}
