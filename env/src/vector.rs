//! A batch of environments, each a world of one drone or of several that share the air: caller-owned buffers
//! in and out, automatic resets, nothing allocated per step.
//!
//! Environment `i` is the same whatever the size of the batch: an episode is a function of its seed, its
//! number and its actions. A tile is sixteen environments. Rows of numbers are environment by environment,
//! and within one drone by drone.

mod buffers;
mod judgement;
mod measured_observer;
mod observer;
mod rollout;
mod row_sink;
mod shard;
mod snapshot;

use std::marker::PhantomData;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::action::{ACTION, Interface};
use crate::archive::Archive;
use crate::config::{Autoreset, Options};
use crate::coupling::NEIGHBOUR;
use crate::episode::{Alone, FlightPlan, SharedAir};
use crate::error::{Error, Result, check_length, check_range, out_of_range};
use crate::isa::{Kind, Level};
use crate::lanes::{LANES, Lanes};
use crate::model::{Model, Schedule};
use crate::observation::OBSERVATION;
use crate::pool::WorkerPool;
use crate::sim_scalar::BatchScalar;
use crate::task::{self, Outline, Task, Visitor};
use crate::world::{GROUP, check_scope};

use buffers::AlignedNumbers;
use judgement::Fault;
use shard::EpisodeShard;
use snapshot::checksum;

pub use crate::rows::{STATE, state_index};
pub use buffers::{RolloutBuffers, StepBuffers};
pub use measured_observer::MeasuredObserver;
pub use observer::observation_width;
pub use rollout::BatchController;

/// Metrics of the episode so far in an environment of several drones, in this order.
pub const METRICS: [(&str, &str, &str); 6] = [
    ("collisions", "1", "drones that hit another"),
    ("crashes", "1", "drones that hit the floor or left the room"),
    ("min_separation_m", "m", "smallest distance between two drones that flew"),
    ("settled_s", "s", "last time at which one that flew was not where it should be in the end"),
    ("rms_error_m", "m", "root mean square distance from where they should be"),
    ("done", "1", "drones whose part is done, or that are where they should be"),
];

/// Configuration shared by all shards.
#[derive(Debug, Clone)]
pub(crate) struct BatchConfig {
    /// Command interfaces of the actions, for each drone.
    pub(crate) interfaces: Vec<Interface>,
    pub(crate) autoreset: Autoreset,
}

