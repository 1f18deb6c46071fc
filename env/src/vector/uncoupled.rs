//! A part of the batch whose environments have one drone each: nothing couples it, and where nothing is
//! called in a step, all stays in registers.

use std::ops::Range;

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::buffers::{StepBuffers, TailBuffers, TileBuffers, TileRows};
use super::judgement::{Fault, Judgement, Verdict};
use super::observer::{Observer, RowPlace, Sight, row_width};
use super::{BatchConfig, Shard, ShardSpec};
use crate::action::{ACTION, ActionScale, Interface, Onboard};
use crate::archive::Archive;
use crate::config::Autoreset;
use crate::episode::{TickResult, TickVerdict, first_row, judge_tick, lift_before};
use crate::error::Result;
use crate::expression::Moment;
use crate::lanes::LANES;
use crate::noise::episode_key;
use crate::observation::OBSERVATION;
use crate::plant::{Command, State};
use crate::rows::{STATE, first_bad_action, flags, lanes_of, state_row, write, write_lane};
use crate::sim_scalar::BatchScalar;
use crate::task::{GOAL, Outline, Start, Task};
use crate::world::{GROUP, Settings, Tick, World};

/// What is remembered of a tile besides its world.
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

pub(super) struct UncoupledShard<R: BatchScalar, T> {
    world: World<R>,
    /// Turns actions that are no attitudes into commands.
    onboard: Option<Onboard<R>>,
    task: T,
    slots: Vec<Slot<R>>,
    /// What the task keeps of an episode besides the goal, tile by tile.
    boards: Vec<R>,
    /// The board of an episode that begins.
    begun: Vec<f64>,
    bits: Vec<Bits>,
    episodes: Vec<Episodes>,
    observer: Option<Observer<R>>,
    judgement: Option<Judgement>,
    /// Numbers of an observation.
    width: usize,
    /// Last observation and true state of episodes that ended in the last step, kept when the environment was
    /// reset in that step.
    final_observations: Vec<f32>,
    final_states: Vec<f32>,
}

impl Bits {
    fn new(left: usize) -> Self {
        Bits { ended: 0, used: if left >= LANES { u16::MAX } else { (1 << left) - 1 } }
    }
}

