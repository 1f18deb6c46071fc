//! Closed-loop flights: a scenario, a controller and effects, flown for many seeds at once, and the figures
//! of the flights.

mod csv;
mod env_batch;
mod figures;
mod multi_drone;
mod picture;
mod scenario;
mod step_flight;

use crazyflie_control::{Controller, ControllerContext, ControllerSpec, ExtraInputs};
use crazyflie_env::Error;
use crazyflie_env::action::{ACTION, ActionLevel, Interface};
use crazyflie_env::config::{Autoreset, EffectTable, Options};
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::observation::{OBSERVATION, SETPOINT, index};
use crazyflie_env::plant::Command;
use crazyflie_env::task::Outline;
use crazyflie_env::vector::{METRICS, STATE, VectorEnv, state_index};

pub use csv::log;
pub use env_batch::EnvBatch;
pub use figures::{AXES, AxisFigures, AxisSpec, Figures, PhaseFigures, TouchDown, figures};
pub use multi_drone::{
    MultiDroneSetup, MultiDroneTrace, fly_multi_drone, multi_drone_path, multi_drone_picture,
};
pub(crate) use multi_drone::{crowd, metric};
pub use picture::{film, path, picture};
pub use scenario::{
    EPISODE_HZ, FlightScenario, LAB_LATENCY_S, Phase, SCENARIOS, lab_rig, phase_at, sensor_rig,
};
pub use step_flight::{
    QUANTILES, RESPONSE_S, STEP_S, StepBand, fly_band, pid_setup, signal_indices, step_options, step_setup,
};

/// Everything that decides a flight, besides its seed.
#[derive(Debug, Clone)]
pub struct Setup {
    /// Vehicle that flies, and that the controller is made for.
    pub model: Model,
    /// Task, start and phases of the flight.
    pub scenario: &'static FlightScenario,
    /// In place of the scenario's own, if given.
    pub task_options: Option<serde_json::Value>,
    /// A task of a user's own that is flown on the scenario's task.
    pub own: Option<OwnTask>,
    /// Action level; it must be one of the controller's.
    pub action: ActionLevel,
    /// Controller of the registry, with its options.
    pub controller: ControllerSpec,
    /// Effects that are on, besides those of the model.
    pub effects: EffectTable,
    /// Height input that actions command.
    pub vertical: VerticalInput,
    /// Longest time of a flight.
    pub seconds: f64,
}

/// Settings of a task file without a field in [`Setup`].
#[derive(Debug, Clone)]
pub struct OwnTask {
    /// Name in the file.
    pub name: String,
    /// Description in the file; may be empty.
    pub about: String,
    /// Reward, end, drones and whatever else makes the task. Its observation is that of controllers in Python which do
    /// not choose their own.
    pub options: Options,
}

impl Setup {
    /// Name of the flight.
    pub fn name(&self) -> &str {
        self.own.as_ref().map_or(self.scenario.name, |own| &own.name)
    }

    /// Description of the flight.
    pub fn about(&self) -> &str {
        match &self.own {
            Some(own) if !own.about.is_empty() => &own.about,
            _ => self.scenario.about,
        }
    }
}

/// Observation, state and action of one control tick.
#[derive(Debug, Clone, Copy)]
pub struct TraceRow {
    /// Reading of the tick, laid out as [`crazyflie_env::observation::FIELDS`].
    pub observation: [f32; OBSERVATION],
    /// True state of the vehicle, SI units; position first.
    pub state: [f32; STATE],
    /// The controller's action; in force until the next row.
    pub action: [f32; ACTION],
}

impl TraceRow {
    /// Set-point: x, y, z in meters, yaw in radians.
    pub fn setpoint(&self) -> &[f32] {
        &self.observation[SETPOINT.range()]
    }

    /// Returns whether the newest camera frame showed the marker.
    pub fn sees_marker(&self) -> bool {
        self.observation[index::MARKER_VALID] > 0.5
    }

    /// Distance of the true position from the setpoint.
    pub fn error_m(&self) -> f64 {
        squared_distance(&self.state[..3], self.setpoint()).sqrt()
    }
}

/// Squared distance of two points, over the axes of the shorter one.
pub fn squared_distance(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum()
}

/// End of a flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FlightEnd {
    /// The planned time was over.
    Time,
    /// Beyond the walls or the ceiling of the thesis's room.
    LeftRoom,
    /// On the floor, at this speed, where the task ends there.
    Floor {
        /// Sinking speed at the touch.
        impact_mps: f64,
    },
    /// In the air, by the task's own end.
    Task,
}