/// A batch of environments.
pub struct VectorEnv {
    shards: Vec<Box<dyn Shard>>,
    config: BatchConfig,
    envs: usize,
    /// Numbers in a drone's observation.
    width: usize,
    /// Measurements, if observations contain something else.
    measured: AlignedNumbers,
    /// Numbers of each drone in [`VectorEnv::watched`].
    watched: usize,
    /// Rewards and ends that are not the task's, as they were written.
    texts: [(&'static str, Option<String>); 3],
    /// Numbers per environment in [`StepBuffers::metrics`].
    metrics: usize,
    /// Environments per shard but the last.
    share: usize,
    /// Environments of a block but the last, see [`VectorEnv::shard_envs`].
    block: usize,
    /// Mask of the drones whose flight has ended in a rollout.
    over: Vec<bool>,
    team: WorkerPool,
    ready: bool,
    level: Level,
    tick_s: f64,
    /// Hash of everything that decides a flight besides seeds and actions.
    fingerprint: u64,
}

/// Drones of a block at most, unless two tiles have more: what a step of them touches stays in the cache of a
/// core until the next one.
const BLOCK_DRONES: usize = 512;

/// A contiguous part of the batch with worlds of its own, stepped by one thread, whatever its number type and
/// its task.
trait Shard: Send {
    fn reset(
        &mut self,
        first: usize,
        seeds: Option<&[u64]>,
        mask: Option<&[bool]>,
        measured: &mut [f32],
        observations: &mut [f32],
    );
    /// Steps the environments of some tiles; the buffers are those of the whole shard. `measured` is empty where
    /// the observations are what is measured.
    fn run<'a>(
        &mut self,
        config: &BatchConfig,
        tiles: Range<usize>,
        actions: &[f32],
        measured: &'a mut [f32],
        out: StepBuffers<'a>,
    );
    fn tiles(&self) -> usize;
    /// A bit for each environment of a tile whose episode has ended.
    fn ended(&self, tile: usize) -> u16;
    fn first_ended(&self) -> Option<usize> {
        let tile = (0..self.tiles()).find(|tile| self.ended(*tile) != 0)?;
        Some(tile * LANES + self.ended(tile).trailing_zeros() as usize)
    }
    fn first_bad_action(&self, actions: &[f32]) -> Option<usize>;
    fn states(&self, rows: &mut [f32]);
    /// Returns the objects around an environment of this shard.
    fn outlines(&self, env: usize) -> Vec<Outline>;
    fn last_of_episode(&self, env: usize) -> Option<(&[f32], &[f32])>;
    fn loads(&self, rows: &mut [f32]) -> bool;
    /// Ends flights, a flag for each drone.
    fn end(&mut self, drones: &[bool]);
    /// Returns the requested numbers of the last step, a row for each drone.
    fn watched(&self) -> &[f32];
    /// The first number of the last step that is none, with its environment counted from the shard's first.
    fn take_fault(&mut self) -> Option<Fault>;
    fn archive(&mut self, tile: usize, archive: &mut Archive<'_>);
    /// Rows of three for each drone, or none.
    fn set_force(&mut self, force_n: Option<&[f32]>);
}

/// Specification of a shard.
#[derive(Clone, Copy)]
struct ShardSpec<'a> {
    plan: FlightPlan<'a>,
    envs: usize,
}

impl ShardSpec<'_> {
    fn shard<R: BatchScalar>(self) -> Result<Box<dyn Shard>> {
        let Options { task, drones, task_options, .. } = self.plan.options;
        task::visit(task, *drones, task_options, ShardBuilder::<R> { spec: self, number: PhantomData })
    }
}

struct ShardBuilder<'a, R> {
    spec: ShardSpec<'a>,
    number: PhantomData<R>,
}

impl<R: BatchScalar> Visitor for ShardBuilder<'_, R> {
    type Output = Box<dyn Shard>;
    fn visit<T: Task>(self, task: T, _: usize) -> Result<Box<dyn Shard>> {
        if const { T::DRONES == 1 } {
            Ok(Box::new(EpisodeShard::<R, T, Alone>::new(&self.spec, task)?))
        } else {
            Ok(Box::new(EpisodeShard::<R, T, SharedAir<R>>::new(&self.spec, task)?))
        }
    }
}

