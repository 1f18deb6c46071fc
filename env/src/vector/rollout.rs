//! Several steps at once. A block flies all of them while what it touches is in the cache, then the next one
//! does: a batch of any size flies at the rate of a small one. The results are those of single steps, to the
//! bit.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use ndarray::{ArrayViewMut2, Axis};

use super::buffers::{RolloutBuffers, StepBuffers, cut};
use super::judgement::Fault;
use super::{BLOCK_DRONES, BatchConfig, Shard, VectorEnv, measured_width};
use crate::action::ACTION;
use crate::config::Autoreset;
use crate::error::{Error, Result, check_length};
use crate::lanes::LANES;
use crate::world::GROUP;

/// Flies the environments of one block, see [`VectorEnv::shard_envs`].
pub trait BatchController: Send {
    /// Actions for rows of [`VectorEnv::measured`].
    ///
    /// # Errors
    /// The errors of the controller.
    fn act(&mut self, measured: &[f32], actions: &mut [f32]) -> Result<()>;

    /// Forgets the flights of the environments that `of` names, counted from the block's first.
    fn reset(&mut self, of: &dyn Fn(usize) -> bool);
}

/// Nobody, where actions are known beforehand.
impl BatchController for () {
    fn act(&mut self, _: &[f32], _: &mut [f32]) -> Result<()> {
        Ok(())
    }
    fn reset(&mut self, _: &dyn Fn(usize) -> bool) {}
}

impl VectorEnv {
    /// `steps` steps of every environment with `actions` that are known beforehand: those of the first step, then
    /// those of the next. To the bit as [`VectorEnv::step`] flies them one after the other; without automatic resets,
    /// environments whose episode ends stop until the end, with rewards and rows of zeros.
    ///
    /// # Errors
    /// The errors of [`VectorEnv::step`], before anything moves. After all steps: [`Error::NotFinite`] for the first
    /// value of a user's own reward or end that is no number.
    pub fn rollout(&mut self, actions: &[f32], steps: usize, out: RolloutBuffers<'_>) -> Result<()> {
        self.check_step(actions, steps, &out.last)?;
        let nobody = &mut vec![(); self.shard_envs().len()];
        self.fly(steps, Pilots { known: actions, flown: &mut [], controllers: nobody }, out)
    }

    /// Flies like [`VectorEnv::rollout`] with the actions of controllers, one for each block (see
    /// [`VectorEnv::shard_envs`]), which are reset at the beginning of episodes. `out.last.observations` has those of
    /// the last step or reset. The last actions are written to `actions`.
    ///
    /// # Errors
    /// The errors of [`VectorEnv::step`], before anything moves; [`Error::Shape`] for another number of controllers
    /// or of `actions`; [`Error::NotFinite`] like [`VectorEnv::rollout`]. After an error of a controller, or an
    /// action that is not a number from -1 to 1, the batch must be reset.
    pub fn rollout_with<C: BatchController>(
        &mut self,
        controllers: &mut [C],
        steps: usize,
        actions: &mut [f32],
        out: RolloutBuffers<'_>,
    ) -> Result<()> {
        self.check_buffers(&out.last)?;
        check_length("controllers", self.shard_envs().len(), controllers.len())?;
        check_length("actions", self.over.len() * ACTION, actions.len())?;
        self.fly(steps, Pilots { known: &[], flown: actions, controllers }, out)
    }

    /// Environments of each block, in their order: of what one thread flies in a rollout before it goes on.
    pub fn shard_envs(&self) -> impl ExactSizeIterator<Item = usize> + use<> {
        let (block, envs) = (self.block, self.envs);
        (0..envs.div_ceil(block)).map(move |i| block.min(envs - i * block))
    }