/// One flight.
#[derive(Debug, Clone)]
pub struct Trace {
    /// Time from one row to the next.
    pub tick_s: f64,
    /// Meaning of the actions.
    pub interface: Interface,
    /// Rows from the start until the end, one per control tick.
    pub rows: Vec<TraceRow>,
    /// Sum of the rewards.
    pub reward: f64,
    /// Reason that there are no more rows.
    pub end: FlightEnd,
    /// Edges of the objects in the room.
    pub outlines: Vec<Outline>,
}

impl Trace {
    /// A flight that has yet to begin.
    pub fn new(tick_s: f64, interface: Interface) -> Trace {
        Trace { tick_s, interface, rows: Vec::new(), reward: 0.0, end: FlightEnd::Time, outlines: Vec::new() }
    }

    /// Returns the time of a row, from the start of the flight.
    pub fn t_s(&self, row: usize) -> f64 {
        row as f64 * self.tick_s
    }

    /// Returns the command of a row: SI units, and PWM counts or metres. None where actions set something
    /// else: there the onboard cascade commands.
    pub fn command(&self, row: usize) -> Option<Command<f64>> {
        let is_command = self.interface.level() == ActionLevel::Attitude;
        is_command.then(|| self.interface.command(&self.rows[row].action.map(f64::from)))
    }

    /// One number of the true state over the flight.
    pub fn state(&self, at: usize) -> Vec<f64> {
        self.rows.iter().map(|r| f64::from(r.state[at])).collect()
    }

    /// One number of the observation over the flight.
    pub(crate) fn observation_column(&self, at: usize) -> Vec<f64> {
        self.rows.iter().map(|r| f64::from(r.observation[at])).collect()
    }
}

/// Above this a vehicle is in the air, whatever rounding leaves of the floor.
const AIRBORNE_M: f32 = 0.01;

/// Half the side of the room and its height, as the tasks have them (thesis 2.1).
const ROOM_M: [f32; 2] = [2.5, 2.8];

/// Writes the actions of a tick into the batch, from the time and what the batch knows. It may put a set-point of its
/// own into the observations.
type ControlLoop<'a> = dyn FnMut(f64, &mut EnvBatch) -> Result<(), Error> + 'a;

/// The setup's controller for these environments.
fn pilot(setup: &Setup, env: &VectorEnv) -> Result<Box<dyn Controller>, Error> {
    let (interface, tick_s, envs) = (env.interfaces()[0], env.tick_s(), env.num_envs());
    let site = ControllerContext {
        model: &setup.model,
        interface,
        tick_s,
        envs,
        mode: setup.scenario.phases[0].mode,
    };
    setup.controller.build(&site)
}

/// Flies the setup once per seed, by its controller.
pub fn fly(setup: &Setup, seeds: &[u64]) -> Result<Vec<Trace>, Error> {
    let env = env(setup, seeds.len())?;
    let phases = setup.scenario.phases;
    let mut pilot = pilot(setup, &env)?;
    let flights = fly_by(env, setup.seconds, seeds, &mut |t_s, batch| {
        let phase = phase_at(phases, t_s);
        if let Some(setpoint_m) = phase.setpoint_m {
            batch
                .observations
                .chunks_exact_mut(OBSERVATION)
                .for_each(|row| row[SETPOINT.range()][..3].copy_from_slice(&setpoint_m));
        }
        pilot.set_mode(phase.mode);
        pilot.set_inputs(ExtraInputs { states: &batch.states, others: &[] });
        pilot.act(&batch.observations, &mut batch.actions)
    })?;
    Ok(flights.into_iter().flat_map(|flight| flight.drones).collect())
}

/// Options of the environments; `drones` is 0 for the task's own number.
pub fn options(setup: &Setup, drones: usize) -> Result<Options, Error> {
    let base = setup.own.as_ref().map(|own| own.options.clone()).unwrap_or_default();
    let options = Options {
        task: setup.scenario.task.into(),
        task_options: setup.task_options.clone().unwrap_or_else(|| setup.scenario.task_options()),
        vertical: Some(setup.vertical),
        effects: setup.effects.clone(),
        autoreset: Autoreset::NextStep,
        drones: if drones == 0 { base.drones } else { drones },
        action: setup.action,
        // the time of the flight ends it, and controllers see what is measured
        max_episode_steps: 0,
        observation: Options::default().observation,
        history: 1,
        ..base
    };
    // the defaults of several drones are those of options that are read
    Options::parse(&serde_json::to_string(&options).map_err(|e| Error::Config(e.to_string()))?)
}

