//! A batch of environments: caller-owned buffers in and out, automatic resets, nothing allocated per step.
//!
//! Environment `i` is the same whatever the size of the batch: an episode is a function of its seed, its number and its actions.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use crate::config::{Autoreset, Options};
use crate::error::{Error, Result};
use crate::isa::{Kind, Level};
use crate::lanes::{LANES, Lanes};
use crate::model::{Model, VerticalInput};
use crate::noise::episode_key;
use crate::observation::{ACTION, Interface, OBSERVATION, Setpoint, observe};
use crate::plant::{Command, State};
use crate::real::Real;
use crate::schedule::Schedule;
use crate::simulated::Batched;
use crate::task::{self, GOAL, Judge, Situation};
use crate::world::{Settings, World};

/// Numbers per true state: position, velocity, attitude, rates.
pub const STATE: usize = 12;

/// # Errors
/// [`Error::Shape`] unless `got == want`.
pub(crate) fn shape(what: &'static str, want: usize, got: usize) -> Result<()> {
    if want == got { Ok(()) } else { Err(Error::Shape { what, want: format!("{want} numbers"), got: got.to_string() }) }
}

/// The caller's buffers for the results of a step, one row per environment.
#[derive(Debug)]
pub struct Out<'a> {
    /// Rows of [`OBSERVATION`].
    pub observations: &'a mut [f32],
    pub rewards: &'a mut [f32],
    pub terminated: &'a mut [bool],
    pub truncated: &'a mut [bool],
}

/// What the vector environment remembers of a tile besides its world.
#[derive(Debug, Clone)]
struct Slot<R> {
    goal: [R; GOAL],
    last_action: [R; ACTION],
    seed: [u64; LANES],
    episode: [u64; LANES],
    /// Bit per lane: the episode has ended.
    ended: u32,
    /// Bit per lane: an environment of the batch (the last tile may have fewer than sixteen).
    used: u32,
}

