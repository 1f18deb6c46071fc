//! A batch of environments: caller-owned buffers in and out, automatic resets, nothing allocated per step.
//!
//! Environment `i` is the same whatever the size of the batch: an episode is a function of its seed, its number and its actions.

mod buffers;

use std::marker::PhantomData;
use std::sync::atomic::{AtomicUsize, Ordering};

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use crate::config::{Autoreset, Options};
use crate::error::{Error, Result};
use crate::isa::{Kind, Level};
use crate::lanes::{LANES, Lanes};
use crate::model::{Model, VerticalInput};
use crate::noise::episode_key;
use crate::observation::{ACTION, Interface, OBSERVATION, Reach, observe};
use crate::plant::{Command, State};
use crate::real::Real;
use crate::rows::{first_bad_action, flags, lanes_of, shape, state_row, write, write_lane};
use crate::schedule::Schedule;
use crate::simulated::Batched;
use crate::task::{self, GOAL, Situation, Task, Visitor};
use crate::team::Team;
use crate::world::{GROUP, Settings, Tick, World};

use buffers::{Buffers, Rest, Rows};

pub use crate::rows::STATE;

/// The caller's buffers for the results of a step, one row per environment.
#[derive(Debug)]
pub struct Out<'a> {
    /// Rows of [`OBSERVATION`]. They are written a tenth to a fifth faster where they begin at a multiple of 32 bytes.
    pub observations: &'a mut [f32],
    pub rewards: &'a mut [f32],
    pub terminated: &'a mut [bool],
    pub truncated: &'a mut [bool],
}

/// What the vector environment remembers of a tile besides its world.
#[derive(Debug, Clone)]
#[repr(C)]
struct Slot<R> {
    last_action: [R; ACTION],
    goal: [R; GOAL],
}

/// Where a tile's environments are in their episodes; kept apart because only the ends of episodes need it.
#[derive(Debug, Clone)]
struct Episodes {
    seed: [u64; LANES],
    number: [u64; LANES],
}

/// A bit per lane of a tile.
#[derive(Debug, Clone, Copy)]
struct Bits {
    /// The episode has ended.
    ended: u16,
    /// An environment of the batch (the last tile may have fewer than sixteen).
    used: u16,
}

/// A contiguous part of the batch with a world of its own, stepped by one thread.
struct Shard<R: Batched, T> {
    world: World<R>,
    task: T,
    slots: Vec<Slot<R>>,
    bits: Vec<Bits>,
    episodes: Vec<Episodes>,
    /// Last observation and true state of episodes that ended in the last step, kept when the environment was reset in that step.
    final_observations: Vec<f32>,
    final_states: Vec<f32>,
}

/// What is the same for all shards.
#[derive(Debug, Clone, Copy)]
struct Rules {
    interface: Interface,
    autoreset: Autoreset,
    max_episode_steps: u32,
    level: Level,
}

/// A batch of environments.
pub struct VectorEnv {
    shards: Vec<Box<dyn Part>>,
    rules: Rules,
    envs: usize,
    /// Environments per shard but the last.
    share: usize,
    team: Team,
    ready: bool,
    tick_s: f64,
}

impl VectorEnv {
    /// A batch of `envs` environments. Call [`VectorEnv::reset`] before the first step.
    ///
    /// # Errors
    /// [`Error::Range`] for no environments, [`Error::Unknown`], [`Error::Range`] or [`Error::Config`] for what `options` asks.
    pub fn new(model: &Model, options: &Options, envs: usize) -> Result<Self> {
        if envs == 0 {
            return Err(Error::Range { name: "num_envs".into(), value: 0.0, want: "at least 1".into() });
        }
        let level = Level::named(options.isa.as_deref())?;
        // a checked model has at least one input
        let input =
            options.vertical.or(model.inputs().first().copied()).ok_or_else(|| Error::Config("the model has no vertical form".into()))?;
        let tiles = envs.div_ceil(LANES);
        let threads = options.threads.clamp(1, tiles);
        let share = tiles.div_ceil(threads) * LANES;
        let shards = (0..envs)
            .step_by(share)
            .map(|first| {
                let whole = Whole { model, options, input, envs: share.min(envs - first) };
                match level.kind() {
                    Kind::Baseline => whole.shard::<Lanes>(),
                    #[cfg(target_arch = "x86_64")]
                    Kind::Avx2 => whole.shard::<crate::lanes_avx2::Lanes>(),
                    #[cfg(target_arch = "x86_64")]
                    Kind::Avx512 => whole.shard::<crate::lanes_avx512::Lanes>(),
                }
            })
            .collect::<Result<Vec<_>>>()?;
        let team = Team::new(shards.len() - 1)?;
        let interface = Interface::of(model, input)?;
        let rules = Rules { interface, autoreset: options.autoreset, max_episode_steps: options.max_episode_steps, level };
        let tick_s = Schedule::of(model)?.tick_s();
        Ok(VectorEnv { shards, rules, envs, share, team, ready: false, tick_s })
    }

