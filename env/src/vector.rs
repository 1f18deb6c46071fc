//! A batch of environments, each a world of one drone or of several that share the air: caller-owned buffers
//! in and out, automatic resets, nothing allocated per step.
//!
//! Environment `i` is the same whatever the size of the batch: an episode is a function of its seed, its
//! number and its actions. A tile is sixteen environments. Rows of numbers are environment by environment,
//! and within one drone by drone.

mod buffers;
mod coupled;
mod judgement;
mod observer;
mod uncoupled;

use std::marker::PhantomData;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::archive::Archive;
use crate::config::{Autoreset, Options};
use crate::coupling::NEIGHBOUR;
use crate::error::{Error, Result, check_length};
use crate::isa::{Kind, Level};
use crate::lanes::{LANES, Lanes};
use crate::model::{Model, VerticalInput};
use crate::noise::scramble;
use crate::observation::{ACTION, Interface, OBSERVATION};
use crate::pool::WorkerPool;
use crate::schedule::Schedule;
use crate::sim_scalar::BatchScalar;
use crate::task::{self, Task, Visitor};
use crate::world::check_scope;

use coupled::CoupledShard;
use judgement::Fault;
use uncoupled::UncoupledShard;

pub use crate::rows::{STATE, state_index};
pub use buffers::StepBuffers;

/// What is measured of the episode so far in an environment of several drones, in this order.
pub const METRICS: [(&str, &str, &str); 6] = [
    ("collisions", "1", "drones that hit another"),
    ("crashes", "1", "drones that hit the floor or left the room"),
    ("min_separation_m", "m", "smallest distance between two drones that flew"),
    ("settled_s", "s", "last time at which one that flew was not where it should be in the end"),
    ("rms_error_m", "m", "root mean square distance from where they should be"),
    ("done", "1", "drones whose part is done, or that are where they should be"),
];

/// What is the same for all shards.
#[derive(Debug, Clone)]
pub(crate) struct BatchConfig {
    /// What actions are mapped to, for each drone.
    pub(crate) interfaces: Vec<Interface>,
    pub(crate) autoreset: Autoreset,
    /// Past this an episode is over: half a step of margin, because the clock is in `f32`.
    pub(crate) last_s: f64,
    pub(crate) radius_m: f64,
    pub(crate) crash_cost: f64,
}

/// A batch of environments.
pub struct VectorEnv {
    shards: Vec<Box<dyn Shard>>,
    config: BatchConfig,
    envs: usize,
    /// Numbers in a drone's observation.
    width: usize,
    /// What is measured, where observations hold something else.
    measured: Vec<f32>,
    /// Numbers of each drone in [`VectorEnv::watched`].
    watched: usize,
    /// Rewards and ends that are not the task's, as they were written.
    texts: [Option<String>; 2],
    /// Numbers per environment in [`StepBuffers::metrics`].
    metrics: usize,
    /// Environments per shard but the last.
    share: usize,
    team: WorkerPool,
    ready: bool,
    level: Level,
    tick_s: f64,
    /// Of all that decides a flight besides seeds and actions.
    fingerprint: u64,
}

/// A contiguous part of the batch with worlds of its own, stepped by one thread, whatever its number type and
/// its task.
trait Shard: Send {
    fn reset(
        &mut self,
        config: &BatchConfig,
        first: usize,
        seeds: Option<&[u64]>,
        mask: Option<&[bool]>,
        measured: &mut [f32],
        observations: &mut [f32],
    );
    /// `measured` is empty where the observations are what is measured.
    fn run<'a>(
        &mut self,
        config: &BatchConfig,
        actions: &[f32],
        measured: &'a mut [f32],
        out: StepBuffers<'a>,
    );
    fn first_ended(&self) -> Option<usize>;
    fn first_bad_action(&self, actions: &[f32]) -> Option<usize>;
    fn states(&self, rows: &mut [f32]);
    fn last_of_episode(&self, env: usize) -> Option<(&[f32], &[f32])>;
    fn loads(&self, rows: &mut [f32]) -> bool;
    /// Ends flights, a flag for each drone.
    fn end(&mut self, drones: &[bool]);
    /// Numbers of the last step that were asked for, a row for each drone.
    fn watched(&self) -> &[f32];
    /// The first number of the last step that is none, with its environment counted from the shard's first.
    fn take_fault(&mut self) -> Option<Fault>;
    fn archive(&mut self, archive: &mut Archive<'_>);
}

