//! A part of the batch: a flock, and what the mission makes of its every tick.

mod flock;
mod judge;
mod start;

use super::mission::{Mission, Verdict};
use super::options::SwarmOptions;
use super::{Rules, SwarmOut};
use crate::config::Autoreset;
use crate::error::Result;
use crate::lanes::LANES;
use crate::model::{Model, VerticalInput};
use crate::rows::{first_bad_action, lanes_of};
use crate::simulated::Batched;
use crate::task::Situation;
use crate::world::GROUP;
use flock::Flock;

/// A contiguous part of the batch, stepped by one thread, whatever its number type.
pub(super) trait Part: Send {
    fn reset(&mut self, rules: &Rules, first: usize, seeds: Option<&[u64]>, mask: Option<&[bool]>, observations: &mut [f32]);
    fn run(&mut self, rules: &Rules, actions: &[f32], out: SwarmOut<'_>);
    fn first_ended(&self) -> Option<usize>;
    fn first_bad_action(&self, actions: &[f32]) -> Option<usize>;
    fn states(&self, rows: &mut [f32]);
    fn loads(&self, rows: &mut [f32]) -> bool;
    fn last_of_episode(&self, world: usize) -> Option<&[f32]>;
}

/// What a shard is made of.
#[derive(Clone, Copy)]
pub(super) struct Whole<'a> {
    pub(super) models: &'a [&'a Model],
    pub(super) inputs: &'a [VerticalInput],
    pub(super) options: &'a SwarmOptions,
    pub(super) worlds: usize,
    pub(super) tick_s: f64,
}

pub(super) struct Shard<R: Batched, M> {
    mission: M,
    /// Everything that is the same for all missions, and compiled once for them all.
    flock: Flock<R>,
}

impl<R: Batched, M: Mission> Shard<R, M> {
    pub(super) fn new(whole: &Whole<'_>, mission: M, drones: usize) -> Result<Self> {
        let flock = Flock::new(whole, mission.load(), mission.board(), drones)?;
        Ok(Shard { mission, flock })
    }

    /// What the mission says at the end of a tick: where everybody was to be, and what that was worth.
    #[inline(always)]
    fn decide(&mut self, tile: usize, place: usize) {
        for drone in 0..self.flock.len() {
            self.set(tile, place, drone);
            let flock = &self.flock;
            let pilot = flock.pilot(tile, drone);
            let scene = flock.scene(tile, place);
            let s = Situation {
                x: flock.state(tile, drone),
                setpoint: flock.desk.setpoints[drone],
                action: &flock.desk.actions[drone][place],
                last_action: &pilot.last_action,
                contact: &flock.desk.contacts[drone],
                t_s: scene.t_s,
            };
            let Verdict { reward, error_m, arrived, done } = self.mission.judge(drone, &s, flock.board(tile), &scene);
            self.flock.desk.verdicts[drone] = Verdict { reward, error_m, arrived, done };
        }
    }

    /// Where a drone is to be now.
    #[inline(always)]
    fn set(&mut self, tile: usize, place: usize, drone: usize) {
        let flock = &self.flock;
        let goal = &flock.pilot(tile, drone).goal;
        let setpoint = self.mission.setpoint(drone, goal, flock.board(tile), &flock.scene(tile, place));
        self.flock.desk.setpoints[drone] = setpoint;
    }

    /// The board moves on.
    #[inline(always)]
    fn turn(&mut self, tile: usize, place: usize) {
        let mut board = std::mem::take(&mut self.flock.desk.turned);
        board.copy_from_slice(self.flock.board(tile));
        self.mission.turn(&mut board, &self.flock.scene(tile, place));
        self.flock.board_mut(tile).copy_from_slice(&board);
        self.flock.desk.turned = board;
    }

    /// Worlds that ended, in this step or before: as the mode says.
    #[cold]
    #[inline(never)]
    fn go_on(&mut self, rules: &Rules, tile: usize, before: u16, out: &mut SwarmOut<'_>) {
        let again = match rules.autoreset {
            Autoreset::Disabled => return,
            Autoreset::NextStep => before,
            Autoreset::SameStep => self.flock.ended(tile),
        };
        if rules.autoreset == Autoreset::SameStep {
            self.flock.keep(tile, again.into(), out.observations);
        }
        self.begin(rules, tile, again.into(), out.observations);
        let n = self.flock.len();
        for lane in lanes_of(again.into()) {
            let world = (tile * LANES + lane) * n;
            out.flying[world..world + n].fill(true);
        }
    }

    /// Begin the next episode in the worlds of `bits` and write their drones' observations.
    fn begin(&mut self, rules: &Rules, tile: usize, bits: u32, observations: &mut [f32]) {
        for lane in lanes_of(bits) {
            let mut rng = self.flock.next_episode(tile, lane);
            let desk = &mut self.flock.desk;
            self.mission.start(&mut rng, &mut desk.starts, &mut desk.begun);
            self.flock.draw(rules, tile, lane);
        }
        self.flock.start(rules, tile, bits);
        R::run(
            #[inline(always)]
            || (0..self.flock.len()).for_each(|drone| self.set(tile, 0, drone)),
        );
        self.flock.show(tile, bits, observations);
    }
}

impl<R: Batched, M: Mission> Part for Shard<R, M> {
    fn reset(&mut self, rules: &Rules, first: usize, seeds: Option<&[u64]>, mask: Option<&[bool]>, observations: &mut [f32]) {
        for tile in 0..self.flock.tiles() {
            let (world, mut bits) = (first + tile * LANES, 0);
            for lane in lanes_of(self.flock.used(tile)).filter(|lane| mask.is_none_or(|m| m[world + lane])) {
                bits |= 1 << lane;
                if let Some(seeds) = seeds {
                    self.flock.seed(tile, lane, seeds[world + lane]);
                }
            }
            self.begin(rules, tile, bits, observations);
        }
    }

    fn run(&mut self, rules: &Rules, actions: &[f32], mut out: SwarmOut<'_>) {
        let tiles = self.flock.tiles();
        for first in (0..tiles).step_by(GROUP) {
            let n = GROUP.min(tiles - first);
            self.flock.advance(rules, first, n, actions);
            for place in 0..n {
                let tile = first + place;
                self.flock.regard(rules, tile, place);
                R::run(
                    #[inline(always)]
                    || self.decide(tile, place),
                );
                let before = self.flock.settle(rules, tile, place, &mut out);
                R::run(
                    #[inline(always)]
                    || self.turn(tile, place),
                );
                if (before | self.flock.ended(tile)) != 0 {
                    self.go_on(rules, tile, before, &mut out);
                }
            }
        }
    }

    fn first_ended(&self) -> Option<usize> {
        let tile = (0..self.flock.tiles()).find(|tile| self.flock.ended(*tile) != 0)?;
        Some(tile * LANES + self.flock.ended(tile).trailing_zeros() as usize)
    }

    fn first_bad_action(&self, actions: &[f32]) -> Option<usize> {
        R::run(
            #[inline(always)]
            || first_bad_action(actions),
        )
    }

    fn states(&self, rows: &mut [f32]) {
        self.flock.states(rows);
    }

    fn loads(&self, rows: &mut [f32]) -> bool {
        self.flock.loads(rows)
    }

    fn last_of_episode(&self, world: usize) -> Option<&[f32]> {
        self.flock.last_of_episode(world)
    }
}
