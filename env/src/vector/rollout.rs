//! Several steps at once. A shard flies all of them while what it touches is in the cache, then the next one
//! does: a batch of any size flies at the rate of a small one. The results are those of single steps, to the
//! bit.

use std::sync::{Mutex, PoisonError};

use ndarray::{ArrayViewMut2, Axis};

use super::buffers::{RolloutBuffers, StepBuffers, cut};
use super::judgement::Fault;
use super::{BatchConfig, SHARD_DRONES, Shard, VectorEnv, measured_width};
use crate::config::Autoreset;
use crate::error::{Error, Result, check_length};
use crate::lanes::LANES;
use crate::observation::ACTION;
use crate::world::GROUP;

/// Flies the environments of one shard, see [`VectorEnv::shard_envs`].
pub trait BatchController: Send {
    /// Actions for rows of [`VectorEnv::measured`].
    ///
    /// # Errors
    /// What the controller refuses.
    fn act(&mut self, measured: &[f32], actions: &mut [f32]) -> Result<()>;

    /// Forgets the flights of the environments that `of` names, counted from the shard's first.
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
    /// `steps` steps of every environment with `actions` that are known beforehand: those of the first step,
    /// then those of the next. To the bit as [`VectorEnv::step`] flies them one after the other; where
    /// automatic resets are disabled, environments whose episode ends stand still until the end, with rewards
    /// and rows of zeros.
    ///
    /// # Errors
    /// As [`VectorEnv::step`], before anything moves. After all steps: [`Error::NotFinite`] for the first value of
    /// a user's own reward or end that is no number.
    pub fn rollout(&mut self, actions: &[f32], steps: usize, out: RolloutBuffers<'_>) -> Result<()> {
        self.check_step(actions, steps, &out.last)?;
        let nobody = &mut vec![(); self.shards.len()];
        self.fly(steps, Pilots { known: actions, flown: &mut [], controllers: nobody }, out)
    }

    /// As [`VectorEnv::rollout`] with the actions of controllers, one for each shard (see
    /// [`VectorEnv::shard_envs`]), which are reset where episodes begin. `out.last.observations` holds those of
    /// the last step or reset. The last actions are written to `actions`.
    ///
    /// # Errors
    /// As [`VectorEnv::step`], before anything moves; [`Error::Shape`] for another number of controllers or of
    /// `actions`; [`Error::NotFinite`] as [`VectorEnv::rollout`]. After what a controller refuses, or an action that is not a number from -1 to 1, the batch must
    /// be reset.
    pub fn rollout_with<C: BatchController>(
        &mut self,
        controllers: &mut [C],
        steps: usize,
        actions: &mut [f32],
        out: RolloutBuffers<'_>,
    ) -> Result<()> {
        self.check_buffers(&out.last)?;
        check_length("controllers", self.shards.len(), controllers.len())?;
        check_length("actions", self.over.len() * ACTION, actions.len())?;
        self.fly(steps, Pilots { known: &[], flown: actions, controllers }, out)
    }

    /// Environments of each shard, in their order.
    pub fn shard_envs(&self) -> impl ExactSizeIterator<Item = usize> {
        let (share, envs) = (self.share, self.envs);
        (0..self.shards.len()).map(move |i| share.min(envs - i * share))
    }

