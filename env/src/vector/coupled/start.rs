//! How episodes of a drones begin.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::drone_batch::{DroneBatch, EpisodeStats, Tile, neighbour};
use crate::action::ACTION;
use crate::archive::Archive;
use crate::episode::lift_before;
use crate::lanes::LANES;
use crate::noise::{drone_key, episode_key};
use crate::rows::{STATE, lanes_of, state_row, write_lane};
use crate::sim_scalar::BatchScalar;
use crate::vector::BatchConfig;
use crate::world::Tick;

impl<R: BatchScalar> DroneBatch<R> {
    pub(in crate::vector) fn seed(&mut self, tile: usize, lane: usize, seed: u64) {
        (self.tiles[tile].seed[lane], self.tiles[tile].number[lane]) = (seed, 0);
    }

    /// What the next episode of a world is drawn from.
    pub(in crate::vector) fn next_episode(&mut self, tile: usize, lane: usize) -> Pcg64Mcg {
        self.tiles[tile].number[lane] += 1;
        Pcg64Mcg::seed_from_u64(self.key(tile, lane))
    }

    fn key(&self, tile: usize, lane: usize) -> u64 {
        episode_key(self.tiles[tile].seed[lane], self.tiles[tile].number[lane] - 1)
    }

    /// One world's places and board, as the scratch has them, and its drones' noise and parameters.
    pub(in crate::vector) fn draw(&mut self, config: &BatchConfig, tile: usize, lane: usize) {
        let key = self.key(tile, lane);
        for i in 0..self.scratch.begun.len() {
            let value = self.scratch.begun[i];
            self.board_mut(tile)[i].set_lane(lane, value);
        }
        for drone in 0..self.len() {
            let start = self.scratch.starts[drone];
            let key = drone_key(key, drone);
            self.drones[drone].draw_lane(tile, lane, key, &mut Pcg64Mcg::seed_from_u64(key));
            let x = &mut self.scratch.x[drone];
            for i in 0..3 {
                x.pos_m[i].set_lane(lane, start.pos_m[i]);
            }
            x.att_rad[2].set_lane(lane, start.yaw_rad);
            let lift = lift_before(&config.interfaces[drone], start.pos_m[2]);
            self.scratch.u[drone].lift.set_lane(lane, lift);
            for (slot, value) in self.slot_mut(tile, drone).goal.iter_mut().zip(start.goal) {
                slot.set_lane(lane, value);
            }
        }
        if let Some(rope) = &self.load {
            let hangs_m = rope.hangs(self.scratch.starts.iter().map(|s| s.pos_m));
            for i in 0..3 {
                self.scratch.hanging.pos_m[i].set_lane(lane, hangs_m[i]);
            }
        }
    }

    /// Begin episodes in the envs of `bits` with what was drawn.
    #[inline(never)]
    pub(in crate::vector) fn start(&mut self, config: &BatchConfig, tile: usize, bits: u32) {
        R::run(
            #[inline(always)]
            || self.start_now(config, tile, bits),
        );
    }

    #[inline(always)]
    fn start_now(&mut self, config: &BatchConfig, tile: usize, bits: u32) {
        let (n, mask) = (self.len(), R::mask(bits));
        let DroneBatch { drones, onboard, scratch, slots, tiles, .. } = self;
        let of = &mut tiles[tile];
        for i in 0..3 {
            of.load.pos_m[i] = R::select(mask, scratch.hanging.pos_m[i], of.load.pos_m[i]);
            of.load.vel_mps[i] = R::select(mask, R::zero(), of.load.vel_mps[i]);
        }
        of.ended &= !(bits as u16);
        of.stats = of.stats.begun(mask);
        for drone in 0..n {
            let (slot, u) = (&mut slots[tile * n + drone], scratch.u[drone]);
            slot.flying |= bits as u16;
            let action = config.interfaces[drone].action_before(&scratch.x[drone], &u);
            if let Some(onboard) = &mut onboard[drone] {
                onboard.start(tile, mask);
            }
            for i in 0..ACTION {
                slot.last_action[i] = R::select(mask, action[i], slot.last_action[i]);
            }
            for pull in &mut slot.pull_mps2 {
                *pull = R::select(mask, R::zero(), *pull);
            }
            let reading = drones[drone].start(tile, mask, &scratch.x[drone], &u);
            of.known.start(mask, drone, &reading.marker);
            scratch.ticks[drone][0] = Tick { reading, ..Tick::none() };
            scratch.contacts[drone] = scratch.ticks[drone][0].contact;
            scratch.scene[drone] = neighbour(drones[drone].state(tile), slot.flying);
        }
    }

    /// What a tile's flights go on from.
    pub(in crate::vector) fn archive(&mut self, tile: usize, archive: &mut Archive<'_>) {
        let n = self.drones.len();
        self.board_mut(tile).iter_mut().for_each(|number| archive.number(number));
        let DroneBatch { drones, onboard, slots, tiles, .. } = self;
        tiles[tile].archive(archive);
        let Tile { seed, number, used, .. } = &tiles[tile];
        for (drone, (world, slot)) in drones.iter_mut().zip(&mut slots[tile * n..(tile + 1) * n]).enumerate()
        {
            slot.archive(*used, archive);
            world.archive(
                tile,
                |lane| drone_key(episode_key(seed[lane], number[lane].wrapping_sub(1)), drone),
                archive,
            );
        }
        for onboard in onboard.iter_mut().flatten() {
            onboard.show_numbers(tile, archive);
        }
        if let Some(observer) = &mut self.observer {
            observer.archive(tile, archive);
        }
    }

    /// Forces from outside, rows of three for each drone.
    pub(in crate::vector) fn set_force(&mut self, force_n: Option<&[f32]>) {
        let n = self.drones.len();
        for (drone, world) in self.drones.iter_mut().enumerate() {
            world.set_force(force_n, [drone, n]);
        }
    }

    /// Keep the last observations and true states of the environments of `bits`.
    pub(in crate::vector) fn keep(&mut self, tile: usize, bits: u32, observations: &[f32]) {
        let size = self.final_observations.len() / self.envs;
        for lane in lanes_of(bits) {
            let env = tile * LANES + lane;
            let rows = env * size..(env + 1) * size;
            self.final_observations[rows.clone()].copy_from_slice(&observations[rows]);
            for (drone, row) in self
                .final_states
                .chunks_exact_mut(STATE)
                .skip(env * self.drones.len())
                .take(self.drones.len())
                .enumerate()
            {
                write_lane(&state_row(self.drones[drone].state(tile)), lane, row);
            }
        }
    }
}

impl<R: BatchScalar> EpisodeStats<R> {
    /// From nothing in the lanes of `mask`.
    #[inline(always)]
    fn begun(&self, mask: R::Mask) -> Self {
        let none = EpisodeStats::none();
        let fresh = |new: R, old: R| R::select(mask, new, old);
        EpisodeStats {
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
