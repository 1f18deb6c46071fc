//! Forces from outside, such as a simulation of air or of contacts beside this one computes them.

use super::{Around, GROUP, World};
use crate::lanes::LANES;
use crate::plant::Accelerations;
use crate::scalar::Scalar;
use crate::sim_scalar::{BatchScalar, SimScalar};

impl<R: SimScalar> World<R> {
    /// Sets forces in the world frame from now on, N, or none. The rows of three are for each drone of each
    /// environment; those of one of `drones` are used.
    pub(crate) fn set_force(&mut self, force_n: Option<&[f32]>, [drone, drones]: [usize; 2])
    where
        R: BatchScalar,
    {
        let Some(force_n) = force_n else { return self.forced_mps2.clear() };
        self.forced_mps2.resize(self.states.len(), [R::zero(); 3]);
        for (tile, forced_mps2) in self.forced_mps2.iter_mut().enumerate() {
            for lane in 0..LANES {
                let row = ((tile * LANES + lane) * drones + drone) * 3;
                let Some(force_n) = force_n.get(row..row + 3) else { break };
                for (slot, force_n) in forced_mps2.iter_mut().zip(force_n) {
                    slot.set_lane(lane, f64::from(*force_n) / self.mass_kg);
                }
            }
        }
    }
}

/// Pushes on a group of tiles besides the effects: of ropes, or a filter's disturbance, and forces.
pub(super) struct Outside<'a, R> {
    pub(super) around: Option<&'a [Around<'a, R>; GROUP]>,
    pub(super) disturbance: Option<Accelerations<R>>,
    /// Accelerations of the tiles from `first` on; empty if there are none.
    pub(super) forced_mps2: &'a [[R; 3]],
    pub(super) first: usize,
}

impl<R: Scalar> Outside<'_, R> {
    #[inline(always)]
    pub(super) fn is_there(&self) -> bool {
        self.around.is_some() || self.disturbance.is_some() || !self.forced_mps2.is_empty()
    }

    /// On tile `i` of the group.
    #[inline(always)]
    pub(super) fn push(&self, i: usize) -> Accelerations<R> {
        let mut push = match self.around {
            Some(around) => around[i].push,
            None => self.disturbance.unwrap_or(Accelerations::none()),
        };
        let forced_mps2 = self.forced_mps2.get(self.first + i);
        for (sum, forced_mps2) in push.acc_mps2.iter_mut().zip(forced_mps2.into_iter().flatten()) {
            *sum += *forced_mps2;
        }
        push
    }
}