/// A contiguous part of the batch with a world of its own, stepped by one thread.
struct Shard<R: Batched> {
    world: World<R>,
    judge: Box<dyn Judge<R>>,
    slots: Vec<Slot<R>>,
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
    pool: Option<rayon::ThreadPool>,
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
        let build = match level.kind() {
            Kind::Baseline => Shard::<Lanes>::boxed,
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => Shard::<crate::lanes_avx2::Lanes>::boxed,
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => Shard::<crate::lanes_avx512::Lanes>::boxed,
        };
        let starts = (0..envs).step_by(share);
        let shards = starts.map(|first| build(model, options, input, share.min(envs - first))).collect::<Result<Vec<_>>>()?;
        let pool = match shards.len() {
            1 => None,
            n => Some(rayon::ThreadPoolBuilder::new().num_threads(n).build().map_err(|e| Error::Config(e.to_string()))?),
        };
        let interface = Interface::of(model, input)?;
        let rules = Rules { interface, autoreset: options.autoreset, max_episode_steps: options.max_episode_steps, level };
        let tick_s = Schedule::of(model)?.tick_s();
        Ok(VectorEnv { shards, rules, envs, share, pool, ready: false, tick_s })
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
        for (i, (shard, rows)) in self.shards.iter().zip(actions.chunks(self.share * ACTION)).enumerate() {
            if let Some(at) = shard.first_bad_action(rows) {
                let value = rows[at];
                return Err(Error::Action { env: i * self.share + at / ACTION, axis: at % ACTION, value });
            }
        }
        if self.rules.autoreset == Autoreset::Disabled {
            self.check_running()?;
        }
        let (share, rules) = (self.share, self.rules);
        let Some(pool) = &self.pool else {
            self.shards[0].run(&rules, actions, out);
            return Ok(());
        };
        let shards = &mut self.shards;
        pool.install(|| {
            shards
                .par_iter_mut()
                .zip(actions.par_chunks(share * ACTION))
                .zip(out.observations.par_chunks_mut(share * OBSERVATION))
                .zip(out.rewards.par_chunks_mut(share))
                .zip(out.terminated.par_chunks_mut(share).zip(out.truncated.par_chunks_mut(share)))
                .for_each(|((((shard, actions), observations), rewards), (terminated, truncated))| {
                    shard.run(&rules, actions, Out { observations, rewards, terminated, truncated });
                });
        });
        Ok(())
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

#[inline(always)]
fn state_row<R: Real>(x: &State<R>) -> [R; STATE] {
    let ([a, b, c], [d, e, f], [g, h, i], [j, k, l]) = (x.pos_m, x.vel_mps, x.att_rad, x.rate_radps);
    [a, b, c, d, e, f, g, h, i, j, k, l]
}

/// The first action that is not a number from -1 to 1. Blocks without an early exit, so that the pass is vectorised.
#[inline(always)]
fn first_bad_action(actions: &[f32]) -> Option<usize> {
    let good = |a: &f32| a.abs() <= 1.0;
    let bad = actions.chunks(256).position(|block| !block.iter().fold(true, |all, a| all & good(a)))?;
    actions[bad * 256..].iter().position(|a| !good(a)).map(|i| bad * 256 + i)
}

impl<R: Real> Slot<R> {
    fn new(left: usize) -> Self {
        let used = if left >= LANES { u32::from(u16::MAX) } else { (1 << left) - 1 };
        Slot { goal: [R::zero(); GOAL], last_action: [R::zero(); ACTION], seed: [0; LANES], episode: [0; LANES], ended: 0, used }
    }
}

/// Lanes as rows: as many as `rows` has room for.
#[inline(always)]
fn write<R: Batched, const N: usize>(values: &[R; N], rows: &mut [f32]) {
    if rows.len() == LANES * N {
        return R::write(values, rows);
    }
    for (lane, row) in rows.chunks_exact_mut(N).enumerate() {
        write_lane(values, lane, row);
    }
}

/// One lane as a row.
#[inline(always)]
fn write_lane<R: Batched, const N: usize>(values: &[R; N], lane: usize, row: &mut [f32]) {
    for (slot, value) in row.iter_mut().zip(values) {
        *slot = value.array()[lane];
    }
}

/// Rows of actions as lanes; those that a last tile lacks are zero.
#[inline(always)]
fn read<R: Batched>(rows: &[f32]) -> [R; ACTION] {
    if rows.len() == LANES * ACTION {
        return R::read4(rows);
    }
    let mut whole = [0.0; LANES * ACTION];
    whole[..rows.len()].copy_from_slice(rows);
    R::read4(&whole)
}

/// Bits as truth values; mostly there are none.
#[inline(always)]
fn flags(bits: u32, out: &mut [bool]) {
    out.fill(false);
    if bits != 0 {
        for (lane, flag) in out.iter_mut().enumerate() {
            *flag = bits >> lane & 1 == 1;
        }
    }
}

/// The lanes whose bit is set.
fn lanes_of(bits: u32) -> impl Iterator<Item = usize> {
    (0..LANES).filter(move |lane| bits >> lane & 1 == 1)
}

impl<R: Batched> Part for Shard<R> {
    fn reset(&mut self, interface: &Interface, first: usize, seeds: Option<&[u64]>, mask: Option<&[bool]>, observations: &mut [f32]) {
        for (tile, rows) in observations.chunks_mut(LANES * OBSERVATION).enumerate() {
            let env = first + tile * LANES;
            let slot = &mut self.slots[tile];
            let mut bits = 0;
            for lane in lanes_of(slot.used).filter(|lane| mask.is_none_or(|m| m[env + lane])) {
                bits |= 1 << lane;
                if let Some(seeds) = seeds {
                    (slot.seed[lane], slot.episode[lane]) = (seeds[env + lane], 0);
                }
            }
            R::run(
                #[inline(always)]
                || self.begin(interface, tile, bits, rows),
            );
        }
    }

    fn run(&mut self, rules: &Rules, actions: &[f32], out: Out<'_>) {
        let rows = actions.chunks(LANES * ACTION).zip(out.observations.chunks_mut(LANES * OBSERVATION));
        let flags = out.terminated.chunks_mut(LANES).zip(out.truncated.chunks_mut(LANES));
        for (tile, (((actions, observations), rewards), (terminated, truncated))) in
            rows.zip(out.rewards.chunks_mut(LANES)).zip(flags).enumerate()
        {
            let out = Out { observations, rewards, terminated, truncated };
            R::run(
                #[inline(always)]
                || self.step(rules, tile, actions, out),
            );
        }
    }