impl VectorEnv {
    /// A batch of `envs` environments; one model for all drones of an environment, or one for each. Call
    /// [`VectorEnv::reset`] before the first step.
    ///
    /// # Errors
    /// [`Error::Range`] for no environments, too many drones, or rigs whose ticks differ; [`Error::Unknown`],
    /// [`Error::Range`] or [`Error::Config`] for errors in `options`.
    pub fn new(models: &[Model], options: &Options, envs: usize) -> Result<Self> {
        if envs == 0 {
            return Err(out_of_range("num_envs", 0.0, "at least 1"));
        }
        let entry = task::find(&options.task)?;
        let drones = entry.drones(options.drones)?;
        options.check_drones(drones, models.len())?;
        let models: Vec<&Model> = (0..drones).map(|j| models.get(j).unwrap_or(&models[0])).collect();
        let interfaces = checked_interfaces(&models, options)?;
        let tick_s = common_tick_s(&models)?;
        options.neighbours.check(tick_s)?;
        let level = Level::named(options.isa.as_deref())?;
        let (block, blocks) = blocks(envs.div_ceil(LANES), drones, options.threads);
        let share = block * blocks;
        let shards = (0..envs)
            .step_by(share)
            .map(|first| {
                let envs = share.min(envs - first);
                let tiles = envs.div_ceil(LANES);
                let plan = FlightPlan { models: &models, interfaces: &interfaces, options, tick_s, tiles };
                let spec = ShardSpec { plan, envs };
                match level.kind() {
                    Kind::Baseline => spec.shard::<Lanes>(),
                    #[cfg(target_arch = "x86_64")]
                    Kind::Avx2 => spec.shard::<crate::lanes_avx2::Lanes>(),
                    #[cfg(target_arch = "x86_64")]
                    Kind::Avx512 => spec.shard::<crate::lanes_avx512::Lanes>(),
                }
            })
            .collect::<Result<Vec<_>>>()?;
        let config = BatchConfig { interfaces, autoreset: options.autoreset };
        let team = WorkerPool::new(shards.len() - 1)?;
        let metrics = if entry.drones == 1 { 0 } else { METRICS.len() };
        let fingerprint = fingerprint(&models, options, drones)?;
        let width = observer::row_width(options, drones)?;
        let kept = if options.observes() { envs * drones * measured_width(drones) } else { 0 };
        Ok(VectorEnv {
            shards,
            config,
            envs,
            width,
            measured: AlignedNumbers::zeros(kept),
            watched: judgement::watched_width(options)?,
            texts: [
                (judgement::REWARD, options.reward.clone()),
                (judgement::TERMINATION, options.termination.clone()),
                (judgement::COST, options.cost.clone()),
            ],
            metrics,
            share,
            block,
            over: vec![false; envs * drones],
            team,
            ready: false,
            level,
            tick_s,
            fingerprint,
        })
    }

    /// Returns the size of the batch: environments, not drones.
    pub fn num_envs(&self) -> usize {
        self.envs
    }

    /// Drones in each environment.
    pub fn num_drones(&self) -> usize {
        self.config.interfaces.len()
    }

    /// Returns the numbers in a drone's observation. Each tick has its own, [`OBSERVATION`] unless the options choose
    /// other fields, then [`NEIGHBOUR`] for each of the others in order.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows of what was measured in the last step or reset, whose results were `observations`: for each drone
    /// [`OBSERVATION`] numbers, then [`NEIGHBOUR`] for each of the others.
    pub fn measured<'a>(&'a self, observations: &'a [f32]) -> &'a [f32] {
        if self.measured.is_empty() { observations } else { &self.measured }
    }

    /// Numbers in a row of [`VectorEnv::measured`].
    pub fn measured_width(&self) -> usize {
        measured_width(self.num_drones())
    }

    /// Numbers of an environment in [`StepBuffers::metrics`]: as many as [`METRICS`], or none for a task of
    /// one drone.
    pub fn num_metrics(&self) -> usize {
        self.metrics
    }

    /// Returns the command interface of each drone of an environment.
    pub fn interfaces(&self) -> &[Interface] {
        &self.config.interfaces
    }

    /// Seconds per step.
    pub fn tick_s(&self) -> f64 {
        self.tick_s
    }

    /// The instruction set in use.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Begin episodes in the environments of `mask` (all, if `None`) and write their first observations;
    /// other rows are left alone. With `seeds` (one per environment) the first episode of that seed begins,
    /// without them the next one.
    ///
    /// # Errors
    /// [`Error::Shape`] for buffers of the wrong length; [`Error::NotReset`] if the very first reset leaves
    /// some environments out.
    pub fn reset(
        &mut self,
        seeds: Option<&[u64]>,
        mask: Option<&[bool]>,
        observations: &mut [f32],
    ) -> Result<()> {
        let per_env = self.num_drones() * self.width();
        check_length("observations", self.envs * per_env, observations.len())?;
        check_length("seeds", self.envs, seeds.map_or(self.envs, <[u64]>::len))?;
        check_length("reset_mask", self.envs, mask.map_or(self.envs, <[bool]>::len))?;
        if !self.ready && mask.is_some_and(|m| m.iter().any(|on| !on)) {
            return Err(Error::NotReset);
        }
        let per_shard = self.share * self.num_drones() * self.measured_width();
        let mut measured = &mut self.measured[..];
        for (i, (shard, rows)) in
            self.shards.iter_mut().zip(observations.chunks_mut(self.share * per_env)).enumerate()
        {
            let measured = buffers::cut(&mut measured, per_shard);
            shard.reset(i * self.share, seeds, mask, measured, rows);
        }
        self.ready = true;
        Ok(())
    }

