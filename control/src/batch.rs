//! Control laws that are written once, for one drone or for lanes, flown for a batch.

use super::{Controller, Mode};
use crazyflie_env::action::ACTION;
use crazyflie_env::error::Result;
use crazyflie_env::lanes::{LANES, LaneMask, Lanes};
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::scalar::Scalar;

/// A control law of one drone, or of sixteen side by side, which never feel each other.
pub trait ControlLaw<R: Scalar>: Clone + Send {
    /// See [`Controller::set_mode`].
    fn set_mode(&mut self, _mode: Mode) {}

    /// Forget the flight in the lanes of `mask`.
    fn reset(&mut self, mask: R::Mask);

    /// The action row for an observation row.
    fn act(&mut self, o: &[R; OBSERVATION]) -> [R; ACTION];
}

/// A law for a batch of environments, row by row as they observe.
#[derive(Debug, Clone)]
pub struct Batch<L> {
    tiles: Vec<L>,
    envs: usize,
}

impl<L: ControlLaw<Lanes>> Batch<L> {
    /// `law` for `envs` environments.
    pub fn new(envs: usize, law: L) -> Self {
        Batch { tiles: vec![law; envs.div_ceil(LANES)], envs }
    }
}

impl<L: ControlLaw<Lanes>> Controller for Batch<L> {
    fn set_mode(&mut self, mode: Mode) {
        self.tiles.iter_mut().for_each(|law| law.set_mode(mode));
    }

    fn reset(&mut self, of: &dyn Fn(usize) -> bool) {
        for (tile, law) in self.tiles.iter_mut().enumerate() {
            law.reset(mask(tile, self.envs, of));
        }
    }

    fn act(&mut self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        check(self.envs, observations, actions)?;
        let tiles = observations.chunks(LANES * OBSERVATION).zip(actions.chunks_mut(LANES * ACTION));
        for (law, (seen, out)) in self.tiles.iter_mut().zip(tiles) {
            write(&law.act(&rows(seen)), out, ACTION);
        }
        Ok(())
    }
}

/// # Errors
/// [`crazyflie_env::Error::Shape`] unless both hold a row per environment.
pub(super) fn check(envs: usize, observations: &[f32], actions: &[f32]) -> Result<()> {
    crazyflie_env::error::check_length("observations", envs * OBSERVATION, observations.len())?;
    crazyflie_env::error::check_length("actions", envs * ACTION, actions.len())
}

/// The lanes of a tile whose environments `of` names.
pub(super) fn mask(tile: usize, envs: usize, of: &dyn Fn(usize) -> bool) -> LaneMask {
    LaneMask::from(std::array::from_fn(|lane| tile * LANES + lane < envs && of(tile * LANES + lane)))
}

/// Up to sixteen observation rows as lanes.
pub(super) fn rows(rows: &[f32]) -> [Lanes; OBSERVATION] {
    let mut o = [Lanes::zero(); OBSERVATION];
    for (lane, row) in rows.chunks_exact(OBSERVATION).enumerate() {
        o.iter_mut().zip(row).for_each(|(slot, value)| slot.array_mut()[lane] = *value);
    }
    o
}

/// Lanes as rows of so many numbers, or the first numbers of longer rows.
pub(super) fn write<const N: usize>(values: &[Lanes; N], out: &mut [f32], width: usize) {
    for (lane, row) in out.chunks_exact_mut(width).enumerate() {
        row.iter_mut().zip(values).for_each(|(slot, value)| *slot = value.array()[lane]);
    }
}
