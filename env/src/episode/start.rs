//! Starts of episodes: drawn in double precision, and set lane by lane.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::{Coupling, Drone};
use crate::coupling::load::Load;
use crate::scalar::Scalar;
use crate::sim_scalar::SimScalar;
use crate::task::{Start, Task};

/// Starts of the drones of a tile, and its board.
pub(crate) struct Starts<R> {
    pub(crate) drones: Vec<Start<R>>,
    pub(crate) load_pos_m: [R; 3],
    pub(crate) board: Vec<R>,
}

impl<R: Scalar> Starts<R> {
    /// All at the origin.
    pub(crate) fn origin(drones: usize, board: usize) -> Self {
        let zero = R::zero();
        Starts { drones: vec![Start::origin(); drones], load_pos_m: [zero; 3], board: vec![zero; board] }
    }

    /// The start of one lane; a load hangs below the drones.
    pub(crate) fn set_lane(&mut self, lane: usize, starts: &[Start], board: &[f64], load: Option<Load>) {
        for (to, start) in self.drones.iter_mut().zip(starts) {
            set(&mut to.pos_m, &start.pos_m, lane);
            to.yaw_rad.set_lane(lane, start.yaw_rad);
            set(&mut to.vel_mps, &start.vel_mps, lane);
            set(&mut to.tilt_rad, &start.tilt_rad, lane);
            set(&mut to.goal, &start.goal, lane);
        }
        set(&mut self.board, board, lane);
        if let Some(load) = load {
            set(&mut self.load_pos_m, &load.hangs(starts.iter().map(|start| start.pos_m)), lane);
        }
    }
}

#[cfg(feature = "recording")]
impl<R: Scalar> Starts<R> {
    /// All numbers in order: of each drone, of a load where there is one, and of the board.
    pub(crate) fn numbers(&mut self, load: bool) -> Vec<&mut R> {
        let mut slots: Vec<&mut R> = Vec::new();
        for start in &mut self.drones {
            slots.extend(&mut start.pos_m);
            slots.push(&mut start.yaw_rad);
            slots.extend(&mut start.vel_mps);
            slots.extend(&mut start.tilt_rad);
            slots.extend(&mut start.goal);
        }
        slots.extend(self.load_pos_m.iter_mut().filter(|_| load));
        slots.extend(&mut self.board);
        slots
    }
}

fn set<R: Scalar>(to: &mut [R], from: &[f64], lane: usize) {
    for (slot, value) in to.iter_mut().zip(from) {
        slot.set_lane(lane, *value);
    }
}

/// Draws a start of the task, and the effects of the drones in one lane of a tile. Drones that are alone draw both
/// from one stream; drones of a world must not shake together.
pub(super) fn draw<R: SimScalar, T: Task, C: Coupling<R>>(
    task: &T,
    key: u64,
    drones: &mut [Drone<R>],
    (tile, lane): (usize, usize),
    starts: &mut [Start],
    board: &mut [f64],
) {
    let mut rng = Pcg64Mcg::seed_from_u64(key);
    if C::ALONE {
        drones[0].world.draw_lane(tile, lane, key, &mut rng);
    }
    starts.fill(Start::origin());
    task.start(&mut rng, starts, board);
    if !C::ALONE {
        for (own, drone) in drones.iter_mut().enumerate() {
            let key = C::drone_key(key, own);
            drone.world.draw_lane(tile, lane, key, &mut Pcg64Mcg::seed_from_u64(key));
        }
    }
}
