//! A drone that meets nobody: nothing to remember, and nothing to do.

use super::{AirSettings, Coupling};
use crate::effects::Neighbour;
use crate::error::Result;
use crate::plant::State;
use crate::sim_scalar::SimScalar;

/// The coupling of tasks for one drone.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Alone;

impl<R: SimScalar> Coupling<R> for Alone {
    const ALONE: bool = true;
    type Each<X: Send> = [X; 1];
    type Seen<'a> = [Neighbour<R>; 1];

    fn new(_: usize, _: AirSettings) -> Self {
        Alone
    }
    fn each<X: Send>(_: usize, mut make: impl FnMut(usize) -> Result<X>) -> Result<[X; 1]> {
        Ok([make(0)?])
    }
    fn drone_key(episode_key: u64, _: usize) -> u64 {
        episode_key
    }
    #[inline(always)]
    fn seen(&self, _: usize, x: &State<R>) -> [Neighbour<R>; 1] {
        [Neighbour { pos_m: x.pos_m, vel_mps: x.vel_mps, here: R::from_f64(1.0) }]
    }
}