    fn fly<C: BatchController>(
        &mut self,
        steps: usize,
        mut pilots: Pilots<'_, C>,
        out: RolloutBuffers<'_>,
    ) -> Result<()> {
        let drones = self.num_drones();
        let (rows, share, per_thread) = (self.over.len(), self.share, self.per_thread);
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
        let parts = self.shards.chunks_mut(per_thread).enumerate().map(|(i, shards)| {
            let (count, envs) = (shards.len(), shards.len() * share);
            (i * per_thread, shards, rest.cut(envs, size), pilots.cut(count, envs * drones))
        });
        self.team.each(parts, |(first, shards, mut part, mut pilots)| {
            for (i, shard) in shards.iter_mut().enumerate() {
                let flight = ShardFlight {
                    shard: shard.as_mut(),
                    first_row: (first + i) * share * drones,
                    rows: part.cut(share, size),
                    pilots: pilots.cut(1, share * drones),
                };
                let first_env = (first + i) * share;
                let (refusal, fault) = match flight.fly(config, steps, size) {
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
    /// Of a step.
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

/// Where the actions come from.
struct Pilots<'a, C> {
    /// Those of all steps and environments, where they are known.
    known: &'a [f32],
    /// Those of the controllers, for one step.
    flown: &'a mut [f32],
    controllers: &'a mut [C],
}

impl<'a, C> Pilots<'a, C> {
    /// Takes those of the first shards away.
    fn cut(&mut self, shards: usize, rows: usize) -> Pilots<'a, C> {
        Pilots {
            known: self.known,
            flown: cut(&mut self.flown, rows * ACTION),
            controllers: cut(&mut self.controllers, shards),
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

/// Some columns of a table with a row for each step; none where it is not asked for.
type Columns<'a, T> = ArrayViewMut2<'a, T>;

/// What is kept of every step.
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

    fn keep(&mut self, step: usize, last: &StepBuffers<'_>) {
        write(&mut self.observations, step, last.observations);
        write(&mut self.rewards, step, last.rewards);
        write(&mut self.terminated, step, last.terminated);
        write(&mut self.truncated, step, last.truncated);
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

fn write<T: Copy>(table: &mut Columns<'_, T>, step: usize, row: &[T]) {
    if table.ncols() > 0
        && let Some(slots) = table.row_mut(step).as_slice_mut()
    {
        slots.copy_from_slice(row);
    }
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
    /// Flies all steps; returns the first value that is no number, counted from the shard's first environment.
    fn fly(
        mut self,
        config: &BatchConfig,
        steps: usize,
        size: RowSize,
    ) -> std::result::Result<Option<TimedFault>, Refusal> {
        let mut first_fault = None;
        for step in 0..steps {
            self.ask()?;
            let ended = self.ended();
            let Part { last, measured, history, returns, .. } = &mut self.rows;
            let actions = if self.pilots.flown.is_empty() {
                let first = (step * size.rows + self.first_row) * ACTION;
                &self.pilots.known[first..first + returns.len() * ACTION]
            } else {
                &*self.pilots.flown
            };
            self.shard.run(config, actions, measured, last.reborrow());
            history.keep(step, last);
            let fault = self.shard.take_fault();
            first_fault = first_fault.or(fault.map(|fault| (step, fault)));
            self.add_up();
            self.begin(config, &ended, size);
        }
        Ok(first_fault)
    }

    /// The controller's next actions.
    fn ask(&mut self) -> std::result::Result<(), Refusal> {
        let Pilots { flown, controllers, .. } = &mut self.pilots;
        if flown.is_empty() {
            return Ok(());
        }
        let Part { measured, last, .. } = &self.rows;
        let seen = if measured.is_empty() { &*last.observations } else { &**measured };
        for controller in controllers.iter_mut() {
            controller.act(seen, flown).map_err(Refusal::Controller)?;
        }
        self.shard.first_bad_action(flown).map_or(Ok(()), |at| {
            Err(Refusal::Action { row: self.first_row + at / ACTION, axis: at % ACTION, value: flown[at] })
        })
    }

    fn ended(&self) -> [u16; MOST_TILES] {
        let mut ended = [0; MOST_TILES];
        ended
            .iter_mut()
            .take(self.shard.tiles())
            .enumerate()
            .for_each(|(i, bits)| *bits = self.shard.ended(i));
        ended
    }

    fn add_up(&mut self) {
        let Part { last, returns, over, .. } = &mut self.rows;
        let flags = last.terminated.iter().zip(&*last.truncated);
        for (((sum, over), reward), (terminated, truncated)) in
            returns.iter_mut().zip(over.iter_mut()).zip(&*last.rewards).zip(flags)
        {
            *sum += if *over { 0.0 } else { *reward };
            *over |= terminated | truncated;
        }
    }

    /// Tells the controller which episodes have begun in the step; `ended` are those that had ended before.
    fn begin(&mut self, config: &BatchConfig, ended: &[u16; MOST_TILES], size: RowSize) {
        let (StepBuffers { terminated, truncated, flying, .. }, drones) = (&self.rows.last, size.drones);
        let ends = |env: usize| {
            let rows = env * drones..(env + 1) * drones;
            rows.clone().any(|row| terminated[row] | truncated[row])
                && flying.get(rows).is_none_or(|flying| flying.iter().all(|flies| *flies))
        };
        let was_over = |env: usize| ended[env / LANES] >> (env % LANES) & 1 == 1;
        for controller in self.pilots.controllers.iter_mut() {
            match config.autoreset {
                Autoreset::Disabled => {}
                Autoreset::NextStep => controller.reset(&was_over),
                Autoreset::SameStep => controller.reset(&ends),
            }
        }
    }
}

/// Tiles of a shard at most.
const MOST_TILES: usize = SHARD_DRONES / LANES + GROUP;