    /// One step of every environment. Actions of drones that no longer fly are ignored, but must be numbers
    /// from -1 to 1 too.
    ///
    /// # Errors
    /// Before anything moves: [`Error::NotReset`], [`Error::Shape`], [`Error::Action`] or
    /// [`Error::DroneAction`], and [`Error::Ended`] if an environment has ended and automatic resets are
    /// disabled. After the step: [`Error::NotFinite`] where a reward or end of the user's own is no number.
    pub fn step(&mut self, actions: &[f32], mut out: StepBuffers<'_>) -> Result<()> {
        self.check_step(actions, 1, &out)?;
        let (drones, width, metrics) = (self.num_drones(), self.width(), self.metrics);
        let (config, share) = (&self.config, self.share);
        let parts = self.shards.iter_mut().zip(actions.chunks(share * drones * ACTION));
        let (mut measured, per_shard) = (&mut self.measured[..], share * drones * measured_width(drones));
        let parts = parts.map(|(shard, actions)| {
            let measured = buffers::cut(&mut measured, per_shard);
            (shard, actions, measured, out.split(share, drones, width, metrics))
        });
        self.team.each(parts, |(shard, actions, measured, out)| {
            shard.run(config, 0..shard.tiles(), actions, measured, out);
        });
        self.check_finite()
    }

    /// Checks the conditions of `steps` steps: shapes, actions that are numbers, episodes that are under way.
    fn check_step(&mut self, actions: &[f32], steps: usize, out: &StepBuffers<'_>) -> Result<()> {
        self.check_buffers(out)?;
        check_length("actions", steps * self.over.len() * ACTION, actions.len())?;
        self.check_actions(actions)
    }

    /// That there is something to step, and room for its results.
    fn check_buffers(&self, out: &StepBuffers<'_>) -> Result<()> {
        if !self.ready {
            return Err(Error::NotReset);
        }
        let (rows, metrics) = (self.over.len(), self.metrics);
        check_length("observations", rows * self.width, out.observations.len())?;
        check_length("rewards", rows, out.rewards.len())?;
        check_length("terminated", rows, out.terminated.len())?;
        check_length("truncated", rows, out.truncated.len())?;
        let unasked = metrics == 0 && out.flying.is_empty();
        check_length("flying", if unasked { 0 } else { rows }, out.flying.len())?;
        check_length("metrics", self.envs * metrics, out.metrics.len())?;
        if self.config.autoreset == Autoreset::Disabled {
            self.check_running()?;
        }
        Ok(())
    }

    /// Rewards and ends of a user's own were numbers in the last step.
    fn check_finite(&mut self) -> Result<()> {
        let share = self.share;
        let faults = self.shards.iter_mut().map(|shard| shard.take_fault()).enumerate();
        // all are taken, so that none is left for the next step
        let first = faults.fold(None, |first, (i, fault)| first.or(fault.map(|fault| (i, fault))));
        first.map_or(Ok(()), |(i, fault)| Err(self.not_finite(fault.shifted(i * share))))
    }

    fn not_finite(&self, fault: Fault) -> Error {
        let Fault { name, value, env, drone, step } = fault;
        let text = self.texts.iter().find(|(known, _)| *known == name).and_then(|(_, text)| text.clone());
        Error::NotFinite { name, text: text.unwrap_or_default(), value, env, drone, step }
    }