/// What a shard is made of.
#[derive(Clone, Copy)]
struct ShardSpec<'a> {
    /// One for each drone.
    models: &'a [&'a Model],
    inputs: &'a [VerticalInput],
    interfaces: &'a [Interface],
    options: &'a Options,
    envs: usize,
    tick_s: f64,
}

impl ShardSpec<'_> {
    fn shard<R: BatchScalar>(self) -> Result<Box<dyn Shard>> {
        let Options { task, drones, task_options, .. } = self.options;
        task::visit(task, *drones, task_options, ShardBuilder::<R> { spec: self, number: PhantomData })
    }
}

struct ShardBuilder<'a, R> {
    spec: ShardSpec<'a>,
    number: PhantomData<R>,
}

impl<R: BatchScalar> Visitor for ShardBuilder<'_, R> {
    type Output = Box<dyn Shard>;
    fn visit<T: Task>(self, task: T, drones: usize) -> Result<Box<dyn Shard>> {
        if const { T::DRONES == 1 } {
            Ok(Box::new(UncoupledShard::<R, T>::new(&self.spec, task)?))
        } else {
            Ok(Box::new(CoupledShard::<R, T>::new(&self.spec, task, drones)?))
        }
    }
}

impl VectorEnv {
    /// A batch of `envs` environments; one model for all drones of an environment, or one for each. Call
    /// [`VectorEnv::reset`] before the first step.
    ///
    /// # Errors
    /// [`Error::Range`] for no environments, too many drones, or rigs whose ticks differ; [`Error::Unknown`],
    /// [`Error::Range`] or [`Error::Config`] for what `options` asks.
    pub fn new(models: &[Model], options: &Options, envs: usize) -> Result<Self> {
        let range = |name: &str, value: f64, want: String| Error::Range { name: name.into(), value, want };
        if envs == 0 {
            return Err(range("num_envs", 0.0, "at least 1".into()));
        }
        let entry = task::find(&options.task)?;
        let drones = entry.drones(options.drones)?;
        options.check_drones(drones, models.len())?;
        let models: Vec<&Model> = (0..drones).map(|j| models.get(j).unwrap_or(&models[0])).collect();
        let inputs = models
            .iter()
            .map(|model| options.action.input(model, options.vertical))
            .collect::<Result<Vec<_>>>()?;
        for (drone, (model, input)) in models.iter().zip(&inputs).enumerate() {
            check_scope(model, &options.drone_effects(drone), *input, options.action)?;
        }
        let tick_s = Schedule::from_model(models[0])?.tick_s();
        for model in &models {
            let other_s = Schedule::from_model(model)?.tick_s();
            if other_s != tick_s {
                return Err(range("the control tick of a drone's model", other_s, format!("{tick_s} s")));
            }
        }
        options.neighbours.check(tick_s)?;
        let level = Level::named(options.isa.as_deref())?;
        let interfaces: Vec<Interface> = models
            .iter()
            .zip(&inputs)
            .map(|(model, input)| Interface::at_level(model, *input, options.action))
            .collect::<Result<_>>()?;
        let tiles = envs.div_ceil(LANES);
        let share = tiles.div_ceil(options.threads.clamp(1, tiles)) * LANES;
        let shards = (0..envs)
            .step_by(share)
            .map(|first| {
                let spec = ShardSpec {
                    models: &models,
                    inputs: &inputs,
                    options,
                    interfaces: &interfaces,
                    envs: share.min(envs - first),
                    tick_s,
                };
                match level.kind() {
                    Kind::Baseline => spec.shard::<Lanes>(),
                    #[cfg(target_arch = "x86_64")]
                    Kind::Avx2 => spec.shard::<crate::lanes_avx2::Lanes>(),
                    #[cfg(target_arch = "x86_64")]
                    Kind::Avx512 => spec.shard::<crate::lanes_avx512::Lanes>(),
                }
            })
            .collect::<Result<Vec<_>>>()?;
        let last_s = if options.max_episode_steps == 0 {
            f64::INFINITY
        } else {
            (f64::from(options.max_episode_steps) - 0.5) * tick_s
        };
        let config = BatchConfig {
            interfaces,
            autoreset: options.autoreset,
            last_s,
            radius_m: options.radius_m,
            crash_cost: entry.crash_cost,
        };
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
            measured: vec![0.0; kept],
            watched: judgement::watched_width(options)?,
            texts: [options.reward.clone(), options.termination.clone()],
            metrics,
            share,
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

    /// Numbers in a drone's observation. Of a tick these are its own, [`OBSERVATION`] unless something else
    /// than what is measured was asked for, then [`NEIGHBOUR`] for each of the others in order.
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

    /// What the actions are mapped to, for each drone of an environment.
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
            shard.reset(&self.config, i * self.share, seeds, mask, measured, rows);
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
        if !self.ready {
            return Err(Error::NotReset);
        }
        let (envs, drones, width, metrics, share) =
            (self.envs, self.num_drones(), self.width(), self.metrics, self.share);
        let rows = envs * drones;
        check_length("actions", rows * ACTION, actions.len())?;
        check_length("observations", rows * width, out.observations.len())?;
        check_length("rewards", rows, out.rewards.len())?;
        check_length("terminated", rows, out.terminated.len())?;
        check_length("truncated", rows, out.truncated.len())?;
        let unasked = metrics == 0 && out.flying.is_empty();
        check_length("flying", if unasked { 0 } else { rows }, out.flying.len())?;
        check_length("metrics", envs * metrics, out.metrics.len())?;
        self.check_actions(actions)?;
        if self.config.autoreset == Autoreset::Disabled {
            self.check_running()?;
        }
        let config = &self.config;
        let parts = self.shards.iter_mut().zip(actions.chunks(share * drones * ACTION));
        let (mut measured, per_shard) = (&mut self.measured[..], share * drones * measured_width(drones));
        let parts = parts.map(|(shard, actions)| {
            let measured = buffers::cut(&mut measured, per_shard);
            (shard, actions, measured, out.split(share, drones, width, metrics))
        });
        self.team.each(parts, |(shard, actions, measured, out)| shard.run(config, actions, measured, out));
        self.check_finite()
    }