impl<R: BatchScalar, T: Task> Shard for UncoupledShard<R, T> {
    fn reset(
        &mut self,
        config: &BatchConfig,
        first: usize,
        seeds: Option<&[u64]>,
        mask: Option<&[bool]>,
        measured: &mut [f32],
        observations: &mut [f32],
    ) {
        let (rows, observed) =
            if self.observer.is_some() { (measured, observations) } else { (observations, measured) };
        for (tile, rows) in rows.chunks_mut(LANES * OBSERVATION).enumerate() {
            let env = first + tile * LANES;
            let mut bits = 0;
            for lane in
                lanes_of(self.bits[tile].used.into()).filter(|lane| mask.is_none_or(|m| m[env + lane]))
            {
                bits |= 1 << lane;
                if let Some(seeds) = seeds {
                    let episodes = &mut self.episodes[tile];
                    (episodes.seed[lane], episodes.number[lane]) = (seeds[env + lane], 0);
                }
            }
            R::run(
                #[inline(always)]
                || self.begin(&config.interfaces[0], tile, bits, rows, observed),
            );
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
        let flying = std::mem::take(&mut out.flying);
        let observed = if self.observer.is_some() {
            std::mem::replace(&mut out.observations, measured)
        } else {
            measured
        };
        R::run(
            #[inline(always)]
            || self.run_now(config, tiles.clone(), actions, observed, out),
        );
        for (flags, bits) in flying.chunks_mut(LANES).zip(&self.bits).take(tiles.end).skip(tiles.start) {
            flags.iter_mut().enumerate().for_each(|(lane, flag)| *flag = bits.ended >> lane & 1 == 0);
        }
    }

    fn tiles(&self) -> usize {
        self.bits.len()
    }

    fn ended(&self, tile: usize) -> u16 {
        self.bits[tile].ended
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
        let observation = self.final_observations.get(env * self.width..(env + 1) * self.width)?;
        Some((observation, self.final_states.get(env * STATE..(env + 1) * STATE)?))
    }

    fn outlines(&self, env: usize) -> Vec<Outline> {
        let size = self.begun.len();
        let board = &self.boards[env / LANES * size..][..size];
        let board: Vec<f64> = board.iter().map(|number| number.lane(env % LANES)).collect();
        self.task.outlines(&board)
    }

    fn loads(&self, _: &mut [f32]) -> bool {
        false
    }

    fn end(&mut self, drones: &[bool]) {
        for (bits, flags) in self.bits.iter_mut().zip(drones.chunks(LANES)) {
            for (lane, _) in flags.iter().enumerate().filter(|(_, ends)| **ends) {
                bits.ended |= 1 << lane;
            }
        }
    }

    fn watched(&self) -> &[f32] {
        self.judgement.as_ref().map_or(&[], Judgement::rows)
    }

    fn take_fault(&mut self) -> Option<Fault> {
        self.judgement.as_mut()?.take_fault()
    }

    fn archive(&mut self, tile: usize, archive: &mut Archive<'_>) {
        let (slot, bits, episodes) = (&mut self.slots[tile], &mut self.bits[tile], &mut self.episodes[tile]);
        archive.numbers(&mut slot.last_action);
        archive.numbers(&mut slot.goal);
        let size = self.begun.len();
        archive.numbers(&mut self.boards[tile * size..(tile + 1) * size]);
        archive.bits(&mut bits.ended, bits.used);
        archive.seeds(&mut episodes.seed);
        archive.words(&mut episodes.number);
        let key = |lane: usize| episode_key(episodes.seed[lane], episodes.number[lane].wrapping_sub(1));
        self.world.archive(tile, key, archive);
        if let Some(onboard) = &mut self.onboard {
            onboard.show_numbers(tile, archive);
        }
        if let Some(observer) = &mut self.observer {
            observer.archive(tile, archive);
        }
    }

    fn set_force(&mut self, force_n: Option<&[f32]>) {
        self.world.set_force(force_n, [0, 1]);
    }
}

impl<R: BatchScalar, T: Task> UncoupledShard<R, T> {
    pub(super) fn new(spec: &ShardSpec<'_>, task: T) -> Result<Self> {
        let ShardSpec { options, envs, .. } = *spec;
        let tiles = envs.div_ceil(LANES);
        let settings = Settings { input: spec.inputs[0], physics_hz: options.physics_hz };
        let kept = if options.autoreset == Autoreset::SameStep { envs } else { 0 };
        let width = row_width(options, 1)?;
        let mut world = World::new(spec.models[0], &options.drone_effects(0), settings, tiles)?;
        options.wind_field.as_ref().map_or(Ok(()), |field| world.set_wind(field))?;
        Ok(UncoupledShard {
            world: world.at_level(options.action),
            onboard: Onboard::new(spec.models[0], &spec.interfaces[0], spec.tick_s, tiles)?,
            boards: vec![R::zero(); tiles * task.board()],
            begun: vec![0.0; task.board()],
            task,
            slots: vec![Slot { last_action: [R::zero(); ACTION], goal: [R::zero(); GOAL] }; tiles],
            bits: (0..tiles).map(|tile| Bits::new(envs - tile * LANES)).collect(),
            episodes: vec![Episodes { seed: [0; LANES], number: [0; LANES] }; tiles],
            observer: Observer::new(spec, 1, T::SURROUNDED)?,
            judgement: Judgement::new(spec, 1)?,
            width,
            final_observations: vec![0.0; kept * width],
            final_states: vec![0.0; kept * STATE],
        })
    }