    /// Ends flights by a caller's own rule, as a task's own end does: with [`Autoreset::NextStep`] the next
    /// step resets an environment that has none left. A flag for each drone.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NotReset`], and [`Error::Config`] with [`Autoreset::SameStep`], whose resets have
    /// been by now.
    pub fn end_flights(&mut self, drones: &[bool]) -> Result<()> {
        let per_env = self.num_drones();
        check_length("ends", self.envs * per_env, drones.len())?;
        if !self.ready {
            return Err(Error::NotReset);
        }
        if self.config.autoreset == Autoreset::SameStep {
            return Err(Error::Config("autoreset same_step: flights cannot be ended after a step".into()));
        }
        for (shard, flags) in self.shards.iter_mut().zip(drones.chunks(self.share * per_env)) {
            shard.end(flags);
        }
        Ok(())
    }

    /// Writes the numbers of [`Options::watch`], of each drone at the end of the last step, before any reset.
    ///
    /// # Errors
    /// [`Error::Shape`] unless `out` has [`VectorEnv::watched_width`] numbers for each drone.
    pub fn watched(&self, out: &mut [f32]) -> Result<()> {
        let per_env = self.num_drones() * self.watched;
        check_length("watched", self.envs * per_env, out.len())?;
        if per_env > 0 {
            for (shard, rows) in self.shards.iter().zip(out.chunks_mut(self.share * per_env)) {
                rows.copy_from_slice(shard.watched());
            }
        }
        Ok(())
    }

    /// Numbers of a drone in [`VectorEnv::watched`].
    pub fn watched_width(&self) -> usize {
        self.watched
    }

    /// Actions of one step, or of several one after the other.
    fn check_actions(&mut self, actions: &[f32]) -> Result<()> {
        let bad = AtomicUsize::new(usize::MAX);
        let share = actions.len().div_ceil(self.shards.len()).max(1);
        self.team.each(
            self.shards.iter_mut().zip(actions.chunks(share)).enumerate(),
            |(i, (shard, actions))| {
                if let Some(at) = shard.first_bad_action(actions) {
                    bad.fetch_min(i * share + at, Ordering::Relaxed);
                }
            },
        );
        let index = bad.into_inner();
        if index == usize::MAX {
            return Ok(());
        }
        Err(self.bad_action(index / ACTION % self.over.len(), index % ACTION, actions[index]))
    }

    fn bad_action(&self, row: usize, axis: usize, value: f32) -> Error {
        let drones = self.num_drones();
        if self.metrics == 0 {
            Error::Action { env: row, axis, value }
        } else {
            Error::DroneAction { world: row / drones, drone: row % drones, axis, value }
        }
    }

    fn check_running(&self) -> Result<()> {
        let ended =
            self.shards.iter().enumerate().find_map(|(i, shard)| Some(i * self.share + shard.first_ended()?));
        ended.map_or(Ok(()), |env| Err(Error::Ended { env }))
    }

    /// Sets external forces on every drone, rows of three in the world frame, N: they act on its centre of mass in
    /// all later steps, until others are set, or `None`. They accelerate by the mass that the drone's model declares,
    /// and are no part of the state, as actions are none.
    ///
    /// # Errors
    /// [`Error::Shape`]; [`Error::Range`] for what is not finite, with its place.
    pub fn set_force(&mut self, force_n: Option<&[f32]>) -> Result<()> {
        let drones = self.num_drones();
        if let Some(force_n) = force_n {
            check_length("force_n", self.over.len() * 3, force_n.len())?;
            if let Some(at) = force_n.iter().position(|n| !n.is_finite()) {
                let (row, axis) = (at / 3, at % 3);
                let place = if self.metrics == 0 {
                    format!("{row}")
                } else {
                    format!("{}][{}", row / drones, row % drones)
                };
                let name = format!("force_n[{place}][{axis}]");
                return Err(out_of_range(name, force_n[at].into(), "a finite number"));
            }
        }
        for (i, shard) in self.shards.iter_mut().enumerate() {
            shard.set_force(force_n.map(|rows| &rows[i * self.share * drones * 3..]));
        }
        Ok(())
    }