    pub fn num_envs(&self) -> usize {
        self.envs
    }

    /// The command interface that actions are mapped to.
    pub fn interface(&self) -> Interface {
        self.rules.interface
    }

    /// Seconds per step.
    pub fn tick_s(&self) -> f64 {
        self.tick_s
    }

    /// The instruction set in use.
    pub fn level(&self) -> Level {
        self.rules.level
    }

    /// Begin episodes in the environments of `mask` (all, if `None`) and write their first observations; other rows are left alone.
    /// With `seeds` (one per environment) the first episode of that seed begins, without them the next one.
    ///
    /// # Errors
    /// [`Error::Shape`] for buffers of the wrong length; [`Error::NotReset`] if the very first reset leaves some environments out.
    pub fn reset(&mut self, seeds: Option<&[u64]>, mask: Option<&[bool]>, observations: &mut [f32]) -> Result<()> {
        shape("observations", self.envs * OBSERVATION, observations.len())?;
        shape("seeds", self.envs, seeds.map_or(self.envs, <[u64]>::len))?;
        shape("reset_mask", self.envs, mask.map_or(self.envs, <[bool]>::len))?;
        if !self.ready && mask.is_some_and(|m| m.iter().any(|on| !on)) {
            return Err(Error::NotReset);
        }
        let (share, interface) = (self.share, self.rules.interface);
        for (i, (shard, rows)) in self.shards.iter_mut().zip(observations.chunks_mut(share * OBSERVATION)).enumerate() {
            shard.reset(&interface, i * share, seeds, mask, rows);
        }
        self.ready = true;
        Ok(())
    }

    /// One step of every environment.
    ///
    /// # Errors
    /// Before anything moves: [`Error::NotReset`], [`Error::Shape`], [`Error::Action`], and [`Error::Ended`] if an environment has ended
    /// and automatic resets are disabled.
    pub fn step(&mut self, actions: &[f32], out: Out<'_>) -> Result<()> {
        if !self.ready {
            return Err(Error::NotReset);
        }
        shape("actions", self.envs * ACTION, actions.len())?;
        shape("observations", self.envs * OBSERVATION, out.observations.len())?;
        shape("rewards", self.envs, out.rewards.len())?;
        shape("terminated", self.envs, out.terminated.len())?;
        shape("truncated", self.envs, out.truncated.len())?;
        self.check_actions(actions)?;
        if self.rules.autoreset == Autoreset::Disabled {
            self.check_running()?;
        }
        let (share, rules) = (self.share, self.rules);
        let parts = self
            .shards
            .iter_mut()
            .zip(actions.chunks(share * ACTION))
            .zip(out.observations.chunks_mut(share * OBSERVATION).zip(out.rewards.chunks_mut(share)))
            .zip(out.terminated.chunks_mut(share).zip(out.truncated.chunks_mut(share)));
        self.team.each(parts, |(((shard, actions), (observations, rewards)), (terminated, truncated))| {
            shard.run(&rules, actions, Out { observations, rewards, terminated, truncated });
        });
        Ok(())
    }

    fn check_actions(&mut self, actions: &[f32]) -> Result<()> {
        let (share, bad) = (self.share * ACTION, AtomicUsize::new(usize::MAX));
        self.team.each(self.shards.iter_mut().zip(actions.chunks(share)).enumerate(), |(i, (shard, actions))| {
            if let Some(at) = shard.first_bad_action(actions) {
                bad.fetch_min(i * share + at, Ordering::Relaxed);
            }
        });
        match bad.into_inner() {
            usize::MAX => Ok(()),
            at => Err(Error::Action { env: at / ACTION, axis: at % ACTION, value: actions[at] }),
        }
    }