    /// Begin the next episode in the lanes of `bits` and write their observations.
    #[inline(always)]
    fn begin(
        &mut self,
        interface: &Interface,
        tile: usize,
        bits: u32,
        rows: &mut [f32],
        observed: &mut [f32],
    ) {
        let (slot, episodes) = (&mut self.slots[tile], &mut self.episodes[tile]);
        let mut x = State::<R>::rest();
        let mut u = Command::level(R::zero());
        for lane in lanes_of(bits) {
            let key = episode_key(episodes.seed[lane], episodes.number[lane]);
            episodes.number[lane] += 1;
            let mut rng = Pcg64Mcg::seed_from_u64(key);
            self.world.draw_lane(tile, lane, key, &mut rng);
            let mut start = Start { pos_m: [0.0; 3], yaw_rad: 0.0, goal: [0.0; GOAL] };
            self.task.start(&mut rng, std::slice::from_mut(&mut start), &mut self.begun);
            let size = self.begun.len();
            for (slot, value) in self.boards[tile * size..].iter_mut().zip(&self.begun) {
                slot.set_lane(lane, *value);
            }
            for i in 0..3 {
                x.pos_m[i].set_lane(lane, start.pos_m[i]);
            }
            x.att_rad[2].set_lane(lane, start.yaw_rad);
            for (slot, value) in slot.goal.iter_mut().zip(start.goal) {
                slot.set_lane(lane, value);
            }
            u.lift.set_lane(lane, lift_before(interface, start.pos_m[2]));
        }
        self.bits[tile].ended &= !(bits as u16);
        let mask = R::mask(bits);
        for (last, new) in slot.last_action.iter_mut().zip(interface.action_before(&x, &u)) {
            *last = R::select(mask, new, *last);
        }
        if let Some(onboard) = &mut self.onboard {
            onboard.start(tile, mask);
        }
        let reading = self.world.start(tile, mask, &x, &u);
        // the goals of lanes under way must not move on here
        let mut goal = slot.goal;
        let size = self.begun.len();
        let board = &self.boards[tile * size..(tile + 1) * size];
        let row = first_row(&self.task, &self.world, tile, &mut goal, board, (&reading, &slot.last_action));
        for (kept, new) in slot.goal.iter_mut().zip(goal) {
            *kept = R::select(mask, new, *kept);
        }
        for lane in lanes_of(bits) {
            write_lane(&row, lane, &mut rows[lane * OBSERVATION..(lane + 1) * OBSERVATION]);
        }
        if let Some(observer) = &mut self.observer {
            let place = RowPlace { tile, drone: 0, lanes: bits, flying: bits, begins: true };
            let x = self.world.state(tile);
            let surroundings = self.task.surroundings(&x.pos_m, &slot.goal, board);
            observer.write(place, &Sight { own: &row, x, rows: &[], surroundings }, observed);
        }
    }

    /// One step of every tile.
    #[inline(always)]
    fn run_now(
        &mut self,
        config: &BatchConfig,
        tiles: Range<usize>,
        actions: &[f32],
        observed: &mut [f32],
        out: StepBuffers<'_>,
    ) {
        let params = StepParams { reach: config.interfaces[0].reach(), last_s: R::from_f64(config.last_s) };
        let mut tail = TailBuffers::new(actions);
        let mut buffers = TileBuffers::new(actions, observed, out, &mut tail);
        let ends = tiles.end == self.bits.len();
        if self.world.is_plain() && self.onboard.is_none() {
            for tile in tiles {
                let action = R::read4(buffers.actions(tile));
                let tick = self.world.step_plain(tile, &params.reach.command(&action));
                self.judge(config, &params, tile, &action, &tick, buffers.rows(tile));
            }
        } else {
            let mut actions = [[R::zero(); ACTION]; GROUP];
            let mut commands = [Command::level(R::zero()); GROUP];
            let mut ticks = [Tick::none(); GROUP];
            for first in tiles.clone().step_by(GROUP) {
                let n = GROUP.min(tiles.end - first);
                for i in 0..n {
                    actions[i] = R::read4(buffers.actions(first + i));
                    commands[i] = match &mut self.onboard {
                        None => params.reach.command(&actions[i]),
                        Some(onboard) => onboard.command(first + i, &actions[i], self.world.state(first + i)),
                    };
                }
                self.world.step_group(first, &commands[..n], None, &mut ticks[..n]);
                for i in 0..n {
                    let out = buffers.rows(first + i);
                    self.judge(config, &params, first + i, &actions[i], &ticks[i], out);
                }
            }
        }
        // the last tile's results, where it was among these
        if ends {
            buffers.finish();
        }
    }

