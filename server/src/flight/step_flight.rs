//! Flights that step the set-point of one axis: what gains are tuned on.

use crazyflie_control::loop_analysis::LoopAxis;
use crazyflie_control::pid::Gains;
use crazyflie_control::{ExtraInputs, choose};
use crazyflie_env::Error;
use crazyflie_env::action::ActionLevel;
use crazyflie_env::config::EffectTable;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::observation::{OBSERVATION, index};
use crazyflie_env::vector::{STATE, state_index};
use serde::Serialize;
use serde_json::{Value, json};

use super::{EnvBatch, FlightScenario, Setup, env, pilot};

/// Time of the set-point step, and the time that its response is recorded.
pub const STEP_S: f64 = 0.5;
/// Length of the flight from the step on.
pub const RESPONSE_S: f64 = 7.0;
/// Shares of the flights that lie below the lines of a band.
pub const QUANTILES: [f64; 5] = [0.05, 0.25, 0.5, 0.75, 0.95];

/// The task's options for a step of an axis, and its size in metres or radians.
pub fn step_options(axis: LoopAxis) -> (Value, f64) {
    let (x, y, z, yaw) = match axis {
        LoopAxis::X => (0.5, 0.0, 0.7, 0.0),
        LoopAxis::Y => (0.0, 0.5, 0.7, 0.0),
        LoopAxis::Z => (0.0, 0.0, 1.0, 0.0),
        LoopAxis::Yaw => (0.0, 0.0, 0.7, 30.0),
    };
    let size = x + y + (z - 0.7) + f64::to_radians(yaw);
    (
        json!({"start_m": [0, 0, 0.7], "steps": [{"from_s": STEP_S, "setpoint_m": [x, y, z], "setpoint_yaw_deg": yaw}]}),
        size,
    )
}

/// Indices of an axis in state, observation (set-point) and action.
pub fn signal_indices(axis: LoopAxis) -> [usize; 3] {
    match axis {
        LoopAxis::X => [state_index::POS, index::SETPOINT_X, 1],
        LoopAxis::Y => [state_index::POS + 1, index::SETPOINT_Y, 0],
        LoopAxis::Z => [state_index::HEIGHT, index::SETPOINT_Z, 3],
        LoopAxis::Yaw => [state_index::YAW, index::SETPOINT_YAW, 2],
    }
}

/// A flight by the PID with these gains.
///
/// # Errors
/// For gains that are not finite.
pub fn pid_setup(
    model: &Model,
    vertical: VerticalInput,
    effects: EffectTable,
    gains: &Gains,
    scenario: &'static FlightScenario,
) -> Result<Setup, Error> {
    let bytes = serde_json::to_vec(gains).map_err(|e| Error::Config(e.to_string()))?;
    Ok(Setup {
        model: model.clone(),
        scenario,
        task_options: None,
        own: None,
        action: ActionLevel::Attitude,
        controller: choose("pid:tuned", Value::Null, &|_| Ok(bytes.clone()))?,
        effects,
        vertical,
        seconds: scenario.seconds,
    })
}

/// A flight with a step of an axis by the PID.
///
/// # Errors
/// For gains that are not finite.
pub fn step_setup(
    model: &Model,
    vertical: VerticalInput,
    effects: EffectTable,
    gains: &Gains,
    axis: LoopAxis,
) -> Result<Setup, Error> {
    let setup = pid_setup(model, vertical, effects, gains, FlightScenario::find("hover-70cm")?)?;
    Ok(Setup { task_options: Some(step_options(axis).0), seconds: STEP_S + RESPONSE_S, ..setup })
}

/// One axis of many flights of one setup, tick by tick.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StepBand {
    /// Time from the start of the flight.
    pub t_s: Vec<f64>,
    /// Set-point of the axis, metres or radians.
    pub target: Vec<f32>,
    /// For each of [`QUANTILES`], the value that this share of the flights is below.
    pub quantiles: Vec<Vec<f32>>,
    /// Flights in all.
    pub flights: usize,
    /// Flights that ended on the floor or outside the room; from there on they stay as they were.
    pub crashed: usize,
}

/// Flies a setup once per seed and keeps one axis: a thousand flights in a few megabytes.
///
/// # Errors
/// Those of the flights.
pub fn fly_band(setup: &Setup, seeds: &[u64], axis: LoopAxis) -> Result<StepBand, Error> {
    let env = env(setup, seeds.len())?;
    let mut pilot = pilot(setup, &env)?;
    let (envs, tick_s) = (seeds.len(), env.tick_s());
    let [state, setpoint, _] = signal_indices(axis);
    let (mut now, mut over) = (vec![0.0_f32; envs], vec![false; envs]);
    let mut band = StepBand {
        t_s: Vec::new(),
        target: Vec::new(),
        quantiles: vec![Vec::new(); QUANTILES.len()],
        flights: envs,
        crashed: 0,
    };
    let mut batch = EnvBatch::begin(env, seeds)?;
    let ticks = (setup.seconds / tick_s).round() as usize;
    for tick in 0..=ticks {
        for i in (0..envs).filter(|i| !over[*i]) {
            now[i] = batch.states[i * STATE + state];
        }
        over.iter_mut().zip(&batch.flying).for_each(|(over, flies)| *over |= !flies);
        band.t_s.push(tick as f64 * tick_s);
        // all flights have the same set-point; one that is over may have begun anew
        let flying = over.iter().position(|over| !over);
        let last = band.target.last().copied().unwrap_or_default();
        band.target.push(flying.map_or(last, |i| batch.observations[i * OBSERVATION + setpoint]));
        let mut sorted = now.clone();
        sorted.sort_by(f32::total_cmp);
        for (line, share) in band.quantiles.iter_mut().zip(QUANTILES) {
            line.push(sorted[(share * (envs - 1) as f64).round() as usize]);
        }
        if tick == ticks {
            break;
        }
        pilot.set_inputs(ExtraInputs { states: &batch.states, others: &[] });
        pilot.act(&batch.observations, &mut batch.actions)?;
        batch.step()?;
    }
    band.crashed = over.iter().filter(|over| **over).count();
    Ok(band)
}
