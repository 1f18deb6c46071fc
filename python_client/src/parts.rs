//! Controllers of a batch: one for each part of it that a thread flies by itself in a rollout.

use crazyflie_control::{Controller, ExtraInputs, InputNeeds};
use crazyflie_env::Result;
use crazyflie_env::action::{ACTION, Interface};
use crazyflie_env::vector::{RolloutBuffers, STATE, VectorEnv};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::arrays::{empty, input, mask as read_mask, output};
use crate::errors::guarded;
use crate::guarded_cell::GuardedCell;
use crate::sim::detached;

/// The batch that controllers are made for.
#[derive(Clone, Copy)]
pub struct ControlledBatch {
    pub envs: usize,
    /// Drones that are flown in each environment.
    pub drones: usize,
    /// Numbers of a drone's measured row.
    pub width: usize,
    /// Environments of each part but the last.
    pub share: usize,
    /// True if each part has a controller of its own.
    pub divisible: bool,
    /// The observations of its environment are the measured rows that controllers read.
    pub reads_rows: bool,
    /// Actions that the first drone's controller commands.
    pub interface: Interface,
}

/// The controllers of all parts of a batch.
pub struct PartControllers {
    pub of: ControlledBatch,
    parts: GuardedCell<Vec<Box<dyn Controller>>>,
}

impl PartControllers {
    /// Builds a controller for each part: `part` gets its first environment and their number.
    ///
    /// # Errors
    /// The errors of `part`.
    pub fn build(
        of: ControlledBatch,
        part: impl Fn(usize, usize) -> Result<Box<dyn Controller>>,
    ) -> PyResult<Self> {
        let firsts = (0..of.envs).step_by(of.share);
        let parts = guarded(|| {
            firsts.map(|first| part(first, of.share.min(of.envs - first))).collect::<Result<Vec<_>>>()
        })?;
        Ok(PartControllers { of, parts: GuardedCell::new(parts) })
    }

    /// Returns the controllers, part by part.
    ///
    /// # Errors
    /// `RuntimeError` if a call panicked while it had them.
    pub fn all(&mut self) -> PyResult<&mut Vec<Box<dyn Controller>>> {
        self.parts.get()
    }

    /// New actions for observations; `lead` are their axes but the last.
    ///
    /// # Errors
    /// `ValueError` for a controller whose environment observes something else than it reads.
    pub fn act<'py>(
        &mut self,
        py: Python<'py>,
        observations: &Bound<'py, PyAny>,
        lead: &[usize],
    ) -> PyResult<Bound<'py, PyAny>> {
        if !self.of.reads_rows {
            return Err(PyValueError::new_err(
                "observations: a controller reads what is measured, and this environment observes something else: \
                 call `act(controller)` of the environment, or make it with observation=\"measured\"",
            ));
        }
        let rows = input::<f32>("observations", &[lead, &[self.of.width]].concat(), observations)?;
        let shape = [lead, &[ACTION]].concat();
        let actions = empty::<f32>(py, PyTuple::new(py, &shape)?)?;
        let mut out = output::<f32>("actions", &shape, &actions)?;
        self.answer(py, rows.as_slice()?, &[], out.as_slice_mut()?)?;
        Ok(actions)
    }

    /// Forgets the flights: all, or those of the environments of `mask`.
    ///
    /// # Errors
    /// The errors of [`crate::arrays::mask`].
    pub fn reset(&mut self, mask: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let ControlledBatch { envs, share, .. } = self.of;
        let mask = mask.map(|mask| read_mask("mask", &[envs], mask)).transpose()?;
        let is_chosen = |env: usize| mask.as_ref().is_none_or(|mask| mask.get(env).copied().unwrap_or(false));
        for (i, part) in self.all()?.iter_mut().enumerate() {
            part.reset(&|env| is_chosen(i * share + env));
        }
        Ok(())
    }

    /// Returns what they need beside measured rows: each part the same.
    ///
    /// # Errors
    /// The errors of [`PartControllers::all`].
    pub fn needs(&mut self) -> PyResult<InputNeeds> {
        Ok(self.all()?.first().map_or_else(InputNeeds::default, |part| part.needs()))
    }

    /// Writes actions for measured rows, and true states where they are needed.
    ///
    /// # Errors
    /// `ValueError` for rows of another batch; the errors of the controllers.
    pub fn answer(&mut self, py: Python<'_>, rows: &[f32], states: &[f32], out: &mut [f32]) -> PyResult<()> {
        let ControlledBatch { envs, drones, width, share, .. } = self.of;
        if rows.len() != envs * drones * width {
            return Err(PyValueError::new_err(
                "controller: it was made for another batch: the `controller` method of the environment makes one",
            ));
        }
        let (rows_each, parts) = (share * drones, self.all()?);
        detached(py, envs * drones, || {
            let mut states = states.chunks(rows_each * STATE);
            let rows = rows.chunks(rows_each * width).zip(out.chunks_mut(rows_each * ACTION));
            parts.iter_mut().zip(rows).try_for_each(|(part, (rows, out))| {
                if let Some(states) = states.next() {
                    part.set_inputs(ExtraInputs { states, others: &[] });
                }
                part.act(rows, out)
            })
        })
    }

    /// Flies `steps` steps of `env`, whose parts have `share` environments; writes the last actions.
    ///
    /// # Errors
    /// `ValueError` for a controller in Python, and for one of another batch; the errors of the rollout.
    pub fn fly(
        &mut self,
        py: Python<'_>,
        env: &mut VectorEnv,
        share: usize,
        steps: usize,
        actions: &mut [f32],
        out: RolloutBuffers<'_>,
    ) -> PyResult<()> {
        let (of, envs) = (self.of, env.num_envs());
        if !of.divisible {
            return Err(PyValueError::new_err(
                "controller: one in Python answers for the whole batch at once, so that no rollout can fly it: \
                 call its `act` and `step` for every step",
            ));
        }
        if (of.envs, of.share) != (envs, share) {
            return Err(PyValueError::new_err(format!(
                "controller: it was made for another batch, of {} environments in parts of {}; expected {envs} in \
                 parts of {share}: the `controller` method of the environment makes one",
                of.envs, of.share
            )));
        }
        let parts = self.all()?;
        py.detach(|| guarded(|| env.rollout_with(parts, steps, actions, out)))
    }
}