    fn first_ended(&self) -> Option<usize> {
        let tile = self.slots.iter().position(|slot| slot.ended != 0)?;
        Some(tile * LANES + self.slots[tile].ended.trailing_zeros() as usize)
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

impl<R: Batched> Shard<R> {
    fn boxed(model: &Model, options: &Options, input: VerticalInput, envs: usize) -> Result<Box<dyn Part>> {
        let tiles = envs.div_ceil(LANES);
        let settings = Settings { input, physics_hz: options.physics_hz };
        let kept = if options.autoreset == Autoreset::SameStep { envs } else { 0 };
        Ok(Box::new(Shard::<R> {
            world: World::new(model, &options.effects, settings, tiles)?,
            judge: R::judge(task::find(&options.task)?, &options.task_options)?,
            slots: (0..tiles).map(|tile| Slot::new(envs - tile * LANES)).collect(),
            final_observations: vec![0.0; kept * OBSERVATION],
            final_states: vec![0.0; kept * STATE],
        }))
    }

    /// Begin the next episode in the lanes of `bits` and write their observations.
    #[inline(always)]
    fn begin(&mut self, interface: &Interface, tile: usize, bits: u32, rows: &mut [f32]) {
        let slot = &mut self.slots[tile];
        let mut x = State::<R>::rest();
        let mut u = Command::level(R::zero());
        for lane in lanes_of(bits) {
            let key = episode_key(slot.seed[lane], slot.episode[lane]);
            slot.episode[lane] += 1;
            let mut rng = Pcg64Mcg::seed_from_u64(key);
            self.world.draw_lane(tile, lane, key, &mut rng);
            let start = self.judge.start(&mut rng);
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
        slot.ended &= !bits;
        let mask = R::mask(bits);
        for (last, new) in slot.last_action.iter_mut().zip(interface.action(&u)) {
            *last = R::select(mask, new, *last);
        }
        self.world.start(tile, mask, &x, &u);
        let now_s = self.world.time_s(tile);
        // the goals of lanes under way must not move on here
        let mut goal = slot.goal;
        let setpoint = self.judge.setpoint(&mut goal, now_s, &self.world.draw(tile));
        for (kept, new) in slot.goal.iter_mut().zip(goal) {
            *kept = R::select(mask, new, *kept);
        }
        let row = self.world.reading(
            tile,
            #[inline(always)]
            |y| observe(y, now_s, &setpoint, &slot.last_action),
        );
        for lane in lanes_of(bits) {
            write_lane(&row, lane, &mut rows[lane * OBSERVATION..(lane + 1) * OBSERVATION]);
        }
    }

    /// One step of one tile.
    #[inline(always)]
    fn step(&mut self, rules: &Rules, tile: usize, actions: &[f32], out: Out<'_>) {
        let action: [R; ACTION] = read(actions);
        let contact = self.world.step(tile, &rules.interface.command(&action));
        let now_s = self.world.time_s(tile);
        let slot = &mut self.slots[tile];
        let mut situation = Situation {
            x: self.world.state(tile),
            setpoint: Setpoint::origin(),
            action: &action,
            last_action: &slot.last_action,
            contact: &contact,
            t_s: now_s,
        };
        let verdict = self.judge.judge(&mut slot.goal, &self.world.draw(tile), &mut situation);
        let setpoint = situation.setpoint;
        // half a step of margin: the clock is in f32
        let last_s = (f64::from(rules.max_episode_steps) - 0.5) * self.world.tick_s();
        let over = if rules.max_episode_steps == 0 { R::nothing() } else { now_s.gt(R::of(last_s)) };
        slot.last_action = action;
        self.world.reading(
            tile,
            #[inline(always)]
            |y| write(&observe(y, now_s, &setpoint, &action), &mut *out.observations),
        );
        let (terminated, truncated) = (R::bits(verdict.terminated), R::bits(over));
        let rewards = verdict.reward.array();
        if out.rewards.len() == LANES {
            out.rewards.copy_from_slice(rewards)
        } else {
            out.rewards.copy_from_slice(&rewards[..out.rewards.len()])
        }
        flags(terminated, out.terminated);
        flags(truncated, out.truncated);
        let before = slot.ended;
        slot.ended = (terminated | truncated) & slot.used;
        if (before | slot.ended) != 0 {
            self.turn_over(rules, tile, before, out);
        }
    }

    /// Episodes that ended: reset them as the mode says.
    #[cold]
    #[inline(never)]
    fn turn_over(&mut self, rules: &Rules, tile: usize, before: u32, out: Out<'_>) {
        R::run(
            #[inline(always)]
            || self.turn_over_now(rules, tile, before, out),
        );
    }

    #[inline(always)]
    fn turn_over_now(&mut self, rules: &Rules, tile: usize, before: u32, out: Out<'_>) {
        match rules.autoreset {
            Autoreset::Disabled => {}
            Autoreset::NextStep => {
                for lane in lanes_of(before) {
                    (out.rewards[lane], out.terminated[lane], out.truncated[lane]) = (0.0, false, false);
                }
                self.begin(&rules.interface, tile, before, out.observations);
            }
            Autoreset::SameStep => {
                let ended = self.slots[tile].ended;
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