    /// What comes of a tick: observation, reward, end.
    #[inline(always)]
    fn judge(
        &mut self,
        config: &BatchConfig,
        params: &StepParams<R>,
        tile: usize,
        action: &[R; ACTION],
        tick: &Tick<R>,
        out: TileRows<'_>,
    ) {
        let slot = &mut self.slots[tile];
        let size = self.begun.len();
        let board = &self.boards[tile * size..(tile + 1) * size];
        let result = TickResult { tile, action, last_action: &slot.last_action, tick };
        let TickVerdict { setpoint, row, mut reward, arrived, mut ends, broken, now_s } =
            judge_tick(&self.task, &self.world, &mut slot.goal, board, &result);
        let x = self.world.state(tile);
        let over = now_s.gt(params.last_s);
        if let Some(judgement) = &mut self.judgement {
            let moment = Moment {
                own: &row,
                x,
                setpoint: &setpoint,
                last_action: &slot.last_action,
                impact_mps: tick.contact.impact_mps,
                now_s,
                broken,
                arrived,
                task_reward: reward,
            };
            let bits = self.bits[tile];
            let mut verdict = Verdict { reward, ends };
            judgement.decide(tile, 0, (bits.used & !bits.ended).into(), &moment, &mut verdict);
            (reward, ends) = (verdict.reward, verdict.ends);
        }
        slot.last_action = *action;
        R::write(&row, out.observations, OBSERVATION);
        if let Some(observer) = &mut self.observer {
            let used = self.bits[tile].used.into();
            let place = RowPlace { tile, drone: 0, lanes: used, flying: used, begins: false };
            let surroundings = self.task.surroundings(&x.pos_m, &slot.goal, board);
            observer.write(place, &Sight { own: &row, x, rows: &[], surroundings }, out.observed);
        }
        *out.rewards = *reward.array();
        let (terminated, truncated) = (R::bits(ends | broken), R::bits(over));
        flags(terminated, out.terminated);
        flags(truncated, out.truncated);
        let bits = &mut self.bits[tile];
        let before = bits.ended;
        bits.ended = (terminated | truncated) as u16 & bits.used;
        if (before | bits.ended) != 0 {
            self.turn_over(config, tile, before.into(), out);
        }
    }

    /// Episodes that ended: reset them as the mode says.
    #[cold]
    #[inline(never)]
    fn turn_over(&mut self, config: &BatchConfig, tile: usize, before: u32, out: TileRows<'_>) {
        R::run(
            #[inline(always)]
            || self.turn_over_now(config, tile, before, out),
        );
    }

    #[inline(always)]
    fn turn_over_now(&mut self, config: &BatchConfig, tile: usize, before: u32, out: TileRows<'_>) {
        match config.autoreset {
            Autoreset::Disabled => self.stand_still(tile, before, out),
            Autoreset::NextStep => {
                for lane in lanes_of(before) {
                    (out.rewards[lane], out.terminated[lane], out.truncated[lane]) = (0.0, false, false);
                }
                self.begin(&config.interfaces[0], tile, before, out.observations, out.observed);
            }
            Autoreset::SameStep => {
                let ended = u32::from(self.bits[tile].ended);
                let states = state_row(self.world.state(tile));
                for lane in lanes_of(ended) {
                    let env = tile * LANES + lane;
                    let numbers = env * self.width..(env + 1) * self.width;
                    let row = if self.observer.is_some() {
                        &out.observed[numbers.clone()]
                    } else {
                        &out.observations[lane * OBSERVATION..(lane + 1) * OBSERVATION]
                    };
                    self.final_observations[numbers].copy_from_slice(row);
                    write_lane(&states, lane, &mut self.final_states[env * STATE..(env + 1) * STATE]);
                }
                self.begin(&config.interfaces[0], tile, ended, out.observations, out.observed);
            }
        }
    }
}

impl<R: BatchScalar, T> UncoupledShard<R, T> {
    /// Ended episodes have no more results, until they are reset.
    fn stand_still(&mut self, tile: usize, ended: u32, out: TileRows<'_>) {
        self.bits[tile].ended |= ended as u16;
        for lane in lanes_of(ended) {
            (out.rewards[lane], out.terminated[lane], out.truncated[lane]) = (0.0, false, false);
            out.observations[lane * OBSERVATION..(lane + 1) * OBSERVATION].fill(0.0);
            if self.observer.is_some() {
                let env = tile * LANES + lane;
                out.observed[env * self.width..(env + 1) * self.width].fill(0.0);
            }
        }
    }
}

/// What every tile of a step needs of the configuration, as numbers of the lanes.
struct StepParams<R> {
    reach: ActionScale<R>,
    last_s: R,
}