    fn check_running(&self) -> Result<()> {
        let ended = self.shards.iter().enumerate().find_map(|(i, shard)| Some(i * self.share + shard.first_ended()?));
        ended.map_or(Ok(()), |env| Err(Error::Ended { env }))
    }

    /// The true states, rows of [`STATE`]: position, velocity, roll pitch yaw, their rates.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn states(&self, out: &mut [f32]) -> Result<()> {
        shape("states", self.envs * STATE, out.len())?;
        for (shard, rows) in self.shards.iter().zip(out.chunks_mut(self.share * STATE)) {
            shard.states(rows);
        }
        Ok(())
    }

    /// The true states of the first environments, as many rows of [`STATE`] as `out` has room for.
    ///
    /// # Errors
    /// [`Error::Shape`] unless `out` is whole rows of environments that exist.
    pub fn first_states(&self, out: &mut [f32]) -> Result<()> {
        shape("states", (out.len() / STATE).min(self.envs) * STATE, out.len())?;
        for (shard, rows) in self.shards.iter().zip(out.chunks_mut(self.share * STATE)) {
            shard.states(rows);
        }
        Ok(())
    }

    /// With [`Autoreset::SameStep`]: last observation and true state of the episode that ended in the last step in environment `env`.
    pub fn last_of_episode(&self, env: usize) -> Option<(&[f32], &[f32])> {
        let shard = self.shards.get(env / self.share)?;
        shard.last_of_episode(env % self.share)
    }
}

/// A shard, whatever its number type.
trait Part: Send {
    fn reset(&mut self, interface: &Interface, first: usize, seeds: Option<&[u64]>, mask: Option<&[bool]>, observations: &mut [f32]);
    fn run(&mut self, rules: &Rules, actions: &[f32], out: Out<'_>);
    fn first_ended(&self) -> Option<usize>;
    fn first_bad_action(&self, actions: &[f32]) -> Option<usize>;
    fn states(&self, rows: &mut [f32]);
    fn last_of_episode(&self, env: usize) -> Option<(&[f32], &[f32])>;
}

impl Bits {
    fn new(left: usize) -> Self {
        Bits { ended: 0, used: if left >= LANES { u16::MAX } else { (1 << left) - 1 } }
    }
}

/// What a shard is made of, for the task that is asked for.
struct Whole<'a> {
    model: &'a Model,
    options: &'a Options,
    input: VerticalInput,
    envs: usize,
}

impl Whole<'_> {
    fn shard<R: Batched>(self) -> Result<Box<dyn Part>> {
        let (name, options) = (&self.options.task, &self.options.task_options);
        task::visit(name, options, Maker::<R> { whole: self, number: PhantomData })
    }
}

struct Maker<'a, R> {
    whole: Whole<'a>,
    number: PhantomData<R>,
}

impl<R: Batched> Visitor for Maker<'_, R> {
    type Out = Box<dyn Part>;
    fn visit<T: Task>(self, task: T) -> Result<Box<dyn Part>> {
        let Whole { model, options, input, envs } = self.whole;
        let tiles = envs.div_ceil(LANES);
        let settings = Settings { input, physics_hz: options.physics_hz };
        let kept = if options.autoreset == Autoreset::SameStep { envs } else { 0 };
        Ok(Box::new(Shard::<R, T> {
            world: World::new(model, &options.effects, settings, tiles)?,
            task,
            slots: vec![Slot { last_action: [R::zero(); ACTION], goal: [R::zero(); GOAL] }; tiles],
            bits: (0..tiles).map(|tile| Bits::new(envs - tile * LANES)).collect(),
            episodes: vec![Episodes { seed: [0; LANES], number: [0; LANES] }; tiles],
            final_observations: vec![0.0; kept * OBSERVATION],
            final_states: vec![0.0; kept * STATE],
        }))
    }
}