    /// Rewards and ends of a user's own were numbers in the last step.
    fn check_finite(&mut self) -> Result<()> {
        let share = self.share;
        let faults = self.shards.iter_mut().map(|shard| shard.take_fault()).enumerate();
        // all are taken, so that none is left for the next step
        let first = faults.fold(None, |first, (i, fault)| first.or(fault.map(|fault| (i, fault))));
        let Some((i, Fault { name, value, env, drone, step })) = first else { return Ok(()) };
        let text = if name == judgement::REWARD { &self.texts[0] } else { &self.texts[1] };
        let text = text.clone().unwrap_or_default();
        Err(Error::NotFinite { name, text, value, env: i * share + env, drone, step })
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

    /// Numbers that [`Options::watch`] asks for, of each drone at the end of the last step, before any reset.
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

    fn check_actions(&mut self, actions: &[f32]) -> Result<()> {
        let drones = self.num_drones();
        let (share, bad) = (self.share * drones * ACTION, AtomicUsize::new(usize::MAX));
        self.team.each(
            self.shards.iter_mut().zip(actions.chunks(share)).enumerate(),
            |(i, (shard, actions))| {
                if let Some(at) = shard.first_bad_action(actions) {
                    bad.fetch_min(i * share + at, Ordering::Relaxed);
                }
            },
        );
        let at = bad.into_inner();
        if at == usize::MAX {
            return Ok(());
        }
        let (row, axis, value) = (at / ACTION, at % ACTION, actions[at]);
        Err(if self.metrics == 0 {
            Error::Action { env: row, axis, value }
        } else {
            Error::DroneAction { world: row / drones, drone: row % drones, axis, value }
        })
    }

    fn check_running(&self) -> Result<()> {
        let ended =
            self.shards.iter().enumerate().find_map(|(i, shard)| Some(i * self.share + shard.first_ended()?));
        ended.map_or(Ok(()), |env| Err(Error::Ended { env }))
    }

    /// The true states, a row of [`STATE`] for each drone: position, velocity, roll pitch yaw, their rates.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn states(&self, out: &mut [f32]) -> Result<()> {
        check_length("states", self.envs * self.num_drones() * STATE, out.len())?;
        self.first_states(out)
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

    /// Where the loads are, rows of three, one for each environment; nowhere (`false`) if the task has none.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn loads(&self, out: &mut [f32]) -> Result<bool> {
        check_length("loads", self.envs * 3, out.len())?;
        let rows = self.shards.iter().zip(out.chunks_mut(self.share * 3));
        Ok(rows.fold(true, |all, (shard, rows)| shard.loads(rows) && all))
    }