    fn fly<C: BatchController>(
        &mut self,
        steps: usize,
        mut pilots: Pilots<'_, C>,
        out: RolloutBuffers<'_>,
    ) -> Result<()> {
        let drones = self.num_drones();
        let (rows, share, block) = (self.over.len(), self.share, self.block);
        check_length("returns", rows, out.returns.len())?;
        let size = RowSize { drones, width: self.width, metrics: self.metrics, rows };
        self.over.fill(false);
        let mut rest = Part {
            history: History::new(
                steps,
                rows,
                self.width,
                &mut *out.observations,
                out.rewards,
                [out.terminated, out.truncated],
            )?,
            last: out.last,
            returns: out.returns,
            over: &mut self.over,
            measured: &mut self.measured,
        };
        rest.returns.fill(0.0);
        let (config, results) = (&self.config, Mutex::new((None, None)));
        let parts = self.shards.iter_mut().enumerate().map(|(i, shard)| ShardFlight {
            shard: shard.as_mut(),
            first_row: i * share * drones,
            rows: rest.cut(share, size),
            pilots: pilots.cut(share / block, share * drones),
        });
        self.team.each(parts, |mut flight| {
            let first_env = flight.first_row / drones;
            for block in flight.blocks(block / LANES, drones) {
                let (refusal, fault) = match flight.fly(config, &block, steps, size) {
                    Ok(fault) => (None, fault.map(|(step, fault)| (step, fault.shifted(first_env)))),
                    Err(refusal) => (Some(refusal), None),
                };
                if refusal.is_some() || fault.is_some() {
                    let mut results = results.lock().unwrap_or_else(PoisonError::into_inner);
                    results.0 = results.0.take().or(refusal);
                    results.1 = earlier(results.1.take(), fault);
                }
            }
        });
        let (refusal, fault) = results.into_inner().unwrap_or_else(PoisonError::into_inner);
        match refusal {
            None => fault.map_or(Ok(()), |(_, fault)| Err(self.not_finite(fault))),
            Some(refusal) => {
                self.ready = false;
                Err(match refusal {
                    Refusal::Action { row, axis, value } => self.bad_action(row, axis, value),
                    Refusal::Controller(error) => error,
                })
            }
        }
    }
}

/// Numbers of rows.
#[derive(Clone, Copy)]
struct RowSize {
    drones: usize,
    width: usize,
    metrics: usize,
    /// Rows of a step.
    rows: usize,
}

/// Why a flight with a controller was given up.
enum Refusal {
    Action { row: usize, axis: usize, value: f32 },
    Controller(Error),
}

/// A value that is no number, with the step of the rollout.
type TimedFault = (usize, Fault);

/// The one that single steps would have met first, whatever the shards.
fn earlier(one: Option<TimedFault>, other: Option<TimedFault>) -> Option<TimedFault> {
    let place = |(step, fault): &TimedFault| (*step, fault.env, fault.drone);
    one.into_iter().chain(other).min_by_key(place)
}

/// Source of the actions.
struct Pilots<'a, C> {
    /// Those of all steps and environments, where they are known.
    known: &'a [f32],
    /// Those of the controllers, for one step.
    flown: &'a mut [f32],
    controllers: &'a mut [C],
}

impl<'a, C> Pilots<'a, C> {
    /// Takes those of the first blocks away.
    fn cut(&mut self, blocks: usize, rows: usize) -> Pilots<'a, C> {
        Pilots {
            known: self.known,
            flown: cut(&mut self.flown, rows * ACTION),
            controllers: cut(&mut self.controllers, blocks),
        }
    }
}

/// The results of some environments.
struct Part<'a> {
    last: StepBuffers<'a>,
    returns: &'a mut [f32],
    over: &'a mut [bool],
    measured: &'a mut [f32],
    history: History<'a>,
}

impl<'a> Part<'a> {
    /// Takes those of the first environments away, or of all that are left.
    fn cut(&mut self, envs: usize, size: RowSize) -> Part<'a> {
        let rows = envs * size.drones;
        Part {
            last: self.last.split(envs, size.drones, size.width, size.metrics),
            returns: cut(&mut self.returns, rows),
            over: cut(&mut self.over, rows),
            measured: cut(&mut self.measured, rows * measured_width(size.drones)),
            history: self.history.cut(rows, size.width),
        }
    }
}