impl<R: Batched, T: Task> Part for Shard<R, T> {
    fn reset(&mut self, interface: &Interface, first: usize, seeds: Option<&[u64]>, mask: Option<&[bool]>, observations: &mut [f32]) {
        for (tile, rows) in observations.chunks_mut(LANES * OBSERVATION).enumerate() {
            let env = first + tile * LANES;
            let mut bits = 0;
            for lane in lanes_of(self.bits[tile].used.into()).filter(|lane| mask.is_none_or(|m| m[env + lane])) {
                bits |= 1 << lane;
                if let Some(seeds) = seeds {
                    let episodes = &mut self.episodes[tile];
                    (episodes.seed[lane], episodes.number[lane]) = (seeds[env + lane], 0);
                }
            }
            R::run(
                #[inline(always)]
                || self.begin(interface, tile, bits, rows),
            );
        }
    }

    fn run(&mut self, rules: &Rules, actions: &[f32], out: Out<'_>) {
        R::run(
            #[inline(always)]
            || self.run_now(rules, actions, out),
        );
    }

    fn first_ended(&self) -> Option<usize> {
        let tile = self.bits.iter().position(|bits| bits.ended != 0)?;
        Some(tile * LANES + self.bits[tile].ended.trailing_zeros() as usize)
    }

    fn first_bad_action(&self, actions: &[f32]) -> Option<usize> {
        R::run(
            #[inline(always)]
            || first_bad_action(actions),
        )
    }

    fn states(&self, rows: &mut [f32]) {
        for (tile, rows) in rows.chunks_mut(LANES * STATE).enumerate() {
            R::run(
                #[inline(always)]
                || write(&state_row(self.world.state(tile)), rows),
            );
        }
    }

    fn last_of_episode(&self, env: usize) -> Option<(&[f32], &[f32])> {
        let observation = self.final_observations.get(env * OBSERVATION..(env + 1) * OBSERVATION)?;
        Some((observation, self.final_states.get(env * STATE..(env + 1) * STATE)?))
    }
}

impl<R: Batched, T: Task> Shard<R, T> {
    /// Begin the next episode in the lanes of `bits` and write their observations.
    #[inline(always)]
    fn begin(&mut self, interface: &Interface, tile: usize, bits: u32, rows: &mut [f32]) {
        let (slot, episodes) = (&mut self.slots[tile], &mut self.episodes[tile]);
        let mut x = State::<R>::rest();
        let mut u = Command::level(R::zero());
        for lane in lanes_of(bits) {
            let key = episode_key(episodes.seed[lane], episodes.number[lane]);
            episodes.number[lane] += 1;
            let mut rng = Pcg64Mcg::seed_from_u64(key);
            self.world.draw_lane(tile, lane, key, &mut rng);
            let start = self.task.start(&mut rng);
            for i in 0..3 {
                x.pos_m[i].set_lane(lane, start.pos_m[i]);
            }
            x.att_rad[2].set_lane(lane, start.yaw_rad);
            for (slot, value) in slot.goal.iter_mut().zip(start.goal) {
                slot.set_lane(lane, value);
            }
            // in the air it has been hovering, on the floor the motors stand still
            let flying = if start.pos_m[2] > 0.0 { 1.0 } else { 0.0 };
            u.lift.set_lane(lane, if interface.input.is_pwm() { flying * interface.hover_lift } else { start.pos_m[2] });
        }
        self.bits[tile].ended &= !(bits as u16);
        let mask = R::mask(bits);
        for (last, new) in slot.last_action.iter_mut().zip(interface.action(&u)) {
            *last = R::select(mask, new, *last);
        }
        let reading = self.world.start(tile, mask, &x, &u);
        let now_s = self.world.time_s(tile);
        // the goals of lanes under way must not move on here
        let mut goal = slot.goal;
        let setpoint = self.task.setpoint(&mut goal, now_s, &self.world.draw(tile));
        for (kept, new) in slot.goal.iter_mut().zip(goal) {
            *kept = R::select(mask, new, *kept);
        }
        let row = observe(&reading, now_s, &setpoint, &slot.last_action);
        for lane in lanes_of(bits) {
            write_lane(&row, lane, &mut rows[lane * OBSERVATION..(lane + 1) * OBSERVATION]);
        }
    }