fn env(setup: &Setup, envs: usize) -> Result<VectorEnv, Error> {
    if setup.scenario.flies_several()? {
        return Err(Error::Config(format!(
            "the task {} is for several drones; this flies one",
            setup.scenario.task
        )));
    }
    VectorEnv::new(std::slice::from_ref(&setup.model), &options(setup, 0)?, envs)
}

/// Flies the environments once per seed, every drone until its flight is over.
fn fly_by(
    env: VectorEnv,
    seconds: f64,
    seeds: &[u64],
    control: &mut ControlLoop<'_>,
) -> Result<Vec<MultiDroneTrace>, Error> {
    let (tick_s, n) = (env.tick_s(), env.num_drones());
    let mut batch = EnvBatch::begin(env, seeds)?;
    let begin = |i: usize| {
        let outlines = batch.env.outlines(i)?;
        let trace =
            |interface: &Interface| Trace { outlines: outlines.clone(), ..Trace::new(tick_s, *interface) };
        let drones = batch.env.interfaces().iter().map(trace).collect();
        Ok(MultiDroneTrace { drones, metrics: [0.0; METRICS.len()] })
    };
    let mut flights = (0..seeds.len()).map(begin).collect::<Result<Vec<_>, Error>>()?;
    let mut over = vec![false; batch.flying.len()];
    let ticks = (seconds / tick_s).round() as usize;
    for tick in 0..=ticks {
        control(tick as f64 * tick_s, &mut batch)?;
        let traces = flights.iter_mut().flat_map(|flight| &mut flight.drones);
        for (i, (trace, over)) in traces.zip(&mut over).enumerate().filter(|(_, (_, over))| !**over) {
            trace.rows.push(batch.row(i));
            *over = !batch.flying[i];
            // the reason that one of several ended is in the metrics
            if *over && n == 1 {
                trace.end = end(&trace.rows);
            }
        }
        if tick == ticks || !over.contains(&false) {
            break;
        }
        let aloft: Vec<bool> = over.chunks(n).map(|over| over.contains(&false)).collect();
        batch.step()?;
        let traces = flights.iter_mut().flat_map(|flight| &mut flight.drones);
        for ((trace, reward), _) in traces.zip(&batch.rewards).zip(&over).filter(|(_, over)| !**over) {
            trace.reward += f64::from(*reward);
        }
        let rows = batch.metrics.as_chunks().0;
        for ((flight, row), _) in flights.iter_mut().zip(rows).zip(&aloft).filter(|(_, aloft)| **aloft) {
            flight.metrics = *row;
        }
    }
    Ok(flights)
}

/// Creates the row of drone `i`, whose observation begins a row of `width` numbers.
pub fn row(i: usize, width: usize, observations: &[f32], states: &[f32], actions: &[f32]) -> TraceRow {
    TraceRow {
        observation: numbers(&observations[i * width..]),
        state: numbers(&states[i * STATE..]),
        action: numbers(&actions[i * ACTION..]),
    }
}

/// The first numbers of a row.
fn numbers<const N: usize>(row: &[f32]) -> [f32; N] {
    let mut numbers = [0.0; N];
    numbers.copy_from_slice(&row[..N]);
    numbers
}

/// The reason for which a task ended the flight of these rows.
pub fn end(rows: &[TraceRow]) -> FlightEnd {
    let Some(last) = rows.last() else { return FlightEnd::Time };
    let [x, y, z] = [0, 1, 2].map(|i| last.state[i]);
    if x.abs() > ROOM_M[0] || y.abs() > ROOM_M[0] || z > ROOM_M[1] {
        return FlightEnd::LeftRoom;
    }
    if last.state[state_index::HEIGHT] > AIRBORNE_M {
        return FlightEnd::Task;
    }
    FlightEnd::Floor { impact_mps: touch_down_mps(rows, rows.len() - 1) }
}

/// Sinking speed with which the floor was met between the row before `at` and that row.
pub(crate) fn touch_down_mps(rows: &[TraceRow], at: usize) -> f64 {
    let before = &rows[at.saturating_sub(1)];
    f64::from(-before.state[state_index::CLIMB]).max(0.0)
}