/// Some columns of a table with a row for each step; none if they are not requested.
type Columns<'a, T> = ArrayViewMut2<'a, T>;

/// Values kept of every step.
struct History<'a> {
    observations: Columns<'a, f32>,
    rewards: Columns<'a, f32>,
    terminated: Columns<'a, bool>,
    truncated: Columns<'a, bool>,
}

impl<'a> History<'a> {
    fn new(
        steps: usize,
        rows: usize,
        width: usize,
        observations: &'a mut [f32],
        rewards: &'a mut [f32],
        [terminated, truncated]: [&'a mut [bool]; 2],
    ) -> Result<Self> {
        Ok(History {
            observations: table("observations", steps, rows * width, observations)?,
            rewards: table("rewards", steps, rows, rewards)?,
            terminated: table("terminated", steps, rows, terminated)?,
            truncated: table("truncated", steps, rows, truncated)?,
        })
    }

    fn cut(&mut self, rows: usize, width: usize) -> History<'a> {
        History {
            observations: cut_columns(&mut self.observations, rows * width),
            rewards: cut_columns(&mut self.rewards, rows),
            terminated: cut_columns(&mut self.terminated, rows),
            truncated: cut_columns(&mut self.truncated, rows),
        }
    }

    fn keep(&mut self, step: usize, rows: &Range<usize>, last: &StepBuffers<'_>, width: usize) {
        write(&mut self.observations, step, rows.start * width..rows.end * width, last.observations);
        write(&mut self.rewards, step, rows.clone(), last.rewards);
        write(&mut self.terminated, step, rows.clone(), last.terminated);
        write(&mut self.truncated, step, rows.clone(), last.truncated);
    }
}

fn table<'a, T>(what: &'static str, steps: usize, width: usize, all: &'a mut [T]) -> Result<Columns<'a, T>> {
    let width = if all.is_empty() { 0 } else { width };
    check_length(what, steps * width, all.len())?;
    ArrayViewMut2::from_shape((steps, width), all).map_err(|e| Error::Config(format!("{what}: {e}")))
}

/// Takes the first columns away, or all that are left.
fn cut_columns<'a, T>(table: &mut Columns<'a, T>, count: usize) -> Columns<'a, T> {
    let none = ArrayViewMut2::from(&mut [] as &mut [[T; 0]]);
    let whole = std::mem::replace(table, none);
    let count = count.min(whole.ncols());
    let (first, rest) = whole.split_at(Axis(1), count);
    *table = rest;
    first
}

/// Writes some places of a step's row.
fn write<T: Copy>(table: &mut Columns<'_, T>, step: usize, places: Range<usize>, row: &[T]) {
    if table.ncols() > 0
        && let Some(slots) = table.row_mut(step).as_slice_mut()
    {
        slots[places.clone()].copy_from_slice(&row[places]);
    }
}

/// A part of a shard that stays in the cache, with its place among the shard's blocks.
struct Block {
    place: usize,
    tiles: Range<usize>,
    /// Rows of its drones among the shard's.
    rows: Range<usize>,
}

/// A shard on its way through all steps.
struct ShardFlight<'a, C> {
    shard: &'a mut dyn Shard,
    /// Place of its first drone among all.
    first_row: usize,
    rows: Part<'a>,
    pilots: Pilots<'a, C>,
}

