//! Worlds that several drones share: they feel each other's downwash, collide, and know of each other what their radio says.
//!
//! A tile is sixteen worlds, and drone `j` of those worlds is a tile of [`crate::world::World`] of its own: drones feel each other lane by
//! lane. Rows of numbers are world by world, and within a world drone by drone.

mod known;
pub mod load;
pub mod mission;
mod options;
mod shard;

use std::marker::PhantomData;
use std::sync::atomic::{AtomicUsize, Ordering};

pub use known::{Knowledge, NEIGHBOUR};
pub use options::{Each, MOST_DRONES, Shared, SwarmOptions};

use crate::config::Autoreset;
use crate::error::{Error, Result};
use crate::isa::{Kind, Level};
use crate::lanes::{LANES, Lanes};
use crate::model::{Model, VerticalInput};
use crate::observation::{ACTION, Interface, OBSERVATION};
use crate::rows::{STATE, shape};
use crate::schedule::Schedule;
use crate::simulated::Batched;
use crate::team::Team;
use mission::Mission;
use shard::{Part, Shard, Whole};

/// What is measured of each world's episode so far, in this order.
pub const METRICS: [(&str, &str, &str); 6] = [
    ("collisions", "1", "drones that hit another"),
    ("crashes", "1", "drones that hit the floor or left the room"),
    ("min_separation_m", "m", "smallest distance between two drones that flew"),
    ("settled_s", "s", "last time at which one that flew was not where it should be in the end"),
    ("rms_error_m", "m", "root mean square distance from where they should be"),
    ("done", "1", "drones whose part is done, or that are where they should be"),
];

/// The caller's buffers for the results of a step: worlds x drones, and metrics of worlds.
#[derive(Debug)]
pub struct SwarmOut<'a> {
    /// Rows of [`SwarmEnv::width`].
    pub observations: &'a mut [f32],
    pub rewards: &'a mut [f32],
    /// The drone's flight ended in this step: collided, crashed, or its part done.
    pub terminated: &'a mut [bool],
    /// Its world's time ran out in this step.
    pub truncated: &'a mut [bool],
    /// It flies on: its next action counts.
    pub flying: &'a mut [bool],
    /// Rows of [`METRICS`], one for each world; in an episode's last step those of the whole episode, also where the next one began at once.
    pub metrics: &'a mut [f32],
}

/// What is the same for all shards.
#[derive(Debug, Clone)]
pub(crate) struct Rules {
    pub(crate) interfaces: Vec<Interface>,
    pub(crate) autoreset: Autoreset,
    /// Past this an episode is over.
    pub(crate) last_s: f64,
    pub(crate) radius_m: f64,
    pub(crate) drones: usize,
}

/// A batch of worlds.
pub struct SwarmEnv {
    shards: Vec<Box<dyn Part>>,
    rules: Rules,
    worlds: usize,
    /// Worlds per shard but the last.
    share: usize,
    team: Team,
    ready: bool,
    level: Level,
    tick_s: f64,
}

struct Maker<'a, R> {
    whole: Whole<'a>,
    number: PhantomData<R>,
}

impl<R: Batched> mission::Visitor for Maker<'_, R> {
    type Out = Box<dyn Part>;
    fn visit<M: Mission>(self, mission: M, drones: usize) -> Result<Box<dyn Part>> {
        Ok(Box::new(Shard::<R, M>::new(&self.whole, mission, drones)?))
    }
}

/// The number of drones that a mission will have.
struct Count;

impl mission::Visitor for Count {
    type Out = usize;
    fn visit<M: Mission>(self, _: M, drones: usize) -> Result<usize> {
        Ok(drones)
    }
}

fn part<R: Batched>(whole: Whole<'_>) -> Result<Box<dyn Part>> {
    let SwarmOptions { env, shared } = whole.options;
    mission::visit(&env.task, shared.drones, &env.task_options, Maker::<R> { whole, number: PhantomData })
}

