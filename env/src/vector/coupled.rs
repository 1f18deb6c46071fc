//! A part of the batch whose environments have several drones, and what the task makes of their every tick.

mod drone_batch;
mod judge;
mod start;

use std::ops::Range;

use super::buffers::StepBuffers;
use super::judgement::Fault;
use super::{BatchConfig, Shard, ShardSpec};
use crate::archive::Archive;
use crate::config::Autoreset;
use crate::error::Result;
use crate::lanes::LANES;
use crate::rows::{first_bad_action, lanes_of};
use crate::sim_scalar::BatchScalar;
use crate::task::{Outline, Situation, Task};
use crate::world::GROUP;
use drone_batch::DroneBatch;

pub(super) struct CoupledShard<R: BatchScalar, T> {
    task: T,
    /// Everything that is the same for all tasks, and compiled once for them all.
    batch: DroneBatch<R>,
}

impl<R: BatchScalar, T: Task> CoupledShard<R, T> {
    pub(super) fn new(spec: &ShardSpec<'_>, task: T, drones: usize) -> Result<Self> {
        let batch = DroneBatch::new(spec, task.load(), task.board(), drones)?;
        Ok(CoupledShard { task, batch })
    }

    /// What the task says at the end of a tick: where everybody was to be, and what that was worth.
    #[inline(always)]
    fn decide(&mut self, tile: usize, place: usize) {
        for drone in 0..self.batch.len() {
            self.place(tile, place, drone);
            let batch = &self.batch;
            let scene = batch.scene(tile, place);
            let s = Situation {
                x: batch.state(tile, drone),
                setpoint: batch.scratch.setpoints[drone],
                goal: &batch.slot(tile, drone).goal,
                action: &batch.scratch.actions[drone][place],
                last_action: &batch.slot(tile, drone).last_action,
                contact: &batch.scratch.contacts[drone],
            };
            let outcome = self.task.judge(drone, &s, batch.board(tile), &scene);
            self.batch.scratch.outcomes[drone] = outcome;
        }
    }

    /// Where a drone is to be now.
    #[inline(always)]
    fn place(&mut self, tile: usize, place: usize, drone: usize) {
        let (goal, board, scene) = self.batch.goal(tile, place, drone);
        let setpoint = self.task.setpoint(drone, goal, board, &scene);
        self.batch.scratch.setpoints[drone] = setpoint;
    }

    /// As [`Self::place`] where episodes begin, in the lanes of `mask`: the goals of those under way stay.
    #[inline(always)]
    fn place_begun(&mut self, tile: usize, drone: usize, mask: R::Mask) {
        let before = self.batch.slot(tile, drone).goal;
        self.place(tile, 0, drone);
        for (new, old) in self.batch.slot_mut(tile, drone).goal.iter_mut().zip(before) {
            *new = R::select(mask, *new, old);
        }
    }

    /// The board moves on.
    #[inline(always)]
    fn turn(&mut self, tile: usize, place: usize) {
        let mut board = std::mem::take(&mut self.batch.scratch.turned);
        board.copy_from_slice(self.batch.board(tile));
        self.task.turn(&mut board, &self.batch.scene(tile, place));
        self.batch.board_mut(tile).copy_from_slice(&board);
        self.batch.scratch.turned = board;
    }

    /// Environments that ended, in this step or before: as the mode says.
    #[cold]
    #[inline(never)]
    fn autoreset(
        &mut self,
        config: &BatchConfig,
        tile: usize,
        before: u16,
        measured: &mut [f32],
        out: &mut StepBuffers<'_>,
    ) {
        let again = match config.autoreset {
            Autoreset::Disabled => return,
            Autoreset::NextStep => before,
            Autoreset::SameStep => self.batch.ended(tile),
        };
        if config.autoreset == Autoreset::SameStep {
            self.batch.keep(tile, again.into(), out.observations);
        }
        self.begin(config, tile, again.into(), measured, out.observations);
        let n = self.batch.len();
        for lane in lanes_of(again.into()) {
            let env = (tile * LANES + lane) * n;
            out.flying[env..env + n].fill(true);
        }
    }