    /// All that the flights go on from, as bytes for [`VectorEnv::restore`]; the same for every thread count
    /// and instruction set.
    pub fn snapshot(&mut self) -> Vec<u8> {
        let mut archive = Archive::Write(self.snapshot_head().to_vec());
        self.archive(&mut archive);
        let Archive::Write(mut bytes) = archive else { return Vec::new() };
        let sum = checksum(&bytes[SNAPSHOT_HEAD..]);
        bytes.extend_from_slice(&sum.to_le_bytes());
        bytes
    }

    /// Goes on from where another batch of the same models and options was: to the bit as that one does.
    ///
    /// # Errors
    /// [`Error::Config`] for bytes that are none of [`VectorEnv::snapshot`], are damaged, or are of other
    /// models, options or size; nothing has changed then.
    pub fn restore(&mut self, bytes: &[u8]) -> Result<()> {
        let bad = |problem: &str| Err(Error::Config(format!("state: {problem}")));
        if !bytes.starts_with(SNAPSHOT_MARK) {
            return bad("these are not the bytes of a batch's state, or they are of another version");
        }
        if !bytes.starts_with(&self.snapshot_head()) {
            return bad("it is of a batch of other models, options or size");
        }
        let Some((body, sum)) = bytes[SNAPSHOT_HEAD..].split_last_chunk() else {
            return bad("it is cut off");
        };
        if checksum(body).to_le_bytes() != *sum {
            return bad("it is cut off or damaged");
        }
        self.archive(&mut Archive::Read(body));
        Ok(())
    }

    /// Format and version, and what the batch is.
    fn snapshot_head(&self) -> [u8; SNAPSHOT_HEAD] {
        let mut head = [0; SNAPSHOT_HEAD];
        head[..8].copy_from_slice(SNAPSHOT_MARK);
        head[8..16].copy_from_slice(&self.fingerprint.to_le_bytes());
        head[16..].copy_from_slice(&(self.envs as u64).to_le_bytes());
        head
    }

    fn archive(&mut self, archive: &mut Archive<'_>) {
        let mut ready = u16::from(self.ready);
        archive.bits(&mut ready);
        self.ready = ready != 0;
        self.shards.iter_mut().for_each(|shard| shard.archive(archive));
    }

    /// With [`Autoreset::SameStep`]: last observations and true states of the episode that ended in the last
    /// step in environment `env`, rows for each drone.
    pub fn last_of_episode(&self, env: usize) -> Option<(&[f32], &[f32])> {
        self.shards.get(env / self.share)?.last_of_episode(env % self.share)
    }
}

fn measured_width(drones: usize) -> usize {
    OBSERVATION + NEIGHBOUR * (drones - 1)
}

/// What the bytes of a snapshot begin with: format and version.
const SNAPSHOT_MARK: &[u8; 8] = b"cfstate1";
/// With the fingerprint and the number of environments.
const SNAPSHOT_HEAD: usize = 24;

fn checksum(bytes: &[u8]) -> u64 {
    bytes.iter().fold(bytes.len() as u64, |sum, byte| scramble(sum ^ u64::from(*byte)))
}

/// A number that differs where models, options or drones do; threads and instruction set change no flight.
fn fingerprint(models: &[&Model], options: &Options, drones: usize) -> Result<u64> {
    let bad = |e: serde_json::Error| Error::Config(e.to_string());
    let alike = Options { threads: 1, isa: None, drones, ..options.clone() };
    let text = serde_json::to_string(&(models, alike)).map_err(bad)?;
    Ok(checksum(text.as_bytes()))
}