impl SwarmEnv {
    /// A batch of `worlds` worlds; one model for all drones, or one for each. Call [`SwarmEnv::reset`] before the first step.
    ///
    /// # Errors
    /// [`Error::Range`] for no worlds, too many drones, or rigs whose ticks differ; otherwise as [`crate::vector::VectorEnv::new`].
    pub fn new(models: &[Model], options: &SwarmOptions, worlds: usize) -> Result<Self> {
        if worlds == 0 {
            return Err(Error::Range { name: "num_worlds".into(), value: 0.0, want: "at least 1".into() });
        }
        let (env, shared) = (&options.env, &options.shared);
        let drones = mission::visit(&env.task, shared.drones, &env.task_options, Count)?;
        options.check(drones, models.len())?;
        let models: Vec<&Model> = (0..drones).map(|j| models.get(j).unwrap_or(&models[0])).collect();
        let tick_s = Schedule::of(models[0])?.tick_s();
        let inputs = models.iter().map(|model| input(model, env.vertical)).collect::<Result<Vec<_>>>()?;
        for model in &models {
            let other_s = Schedule::of(model)?.tick_s();
            if other_s != tick_s {
                return Err(Error::Range {
                    name: "the control tick of a drone's model".into(),
                    value: other_s,
                    want: format!("{tick_s} s"),
                });
            }
        }
        shared.neighbours.check(tick_s)?;
        let level = Level::named(env.isa.as_deref())?;
        let tiles = worlds.div_ceil(LANES);
        let share = tiles.div_ceil(env.threads.clamp(1, tiles)) * LANES;
        let shards = (0..worlds)
            .step_by(share)
            .map(|first| {
                let whole = Whole { models: &models, inputs: &inputs, options, worlds: share.min(worlds - first), tick_s };
                match level.kind() {
                    Kind::Baseline => part::<Lanes>(whole),
                    #[cfg(target_arch = "x86_64")]
                    Kind::Avx2 => part::<crate::lanes_avx2::Lanes>(whole),
                    #[cfg(target_arch = "x86_64")]
                    Kind::Avx512 => part::<crate::lanes_avx512::Lanes>(whole),
                }
            })
            .collect::<Result<Vec<_>>>()?;
        let interfaces = models.iter().zip(&inputs).map(|(model, input)| Interface::of(model, *input)).collect::<Result<_>>()?;
        // half a step of margin, because the clock is in `f32`
        let last_s = if env.max_episode_steps == 0 { f64::INFINITY } else { (f64::from(env.max_episode_steps) - 0.5) * tick_s };
        let rules = Rules { interfaces, autoreset: env.autoreset, last_s, radius_m: shared.radius_m, drones };
        let team = Team::new(shards.len() - 1)?;
        Ok(SwarmEnv { shards, rules, worlds, share, team, ready: false, level, tick_s })
    }

    pub fn num_worlds(&self) -> usize {
        self.worlds
    }

    /// Drones in each world.
    pub fn num_drones(&self) -> usize {
        self.rules.drones
    }

    /// Numbers in a drone's observation: its own as of a single drone, then [`NEIGHBOUR`] for each of the others in order.
    pub fn width(&self) -> usize {
        OBSERVATION + NEIGHBOUR * (self.rules.drones - 1)
    }

    /// What the actions of a drone are mapped to.
    pub fn interface(&self, drone: usize) -> Option<Interface> {
        self.rules.interfaces.get(drone).copied()
    }

    /// Seconds per step.
    pub fn tick_s(&self) -> f64 {
        self.tick_s
    }

    /// The instruction set in use.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Begin episodes in the worlds of `mask` (all, if `None`) and write their drones' first observations; other rows are left alone. With
    /// `seeds` (one per world) the first episode of that seed begins, without them the next one.
    ///
    /// # Errors
    /// As [`crate::vector::VectorEnv::reset`].
    pub fn reset(&mut self, seeds: Option<&[u64]>, mask: Option<&[bool]>, observations: &mut [f32]) -> Result<()> {
        let per_world = self.rules.drones * self.width();
        shape("observations", self.worlds * per_world, observations.len())?;
        shape("seeds", self.worlds, seeds.map_or(self.worlds, <[u64]>::len))?;
        shape("reset_mask", self.worlds, mask.map_or(self.worlds, <[bool]>::len))?;
        if !self.ready && mask.is_some_and(|m| m.iter().any(|on| !on)) {
            return Err(Error::NotReset);
        }
        for (i, (shard, rows)) in self.shards.iter_mut().zip(observations.chunks_mut(self.share * per_world)).enumerate() {
            shard.reset(&self.rules, i * self.share, seeds, mask, rows);
        }
        self.ready = true;
        Ok(())
    }