    /// The true states, a row of [`STATE`] for each drone: position, velocity, roll pitch yaw, their rates.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn states(&self, out: &mut [f32]) -> Result<()> {
        check_length("states", self.envs * self.num_drones() * STATE, out.len())?;
        self.first_states(out)
    }

    /// Returns the edges of the gates and obstacles in this episode of an environment; for pictures.
    ///
    /// # Errors
    /// [`Error::Range`] for an environment that there is not.
    pub fn outlines(&self, env: usize) -> Result<Vec<Outline>> {
        check_range("env", env as f64, 0.0, (self.envs - 1) as f64)?;
        Ok(self.shards[env / self.share].outlines(env % self.share))
    }

    /// The true states of the first drones, as many rows of [`STATE`] as `out` has room for.
    ///
    /// # Errors
    /// [`Error::Shape`] unless `out` is whole rows of drones that exist.
    pub fn first_states(&self, out: &mut [f32]) -> Result<()> {
        let drones = self.num_drones();
        check_length("states", (out.len() / STATE).min(self.envs * drones) * STATE, out.len())?;
        for (shard, rows) in self.shards.iter().zip(out.chunks_mut(self.share * drones * STATE)) {
            shard.states(rows);
        }
        Ok(())
    }

    /// Writes the positions of the loads, rows of three, one for each environment; returns `false` if the task has
    /// none.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn loads(&self, out: &mut [f32]) -> Result<bool> {
        check_length("loads", self.envs * 3, out.len())?;
        let rows = self.shards.iter().zip(out.chunks_mut(self.share * 3));
        Ok(rows.fold(true, |all, (shard, rows)| shard.loads(rows) && all))
    }

    /// With [`Autoreset::SameStep`]: last observations and true states of the episode that ended in the last
    /// step in environment `env`, rows for each drone.
    pub fn last_of_episode(&self, env: usize) -> Option<(&[f32], &[f32])> {
        self.shards.get(env / self.share)?.last_of_episode(env % self.share)
    }
}

/// The interface of each drone, whose effects fit its form and the action level.
fn checked_interfaces(models: &[&Model], options: &Options) -> Result<Vec<Interface>> {
    let interface = |(drone, model): (usize, &&Model)| {
        let input = options.action.input(model, options.vertical)?;
        check_scope(model, &options.drone_effects(drone), input, options.action)?;
        Interface::at_level(model, input, options.action)
    };
    models.iter().enumerate().map(interface).collect()
}

/// The control tick that all models share.
fn common_tick_s(models: &[&Model]) -> Result<f64> {
    let tick_s = Schedule::from_model(models[0])?.tick_s();
    for model in models {
        let other_s = Schedule::from_model(model)?.tick_s();
        if other_s != tick_s {
            return Err(out_of_range("the control tick of a drone's model", other_s, format!("{tick_s} s")));
        }
    }
    Ok(tick_s)
}

/// Environments of a block, and blocks of a shard: as few as stay in the cache, and the threads' parts alike.
fn blocks(tiles: usize, drones: usize, threads: usize) -> (usize, usize) {
    let per_thread = tiles.div_ceil(threads.clamp(1, tiles));
    let most = (BLOCK_DRONES / (LANES * drones)).max(GROUP);
    let blocks = per_thread.div_ceil(most);
    (per_thread.div_ceil(blocks) * LANES, blocks)
}

fn measured_width(drones: usize) -> usize {
    OBSERVATION + NEIGHBOUR * (drones - 1)
}

/// A number that differs where models, options or drones do; threads and instruction set change no flight.
fn fingerprint(models: &[&Model], options: &Options, drones: usize) -> Result<u64> {
    let bad = |e: serde_json::Error| Error::Config(e.to_string());
    let alike = Options { threads: 1, isa: None, drones, ..options.clone() };
    let text = serde_json::to_string(&(models, alike)).map_err(bad)?;
    Ok(checksum(text.as_bytes()))
}