    /// Begin the next episode in the environments of `bits` and write their drones' observations.
    fn begin(
        &mut self,
        config: &BatchConfig,
        tile: usize,
        bits: u32,
        measured: &mut [f32],
        observations: &mut [f32],
    ) {
        for lane in lanes_of(bits) {
            let mut rng = self.batch.next_episode(tile, lane);
            let scratch = &mut self.batch.scratch;
            self.task.start(&mut rng, &mut scratch.starts, &mut scratch.begun);
            self.batch.draw(config, tile, lane);
        }
        self.batch.start(config, tile, bits);
        R::run(
            #[inline(always)]
            || {
                for drone in 0..self.batch.len() {
                    self.place_begun(tile, drone, R::mask(bits));
                }
            },
        );
        self.batch.show(tile, bits, measured, observations);
    }
}

impl<R: BatchScalar, T: Task> Shard for CoupledShard<R, T> {
    fn reset(
        &mut self,
        config: &BatchConfig,
        first: usize,
        seeds: Option<&[u64]>,
        mask: Option<&[bool]>,
        measured: &mut [f32],
        observations: &mut [f32],
    ) {
        for tile in 0..self.batch.tiles() {
            let (env, mut bits) = (first + tile * LANES, 0);
            for lane in lanes_of(self.batch.used(tile)).filter(|lane| mask.is_none_or(|m| m[env + lane])) {
                bits |= 1 << lane;
                if let Some(seeds) = seeds {
                    self.batch.seed(tile, lane, seeds[env + lane]);
                }
            }
            self.begin(config, tile, bits, measured, observations);
        }
    }

    fn run<'a>(
        &mut self,
        config: &BatchConfig,
        tiles: Range<usize>,
        actions: &[f32],
        measured: &'a mut [f32],
        mut out: StepBuffers<'a>,
    ) {
        for first in tiles.clone().step_by(GROUP) {
            let n = GROUP.min(tiles.end - first);
            self.batch.advance(config, first, n, actions);
            for place in 0..n {
                let tile = first + place;
                self.batch.regard(config, tile, place);
                R::run(
                    #[inline(always)]
                    || self.decide(tile, place),
                );
                let before = self.batch.write_step(config, tile, place, measured, &mut out);
                R::run(
                    #[inline(always)]
                    || self.turn(tile, place),
                );
                if (before | self.batch.ended(tile)) != 0 {
                    self.autoreset(config, tile, before, measured, &mut out);
                }
            }
        }
    }

    fn tiles(&self) -> usize {
        self.batch.tiles()
    }

    fn ended(&self, tile: usize) -> u16 {
        self.batch.ended(tile)
    }

    fn first_bad_action(&self, actions: &[f32]) -> Option<usize> {
        R::run(
            #[inline(always)]
            || first_bad_action(actions),
        )
    }

    fn states(&self, rows: &mut [f32]) {
        self.batch.states(rows);
    }

    fn outlines(&self, _: usize) -> Vec<Outline> {
        Vec::new()
    }

    fn loads(&self, rows: &mut [f32]) -> bool {
        self.batch.loads(rows)
    }

    fn end(&mut self, drones: &[bool]) {
        self.batch.end_flights(drones);
    }

    fn watched(&self) -> &[f32] {
        self.batch.watched()
    }

    fn take_fault(&mut self) -> Option<Fault> {
        self.batch.take_fault()
    }

    fn archive(&mut self, tile: usize, archive: &mut Archive<'_>) {
        self.batch.archive(tile, archive);
    }

    fn set_force(&mut self, force_n: Option<&[f32]>) {
        self.batch.set_force(force_n);
    }

    fn last_of_episode(&self, env: usize) -> Option<(&[f32], &[f32])> {
        self.batch.last_of_episode(env)
    }
}