    /// One step of every world. Actions of drones that no longer fly are ignored, but must be numbers from -1 to 1 too.
    ///
    /// # Errors
    /// Before anything moves: [`Error::NotReset`], [`Error::Shape`], [`Error::DroneAction`], and [`Error::Ended`] if a world has ended and
    /// automatic resets are disabled.
    pub fn step(&mut self, actions: &[f32], out: SwarmOut<'_>) -> Result<()> {
        if !self.ready {
            return Err(Error::NotReset);
        }
        let (worlds, drones, width) = (self.worlds, self.rules.drones, self.width());
        let all = worlds * drones;
        shape("actions", all * ACTION, actions.len())?;
        shape("observations", all * width, out.observations.len())?;
        shape("rewards", all, out.rewards.len())?;
        shape("terminated", all, out.terminated.len())?;
        shape("truncated", all, out.truncated.len())?;
        shape("flying", all, out.flying.len())?;
        shape("metrics", worlds * METRICS.len(), out.metrics.len())?;
        self.check(actions)?;
        let (rules, n) = (&self.rules, self.share * drones);
        let parts = self
            .shards
            .iter_mut()
            .zip(actions.chunks(n * ACTION))
            .zip(out.observations.chunks_mut(n * width).zip(out.rewards.chunks_mut(n)))
            .zip(out.terminated.chunks_mut(n).zip(out.truncated.chunks_mut(n)))
            .zip(out.flying.chunks_mut(n).zip(out.metrics.chunks_mut(self.share * METRICS.len())));
        self.team.each(parts, |((((shard, actions), (observations, rewards)), (terminated, truncated)), (flying, metrics))| {
            shard.run(rules, actions, SwarmOut { observations, rewards, terminated, truncated, flying, metrics });
        });
        Ok(())
    }

    fn check(&mut self, actions: &[f32]) -> Result<()> {
        if self.rules.autoreset == Autoreset::Disabled {
            let ended = self.shards.iter().enumerate().find_map(|(i, shard)| Some(i * self.share + shard.first_ended()?));
            if let Some(env) = ended {
                return Err(Error::Ended { env });
            }
        }
        let (share, bad, drones) = (self.share * self.rules.drones * ACTION, AtomicUsize::new(usize::MAX), self.rules.drones);
        self.team.each(self.shards.iter_mut().zip(actions.chunks(share)).enumerate(), |(i, (shard, actions))| {
            if let Some(at) = shard.first_bad_action(actions) {
                bad.fetch_min(i * share + at, Ordering::Relaxed);
            }
        });
        match bad.into_inner() {
            usize::MAX => Ok(()),
            at => {
                Err(Error::DroneAction { world: at / ACTION / drones, drone: at / ACTION % drones, axis: at % ACTION, value: actions[at] })
            }
        }
    }

    /// The true states, worlds x drones rows of [`STATE`]: position, velocity, roll pitch yaw, their rates.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn states(&self, out: &mut [f32]) -> Result<()> {
        let per_world = self.rules.drones * STATE;
        shape("states", self.worlds * per_world, out.len())?;
        for (shard, rows) in self.shards.iter().zip(out.chunks_mut(self.share * per_world)) {
            shard.states(rows);
        }
        Ok(())
    }

    /// Where the loads are, rows of three, one for each world; nowhere (`false`) if the mission has none.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn loads(&self, out: &mut [f32]) -> Result<bool> {
        shape("loads", self.worlds * 3, out.len())?;
        let rows = self.shards.iter().zip(out.chunks_mut(self.share * 3));
        Ok(rows.fold(true, |all, (shard, rows)| shard.loads(rows) && all))
    }

    /// With [`Autoreset::SameStep`]: the drones' last observations (rows of [`SwarmEnv::width`]) of the episode that ended in the last step in
    /// world `world`.
    pub fn last_of_episode(&self, world: usize) -> Option<&[f32]> {
        self.shards.get(world / self.share)?.last_of_episode(world % self.share)
    }
}

fn input(model: &Model, asked: Option<VerticalInput>) -> Result<VerticalInput> {
    // a checked model has at least one input
    asked.or(model.inputs().first().copied()).ok_or_else(|| Error::Config("the model has no vertical form".into()))
}