    /// One step of every tile.
    #[inline(always)]
    fn run_now(&mut self, rules: &Rules, actions: &[f32], out: Out<'_>) {
        let pace = Pace { reach: rules.interface.reach(), last_s: rules.last_s(self.world.tick_s()) };
        let mut rest = Rest::new(actions);
        let mut buffers = Buffers::new(actions, out, &mut rest);
        let tiles = self.bits.len();
        if self.world.is_plain() {
            for tile in 0..tiles {
                let action = R::read4(buffers.actions(tile));
                let tick = self.world.step_plain(tile, &pace.reach.command(&action));
                self.judge(rules, &pace, tile, &action, &tick, buffers.rows(tile));
            }
        } else {
            let mut actions = [[R::zero(); ACTION]; GROUP];
            let mut commands = [Command::level(R::zero()); GROUP];
            let mut ticks = [Tick::none(); GROUP];
            for first in (0..tiles).step_by(GROUP) {
                let n = GROUP.min(tiles - first);
                for i in 0..n {
                    actions[i] = R::read4(buffers.actions(first + i));
                    commands[i] = pace.reach.command(&actions[i]);
                }
                self.world.step_group(first, &commands[..n], None, &mut ticks[..n]);
                for i in 0..n {
                    self.judge(rules, &pace, first + i, &actions[i], &ticks[i], buffers.rows(first + i));
                }
            }
        }
        buffers.finish();
    }

    /// What comes of a tick: observation, reward, end.
    #[inline(always)]
    fn judge(&mut self, rules: &Rules, pace: &Pace<R>, tile: usize, action: &[R; ACTION], tick: &Tick<R>, out: Rows<'_>) {
        let now_s = self.world.time_s(tile);
        let slot = &mut self.slots[tile];
        let setpoint = self.task.setpoint(&mut slot.goal, now_s, &self.world.draw(tile));
        let situation =
            Situation { x: self.world.state(tile), setpoint, action, last_action: &slot.last_action, contact: &tick.contact, t_s: now_s };
        let verdict = self.task.judge(&situation);
        let over = now_s.gt(pace.last_s);
        slot.last_action = *action;
        R::write(&observe(&tick.reading, now_s, &setpoint, action), out.observations, OBSERVATION);
        *out.rewards = *verdict.reward.array();
        let (terminated, truncated) = (R::bits(verdict.terminated), R::bits(over));
        flags(terminated, out.terminated);
        flags(truncated, out.truncated);
        let bits = &mut self.bits[tile];
        let before = bits.ended;
        bits.ended = (terminated | truncated) as u16 & bits.used;
        if (before | bits.ended) != 0 {
            self.turn_over(rules, tile, before.into(), out);
        }
    }

    /// Episodes that ended: reset them as the mode says.
    #[cold]
    #[inline(never)]
    fn turn_over(&mut self, rules: &Rules, tile: usize, before: u32, out: Rows<'_>) {
        R::run(
            #[inline(always)]
            || self.turn_over_now(rules, tile, before, out),
        );
    }

    #[inline(always)]
    fn turn_over_now(&mut self, rules: &Rules, tile: usize, before: u32, out: Rows<'_>) {
        match rules.autoreset {
            Autoreset::Disabled => {}
            Autoreset::NextStep => {
                for lane in lanes_of(before) {
                    (out.rewards[lane], out.terminated[lane], out.truncated[lane]) = (0.0, false, false);
                }
                self.begin(&rules.interface, tile, before, out.observations);
            }
            Autoreset::SameStep => {
                let ended = u32::from(self.bits[tile].ended);
                let states = state_row(self.world.state(tile));
                for lane in lanes_of(ended) {
                    let env = tile * LANES + lane;
                    let row = &out.observations[lane * OBSERVATION..(lane + 1) * OBSERVATION];
                    self.final_observations[env * OBSERVATION..(env + 1) * OBSERVATION].copy_from_slice(row);
                    write_lane(&states, lane, &mut self.final_states[env * STATE..(env + 1) * STATE]);
                }
                self.begin(&rules.interface, tile, ended, out.observations);
            }
        }
    }
}

impl Rules {
    /// Past this an episode is over: half a step of margin, because the clock is in `f32`.
    #[inline(always)]
    fn last_s<R: Real>(&self, tick_s: f64) -> R {
        R::of(if self.max_episode_steps == 0 { f64::INFINITY } else { (f64::from(self.max_episode_steps) - 0.5) * tick_s })
    }
}

/// What every tile of a step needs of the rules, as numbers of the lanes.
struct Pace<R> {
    reach: Reach<R>,
    last_s: R,
}
