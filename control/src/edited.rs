//! Controllers whose measured rows are edited before they read them.

use super::batch::{check, mask};
use super::{Controller, ExtraInputs, InputNeeds, Mode};
use crazyflie_env::action::ACTION;
use crazyflie_env::error::Result;
use crazyflie_env::lanes::{LANES, LaneMask};
use crazyflie_env::observation::OBSERVATION;

/// An edit of the rows of up to sixteen environments.
pub(super) trait RowEdit: Clone + Send {
    /// See [`Controller::set_mode`].
    fn set_mode(&mut self, _mode: Mode) {}

    /// Forget the flights in the lanes of `mask`.
    fn reset(&mut self, mask: LaneMask);

    /// Edits measured rows.
    fn edit(&mut self, rows: &mut [f32]);

    /// Edits the controller's answer.
    fn finish(&self, _actions: &mut [f32]) {}
}

/// A controller that reads edited rows.
pub(super) struct EditedController<E> {
    inner: Box<dyn Controller>,
    tiles: Vec<E>,
    rows: Vec<f32>,
}

impl<E: RowEdit> EditedController<E> {
    pub(super) fn new(inner: Box<dyn Controller>, envs: usize, edit: E) -> Self {
        EditedController {
            inner,
            tiles: vec![edit; envs.div_ceil(LANES)],
            rows: vec![0.0; envs * OBSERVATION],
        }
    }

    /// Environments of the whole batch.
    fn envs(&self) -> usize {
        self.rows.len() / OBSERVATION
    }
}

impl<E: RowEdit> Controller for EditedController<E> {
    fn set_mode(&mut self, mode: Mode) {
        self.tiles.iter_mut().for_each(|edit| edit.set_mode(mode));
        self.inner.set_mode(mode);
    }

    fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        let envs = self.envs();
        for (tile, edit) in self.tiles.iter_mut().enumerate() {
            edit.reset(mask(tile, envs, of));
        }
        self.inner.reset(of);
    }

    fn needs(&self) -> InputNeeds {
        self.inner.needs()
    }

    fn set_inputs(&mut self, inputs: ExtraInputs<'_>) {
        self.inner.set_inputs(inputs);
    }

    fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        check(self.envs(), observations, actions)?;
        self.rows.copy_from_slice(observations);
        for (edit, rows) in self.tiles.iter_mut().zip(self.rows.chunks_mut(LANES * OBSERVATION)) {
            edit.edit(rows);
        }
        self.inner.act(&self.rows, actions)?;
        for (edit, actions) in self.tiles.iter().zip(actions.chunks_mut(LANES * ACTION)) {
            edit.finish(actions);
        }
        Ok(())
    }
}
