//! How episodes of a flock begin.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::flock::{Flock, Sums, neighbour};
use crate::lanes::LANES;
use crate::noise::{episode_key, scramble};
use crate::observation::{ACTION, Interface};
use crate::rows::lanes_of;
use crate::simulated::Batched;
use crate::swarm::Rules;
use crate::task::Start;
use crate::world::Tick;

/// The key of one drone's noise: drones of a world must not shake together.
fn drone_key(episode: u64, drone: usize) -> u64 {
    scramble(episode ^ (drone as u64 + 1).wrapping_mul(0x9fb2_1c65_1e98_df25))
}

impl<R: Batched> Flock<R> {
    pub(super) fn seed(&mut self, tile: usize, lane: usize, seed: u64) {
        (self.tiles[tile].seed[lane], self.tiles[tile].number[lane]) = (seed, 0);
    }

    /// What the next episode of a world is drawn from.
    pub(super) fn next_episode(&mut self, tile: usize, lane: usize) -> Pcg64Mcg {
        self.tiles[tile].number[lane] += 1;
        Pcg64Mcg::seed_from_u64(self.key(tile, lane))
    }

    fn key(&self, tile: usize, lane: usize) -> u64 {
        episode_key(self.tiles[tile].seed[lane], self.tiles[tile].number[lane] - 1)
    }

    /// One world's places and board, as the desk has them, and its drones' noise and parameters.
    pub(super) fn draw(&mut self, rules: &Rules, tile: usize, lane: usize) {
        let key = self.key(tile, lane);
        for i in 0..self.desk.begun.len() {
            let value = self.desk.begun[i];
            self.board_mut(tile)[i].set_lane(lane, value);
        }
        for drone in 0..self.len() {
            let start = self.desk.starts[drone];
            let key = drone_key(key, drone);
            self.drones[drone].draw_lane(tile, lane, key, &mut Pcg64Mcg::seed_from_u64(key));
            let x = &mut self.desk.x[drone];
            for i in 0..3 {
                x.pos_m[i].set_lane(lane, start.pos_m[i]);
            }
            x.att_rad[2].set_lane(lane, start.yaw_rad);
            self.desk.u[drone].lift.set_lane(lane, lift(&rules.interfaces[drone], &start));
            for (slot, value) in self.pilot_mut(tile, drone).goal.iter_mut().zip(start.goal) {
                slot.set_lane(lane, value);
            }
        }
        if let Some(rope) = &self.load {
            let hangs_m = rope.hangs(self.desk.starts.iter().map(|s| s.pos_m));
            for i in 0..3 {
                self.desk.hanging.pos_m[i].set_lane(lane, hangs_m[i]);
            }
        }
    }

    /// Begin episodes in the worlds of `bits` with what was drawn.
    #[inline(never)]
    pub(super) fn start(&mut self, rules: &Rules, tile: usize, bits: u32) {
        R::run(
            #[inline(always)]
            || self.start_now(rules, tile, bits),
        );
    }

    #[inline(always)]
    fn start_now(&mut self, rules: &Rules, tile: usize, bits: u32) {
        let (n, mask) = (self.len(), R::mask(bits));
        let Flock { drones, desk, pilots, tiles, .. } = self;
        let of = &mut tiles[tile];
        for i in 0..3 {
            of.load.pos_m[i] = R::select(mask, desk.hanging.pos_m[i], of.load.pos_m[i]);
            of.load.vel_mps[i] = R::select(mask, R::zero(), of.load.vel_mps[i]);
        }
        of.ended &= !(bits as u16);
        of.sums = of.sums.begun(mask);
        for drone in 0..n {
            let (pilot, u) = (&mut pilots[tile * n + drone], desk.u[drone]);
            pilot.flying |= bits as u16;
            let action = rules.interfaces[drone].action(&u);
            for i in 0..ACTION {
                pilot.last_action[i] = R::select(mask, action[i], pilot.last_action[i]);
            }
            for pull in &mut pilot.pull_mps2 {
                *pull = R::select(mask, R::zero(), *pull);
            }
            let reading = drones[drone].start(tile, mask, &desk.x[drone], &u);
            of.known.start(mask, drone, &reading.marker);
            desk.ticks[drone][0] = Tick { reading, ..Tick::none() };
            desk.contacts[drone] = desk.ticks[drone][0].contact;
            desk.scene[drone] = neighbour(drones[drone].state(tile), pilot.flying);
        }
    }

    /// Keep the last observations of the worlds of `bits`.
    pub(super) fn keep(&mut self, tile: usize, bits: u32, observations: &[f32]) {
        let size = self.final_observations.len() / self.worlds;
        for lane in lanes_of(bits) {
            let rows = (tile * LANES + lane) * size..(tile * LANES + lane + 1) * size;
            self.final_observations[rows.clone()].copy_from_slice(&observations[rows]);
        }
    }
}

/// What was commanded before: in the air it has been hovering, on the floor the motors stand still.
fn lift(interface: &Interface, start: &Start) -> f64 {
    match (interface.input.is_pwm(), start.pos_m[2] > 0.0) {
        (true, true) => interface.hover_lift,
        (true, false) => 0.0,
        (false, _) => start.pos_m[2],
    }
}

impl<R: Batched> Sums<R> {
    /// From nothing in the lanes of `mask`.
    #[inline(always)]
    fn begun(&self, mask: R::Mask) -> Self {
        let none = Sums::none();
        let fresh = |new: R, old: R| R::select(mask, new, old);
        Sums {
            collisions: fresh(none.collisions, self.collisions),
            crashes: fresh(none.crashes, self.crashes),
            done: fresh(none.done, self.done),
            nearest2_m2: fresh(none.nearest2_m2, self.nearest2_m2),
            settled_s: fresh(none.settled_s, self.settled_s),
            error2_m2: fresh(none.error2_m2, self.error2_m2),
            flown: fresh(none.flown, self.flown),
        }
    }
}