impl<C: BatchController> ShardFlight<'_, C> {
    fn blocks(&self, tiles: usize, drones: usize) -> impl Iterator<Item = Block> + use<C> {
        let (all, rows) = (self.shard.tiles(), self.rows.returns.len());
        (0..all.div_ceil(tiles)).map(move |place| {
            let tiles = place * tiles..((place + 1) * tiles).min(all);
            let first = tiles.start * LANES * drones;
            Block { place, rows: first..(tiles.end * LANES * drones).min(rows), tiles }
        })
    }

    /// Flies all steps of a block; returns the first value that is no number, counted from the shard's first
    /// environment.
    fn fly(
        &mut self,
        config: &BatchConfig,
        block: &Block,
        steps: usize,
        size: RowSize,
    ) -> std::result::Result<Option<TimedFault>, Refusal> {
        let mut first_fault = None;
        for step in 0..steps {
            self.ask(block, size)?;
            let ended = self.ended(block);
            let Part { last, measured, history, returns, .. } = &mut self.rows;
            let actions = if self.pilots.flown.is_empty() {
                let first = (step * size.rows + self.first_row) * ACTION;
                &self.pilots.known[first..first + returns.len() * ACTION]
            } else {
                &*self.pilots.flown
            };
            self.shard.run(config, block.tiles.clone(), actions, measured, last.reborrow());
            history.keep(step, &block.rows, last, size.width);
            let fault = self.shard.take_fault();
            first_fault = first_fault.or(fault.map(|fault| (step, fault)));
            self.add_up(block);
            self.begin(config, block, &ended, size);
        }
        Ok(first_fault)
    }

    /// The controller's next actions.
    fn ask(&mut self, block: &Block, size: RowSize) -> std::result::Result<(), Refusal> {
        let Pilots { flown, controllers, .. } = &mut self.pilots;
        if flown.is_empty() {
            return Ok(());
        }
        let Part { measured, last, .. } = &self.rows;
        let seen = if measured.is_empty() { &*last.observations } else { &**measured };
        let (Range { start, end }, wide) = (block.rows.clone(), measured_width(size.drones));
        let flown = &mut flown[start * ACTION..end * ACTION];
        controllers[block.place].act(&seen[start * wide..end * wide], flown).map_err(Refusal::Controller)?;
        self.shard.first_bad_action(flown).map_or(Ok(()), |at| {
            let row = self.first_row + start + at / ACTION;
            Err(Refusal::Action { row, axis: at % ACTION, value: flown[at] })
        })
    }

    fn ended(&self, block: &Block) -> [u16; MOST_TILES] {
        let mut ended = [0; MOST_TILES];
        for (bits, tile) in ended.iter_mut().zip(block.tiles.clone()) {
            *bits = self.shard.ended(tile);
        }
        ended
    }

    fn add_up(&mut self, block: &Block) {
        let Part { last, returns, over, .. } = &mut self.rows;
        let rows = || block.rows.clone();
        let flags = last.terminated[rows()].iter().zip(&last.truncated[rows()]);
        for (((sum, over), reward), (terminated, truncated)) in
            returns[rows()].iter_mut().zip(&mut over[rows()]).zip(&last.rewards[rows()]).zip(flags)
        {
            *sum += if *over { 0.0 } else { *reward };
            *over |= terminated | truncated;
        }
    }

    /// Notifies the controller of the episodes that have begun in the step; `ended` are those that had ended before.
    fn begin(&mut self, config: &BatchConfig, block: &Block, ended: &[u16; MOST_TILES], size: RowSize) {
        let (StepBuffers { terminated, truncated, flying, .. }, drones) = (&self.rows.last, size.drones);
        let ends = |env: usize| {
            let first = block.rows.start + env * drones;
            let rows = first..first + drones;
            rows.clone().any(|row| terminated[row] | truncated[row])
                && flying.get(rows).is_none_or(|flying| flying.iter().all(|flies| *flies))
        };
        let was_over = |env: usize| ended[env / LANES] >> (env % LANES) & 1 == 1;
        let controller = &mut self.pilots.controllers[block.place];
        match config.autoreset {
            Autoreset::Disabled => {}
            Autoreset::NextStep => controller.reset(&was_over),
            Autoreset::SameStep => controller.reset(&ends),
        }
    }
}

/// Tiles of a block at most.
const MOST_TILES: usize = BLOCK_DRONES / LANES + GROUP;
