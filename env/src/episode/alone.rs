//! A drone that meets nobody: nothing to remember, and nothing to do.

use super::{AirSettings, Around, At, Coupling, Drone};
use crate::archive::Archive;
use crate::coupling::{NEIGHBOUR, load};
use crate::effects::{Neighbour, Reading};
use crate::error::Result;
use crate::plant::State;
use crate::sim_scalar::{BatchScalar, SimScalar};
use crate::world::{GROUP, Tick, World};

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
    fn begin(&mut self, _: usize, _: R::Mask, _: &[R; 3]) {}
    #[inline(always)]
    fn start(&mut self, _: At, _: R::Mask, _: &Reading<R>, _: &State<R>) {}
    #[inline(always)]
    fn before(&mut self, _: usize, _: usize, _: &[Drone<R>]) {}
    #[inline(always)]
    fn around(&self, _: usize, _: usize) -> Option<[Around<'_, R>; GROUP]> {
        None
    }
    #[inline(always)]
    fn pulls(&self) -> bool {
        false
    }
    #[inline(always)]
    fn held(&self, _: usize, _: usize, _: usize, _: &World<R>) -> Option<[State<R>; GROUP]> {
        None
    }
    #[inline(always)]
    fn flies(&self, _: usize, _: usize) -> R::Mask {
        !R::nothing()
    }
    #[inline(always)]
    fn after(&mut self, _: usize, _: usize, _: &[Drone<R>], _: &[[Tick<R>; GROUP]; 1]) {}
    #[inline(always)]
    fn seen(&self, _: usize, x: &State<R>) -> [Neighbour<R>; 1] {
        [Neighbour { pos_m: x.pos_m, vel_mps: x.vel_mps, here: R::from_f64(1.0) }]
    }
    #[inline(always)]
    fn load(&self, _: usize) -> Option<&load::State<R>> {
        None
    }
    #[inline(always)]
    fn hit(&self, _: usize) -> R::Mask {
        R::nothing()
    }
    #[inline(always)]
    fn set_flies(&mut self, _: usize, _: usize, _: R::Mask) {}
    #[inline(always)]
    fn finish(&mut self, _: usize, _: usize) {}
    fn neighbour_row(&self, _: At, _: usize, _: R) -> [R; NEIGHBOUR] {
        [R::zero(); NEIGHBOUR]
    }
    fn nearest2_m2(&self, _: usize) -> R {
        R::zero()
    }
    #[cfg(feature = "recording")]
    fn show_numbers(&mut self, _: usize, _: &mut dyn crate::archive::Ledger<R>) {}
    fn archive(&mut self, _: usize, _: u16, _: &mut Archive<'_>)
    where
        R: BatchScalar,
    {
    }
}
