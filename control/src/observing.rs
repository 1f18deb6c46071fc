//! A controller that reads another observation than its drone's measured row: the wrapper computes that observation.

use serde::Deserialize;

use super::batch::check;
use super::{Controller, ControllerContext, Mode};
use crazyflie_env::coupling::NEIGHBOUR;
use crazyflie_env::error::{Error, Result};
use crazyflie_env::observation::{OBSERVATION, ObservationChoice};
use crazyflie_env::vector::{MeasuredObserver, STATE};

/// Observation that a controller reads.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ObservationSpec {
    /// Fields of its own drone.
    pub observation: ObservationChoice,
    /// Ticks, the newest last.
    pub history: usize,
    /// Other drones that it knows.
    pub others: usize,
}

impl Default for ObservationSpec {
    /// The measured row of the own drone.
    fn default() -> Self {
        ObservationSpec { observation: ObservationChoice::default(), history: 1, others: 0 }
    }
}

/// The controller behind what computes the observation that it reads, if that is not the measured row. `label` names it
/// in errors.
///
/// # Errors
/// The errors of [`MeasuredObserver::new`].
pub fn with_observation(
    inner: Box<dyn Controller>,
    site: &ControllerContext<'_>,
    spec: ObservationSpec,
    label: &str,
) -> Result<Box<dyn Controller>> {
    if spec == ObservationSpec::default() {
        return Ok(inner);
    }
    let ObservationSpec { observation, history, others } = spec;
    let envs = site.envs;
    let filter = (site.model, site.interface.input, site.tick_s);
    let observer =
        MeasuredObserver::new(&observation, history, [envs, others], filter).map_err(|e| match e {
            Error::Config(problem) => Error::Config(format!("controller {label}: {problem}")),
            other => other,
        })?;
    Ok(Box::new(ObservingController {
        inner,
        label: label.to_owned(),
        others,
        envs,
        measured: vec![0.0; envs * (OBSERVATION + NEIGHBOUR * others)],
        states: Vec::new(),
        has_others: false,
        rows: vec![0.0; envs * observer.width()],
        observer,
    }))
}

/// Needs of a controller beside the measured rows of its drones.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct InputNeeds {
    /// The true state.
    pub truth: bool,
    /// Knowledge of so many other drones.
    pub others: usize,
}

impl InputNeeds {
    /// Refuses a controller that reads the true state, where `reason` says why there is none.
    ///
    /// # Errors
    /// [`Error::Config`] that begins with `name`.
    pub fn refuse_truth(self, name: &str, reason: &str) -> Result<()> {
        if !self.truth {
            return Ok(());
        }
        Err(Error::Config(format!(
            "{name}: it reads the true state, and {reason}; export it with estimated=True, or train it with \
             observation=\"estimate\""
        )))
    }

    /// Checks that a controller which reads other drones knows as many.
    ///
    /// # Errors
    /// [`Error::Config`] that begins with `name`.
    pub fn check_others(self, name: &str, known: usize) -> Result<()> {
        let InputNeeds { others, .. } = self;
        if others == 0 || others == known {
            return Ok(());
        }
        let drones = others + 1;
        Err(Error::Config(format!(
            "{name}: it reads fields of {others} other drones; fly it where there are {drones} drones"
        )))
    }
}

/// Inputs of a controller beside the measured rows of its drones, see [`Controller::set_inputs`].
#[derive(Debug, Clone, Copy, Default)]
pub struct ExtraInputs<'a> {
    /// True states, a row of [`STATE`] for each environment; empty where they are unknown.
    pub states: &'a [f32],
    /// Knowledge of other drones, [`NEIGHBOUR`] numbers for each; empty where there are none.
    pub others: &'a [f32],
}

/// Computes the observation of a controller from measured rows.
struct ObservingController {
    inner: Box<dyn Controller>,
    observer: MeasuredObserver,
    label: String,
    others: usize,
    envs: usize,
    /// Measured rows with the knowledge of others behind them.
    measured: Vec<f32>,
    /// True states for the next rows; empty where nobody gave them.
    states: Vec<f32>,
    has_others: bool,
    rows: Vec<f32>,
}

impl ObservingController {
    /// # Errors
    /// [`Error::Config`] for what it needs and did not get.
    fn check_inputs(&self) -> Result<()> {
        let name = format!("controller {}", self.label);
        if self.states.len() != self.envs * STATE {
            self.needs().refuse_truth(&name, "only measurements are known here")?;
        }
        self.needs().check_others(&name, if self.has_others { self.others } else { 0 })
    }
}

impl Controller for ObservingController {
    fn set_mode(&mut self, mode: Mode) {
        self.inner.set_mode(mode);
    }

    fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        self.observer.reset(of);
        self.inner.reset(of);
    }

    fn needs(&self) -> InputNeeds {
        InputNeeds { truth: self.observer.needs_truth(), others: self.others }
    }

    fn set_inputs(&mut self, inputs: ExtraInputs<'_>) {
        self.states.clear();
        self.states.extend_from_slice(inputs.states);
        let wide = NEIGHBOUR * self.others;
        self.has_others = wide > 0 && inputs.others.len() == self.envs * wide;
        if self.has_others {
            let rows = self.measured.chunks_exact_mut(OBSERVATION + wide);
            for (row, others) in rows.zip(inputs.others.chunks_exact(wide)) {
                row[OBSERVATION..].copy_from_slice(others);
            }
        }
    }

    fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        check(self.envs, observations, actions)?;
        self.check_inputs()?;
        let rows = self.measured.chunks_exact_mut(OBSERVATION + NEIGHBOUR * self.others);
        for (row, own) in rows.zip(observations.chunks_exact(OBSERVATION)) {
            row[..OBSERVATION].copy_from_slice(own);
        }
        self.observer.observe(&self.measured, &self.states, &mut self.rows);
        self.states.clear();
        self.inner.act(&self.rows, actions)
    }
}
