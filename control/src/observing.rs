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
pub struct Sight {
    /// Fields of its own drone.
    pub observation: ObservationChoice,
    /// Ticks, the newest last.
    pub history: usize,
    /// Other drones that it knows.
    pub others: usize,
}

impl Default for Sight {
    /// The measured row of the own drone.
    fn default() -> Self {
        Sight { observation: ObservationChoice::default(), history: 1, others: 0 }
    }
}

/// The controller behind what computes the observation that it reads, if that is not the measured row. `label` names it
/// in errors.
///
/// # Errors
/// The errors of [`MeasuredObserver::new`].
pub fn observing(
    inner: Box<dyn Controller>,
    site: &ControllerContext<'_>,
    sight: Sight,
    label: &str,
) -> Result<Box<dyn Controller>> {
    if sight == Sight::default() { Ok(inner) } else { ObservingController::wrap(inner, site, sight, label) }
}

/// Needs of a controller beside the measured rows of its drones.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Needs {
    /// The true state.
    pub truth: bool,
    /// Knowledge of so many other drones.
    pub others: usize,
}

/// Knowledge beside the measured rows of a controller's drones. Call [`Controller::tell`] with it before [`Controller::act`].
#[derive(Debug, Clone, Copy, Default)]
pub struct Beside<'a> {
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
    /// True states for the next rows; empty where nobody told them.
    states: Vec<f32>,
    is_told_of_others: bool,
    rows: Vec<f32>,
}

impl ObservingController {
    fn wrap(
        inner: Box<dyn Controller>,
        site: &ControllerContext<'_>,
        sight: Sight,
        label: &str,
    ) -> Result<Box<dyn Controller>> {
        let Sight { observation, history, others } = sight;
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
            is_told_of_others: false,
            rows: vec![0.0; envs * observer.width()],
            observer,
        }))
    }

    /// # Errors
    /// [`Error::Config`] for what it needs and was not told.
    fn check_told(&self) -> Result<()> {
        let (label, others) = (&self.label, self.others);
        if self.observer.needs_truth() && self.states.len() != self.envs * STATE {
            return Err(Error::Config(format!(
                "controller {label}: it reads the true state, and only measurements are known here; export it with \
                 estimated=True, or train it with observation=\"estimate\""
            )));
        }
        if others > 0 && !self.is_told_of_others {
            return Err(Error::Config(format!(
                "controller {label}: it reads {others} other drones; fly it where there are {} drones",
                others + 1
            )));
        }
        Ok(())
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

    fn needs(&self) -> Needs {
        Needs { truth: self.observer.needs_truth(), others: self.others }
    }

    fn tell(&mut self, beside: Beside<'_>) {
        self.states.clear();
        self.states.extend_from_slice(beside.states);
        let wide = NEIGHBOUR * self.others;
        self.is_told_of_others = wide > 0 && beside.others.len() == self.envs * wide;
        if self.is_told_of_others {
            let rows = self.measured.chunks_exact_mut(OBSERVATION + wide);
            for (row, others) in rows.zip(beside.others.chunks_exact(wide)) {
                row[OBSERVATION..].copy_from_slice(others);
            }
        }
    }

    fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        check(self.envs, observations, actions)?;
        self.check_told()?;
        let rows = self.measured.chunks_exact_mut(OBSERVATION + NEIGHBOUR * self.others);
        for (row, own) in rows.zip(observations.chunks_exact(OBSERVATION)) {
            row[..OBSERVATION].copy_from_slice(own);
        }
        self.observer.observe(&self.measured, &self.states, &mut self.rows);
        self.states.clear();
        self.inner.act(&self.rows, actions)
    }
}
