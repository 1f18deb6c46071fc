//! A thread's part of the batch: episodes, and the rows of their environments around them.

use std::ops::Range;

use super::buffers::StepBuffers;
use super::judgement::{Fault, Judgement};
use super::observer::{Observer, row_width};
use super::row_sink::{EpisodeStats, RowSink};
use super::{BatchConfig, Shard, ShardSpec};
use crate::action::ACTION;
use crate::archive::Archive;
use crate::config::Autoreset;
use crate::coupling::NEIGHBOUR;
use crate::episode::{Commander, Coupling, Drone, Episode, FlightPlan, Flights, Starts};
use crate::error::Result;
use crate::lanes::LANES;
use crate::noise::episode_key;
use crate::observation::OBSERVATION;
use crate::rows::{STATE, first_bad_action, lanes_of, state_row, write, write_lane};
use crate::sim_scalar::BatchScalar;
use crate::task::{Outline, Task};
use crate::world::World;

/// Episodes of some environments: `C` couples the drones of each.
pub(super) struct EpisodeShard<R: BatchScalar, T, C: Coupling<R>> {
    episode: Episode<R, T, C>,
    starts: Starts<R>,
    book: Book<R>,
}

/// Records of a part of the batch besides its episodes.
pub(super) struct Book<R: BatchScalar> {
    pub(super) envs: usize,
    pub(super) drones: usize,
    /// Numbers of an observation.
    width: usize,
    pub(super) bits: Vec<Bits>,
    seeds: Vec<EpisodeSeeds>,
    /// One for each tile whose drones meet; empty where they are alone.
    pub(super) stats: Vec<EpisodeStats<R>>,
    pub(super) observer: Option<Observer<R>>,
    pub(super) judgement: Option<Judgement>,
    /// Rows of one drone in a tile, which are put together in the cache.
    pub(super) near: Vec<f32>,
    /// Last observation and true state of episodes that ended in the last step, kept when the environment was
    /// reset in that step.
    final_observations: Vec<f32>,
    final_states: Vec<f32>,
}

/// A bit per environment of a tile.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bits {
    /// The episode has ended.
    pub(super) ended: u16,
    /// It had ended before the last step.
    pub(super) before: u16,
    /// An environment of the batch (the last tile may have fewer than sixteen).
    pub(super) used: u16,
}

/// Seed and number of a tile's episodes; kept apart because only the ends of episodes need them.
#[derive(Debug, Clone)]
struct EpisodeSeeds {
    seed: [u64; LANES],
    number: [u64; LANES],
}

impl EpisodeSeeds {
    /// The noise key of the episode that is under way.
    fn key(&self, lane: usize) -> u64 {
        episode_key(self.seed[lane], self.number[lane].wrapping_sub(1))
    }
}

impl<R: BatchScalar> Book<R> {
    fn new(spec: &ShardSpec<'_>, drones: usize, alone: bool, surrounded: bool) -> Result<Self> {
        let ShardSpec { plan: FlightPlan { options, tiles, .. }, envs } = *spec;
        let used = |tile: usize| match envs - tile * LANES {
            left if left >= LANES => u16::MAX,
            left => (1 << left) - 1,
        };
        let kept = if options.autoreset == Autoreset::SameStep { envs * drones } else { 0 };
        let width = row_width(options, drones)?;
        Ok(Book {
            envs,
            drones,
            width,
            bits: (0..tiles).map(|tile| Bits { ended: 0, before: 0, used: used(tile) }).collect(),
            seeds: vec![EpisodeSeeds { seed: [0; LANES], number: [0; LANES] }; tiles],
            stats: vec![EpisodeStats::none(); if alone { 0 } else { tiles }],
            observer: Observer::new(spec, drones, surrounded)?,
            judgement: Judgement::new(spec, drones)?,
            near: vec![0.0; LANES * (OBSERVATION + NEIGHBOUR * (drones - 1))],
            final_observations: vec![0.0; kept * width],
            final_states: vec![0.0; kept * STATE],
        })
    }
}

/// Actions of a caller, a row for each drone, environment by environment.
struct ActionRows<'a> {
    rows: &'a [f32],
    envs: usize,
    drones: usize,
}

impl<R: BatchScalar> Commander<R> for ActionRows<'_> {
    #[inline(always)]
    fn action(&self, tile: usize, own: usize, _: &Drone<R>) -> [R; ACTION] {
        let first = tile * LANES * ACTION;
        match self.rows.get(first..first + LANES * ACTION) {
            Some(rows) if self.drones == 1 => R::read4(rows),
            _ => self.gather(tile, own),
        }
    }
}

impl ActionRows<'_> {
    /// A drone's actions in sixteen environments; none where there are no more environments.
    // apart, so that it does not weigh on drones that are alone
    #[inline(never)]
    fn gather<R: BatchScalar>(&self, tile: usize, own: usize) -> [R; ACTION] {
        R::run(
            #[inline(always)]
            || self.gather_now(tile, own),
        )
    }

    #[inline(always)]
    fn gather_now<R: BatchScalar>(&self, tile: usize, own: usize) -> [R; ACTION] {
        let mut rows = [0.0; LANES * ACTION];
        let first = tile * LANES;
        for (lane, row) in rows.chunks_exact_mut(ACTION).take(self.envs - first).enumerate() {
            let start = ((first + lane) * self.drones + own) * ACTION;
            row.copy_from_slice(&self.rows[start..start + ACTION]);
        }
        R::read4(&rows)
    }
}

impl<R: BatchScalar, T: Task, C: Coupling<R>> EpisodeShard<R, T, C> {
    pub(super) fn new(spec: &ShardSpec<'_>, task: T) -> Result<Self> {
        let FlightPlan { models, options, tiles, .. } = spec.plan;
        let (drones, board) = (models.len(), task.board());
        let episode = Episode::new(task, spec.plan, &mut |own, settings| {
            let mut world = World::new(models[own], &options.drone_effects(own), settings, tiles)?;
            options.wind_field.as_ref().map_or(Ok(()), |field| world.set_wind(field))?;
            Ok(world)
        })?;
        Ok(EpisodeShard {
            starts: Starts::origin(drones, board),
            episode,
            book: Book::new(spec, drones, C::ALONE, T::SURROUNDED)?,
        })
    }

    /// Begins the next episode in the environments of `bits`, and writes the first rows.
    #[inline(never)]
    fn begin(&mut self, tile: usize, bits: u32, rows: &mut [f32], observed: &mut [f32]) {
        let EpisodeShard { episode, starts, book } = self;
        for lane in lanes_of(bits) {
            book.seeds[tile].number[lane] += 1;
            episode.draw(tile, lane, book.seeds[tile].key(lane), starts);
        }
        book.bits[tile].ended &= !(bits as u16);
        if let Some(stats) = book.stats.get_mut(tile) {
            *stats = stats.begun(R::mask(bits));
        }
        let out = StepBuffers::none();
        R::run(
            #[inline(always)]
            || episode.begin(tile, R::mask(bits), starts, &mut RowSink::new(book, rows, observed, out)),
        );
    }

    /// Resets environments that ended, in this step or before, according to the mode.
    #[cold]
    #[inline(never)]
    fn reset_ended(&mut self, config: &BatchConfig, tile: usize, rows: StepRows<'_, '_>) {
        let Bits { ended, before, .. } = self.book.bits[tile];
        let StepRows { own, observed, out } = rows;
        let again = match config.autoreset {
            // drones that meet have rows of zeros by now, since none of them flies
            Autoreset::Disabled if C::ALONE => {
                self.book.bits[tile].ended |= before;
                return self.book.clear(tile, before.into(), [own, observed], out);
            }
            Autoreset::Disabled => return,
            Autoreset::NextStep => {
                self.book.clear(tile, before.into(), [&mut [], &mut []], out);
                before
            }
            Autoreset::SameStep => {
                let EpisodeShard { episode, book, .. } = &mut *self;
                let last: &[f32] = if book.observer.is_some() { observed } else { own };
                book.keep_last(&episode.flights, tile, ended.into(), last);
                ended
            }
        };
        self.begin(tile, again.into(), own, observed);
        let n = self.book.drones;
        for lane in lanes_of(again.into()).filter(|_| !C::ALONE) {
            let env = (tile * LANES + lane) * n;
            out.flying[env..env + n].fill(true);
        }
    }
}

/// The rows of a step: each drone's own numbers, what an observer writes, and the rest.
struct StepRows<'a, 'b> {
    own: &'a mut [f32],
    observed: &'a mut [f32],
    out: &'a mut StepBuffers<'b>,
}

impl<R: BatchScalar> Book<R> {
    /// Writes zeros for the environments of `bits`, also over the given rows.
    fn clear(&mut self, tile: usize, bits: u32, rows: [&mut [f32]; 2], out: &mut StepBuffers<'_>) {
        let n = self.drones;
        let [own, observed] = rows;
        for lane in lanes_of(bits) {
            let drones = (tile * LANES + lane) * n..(tile * LANES + lane + 1) * n;
            out.rewards[drones.clone()].fill(0.0);
            out.terminated[drones.clone()].fill(false);
            out.truncated[drones.clone()].fill(false);
            for (rows, width) in [(&mut *own, self.near.len() / LANES), (&mut *observed, self.width)] {
                if !rows.is_empty() {
                    rows[drones.start * width..drones.end * width].fill(0.0);
                }
            }
        }
    }

    /// Keeps the last observations and true states of the environments of `bits`.
    fn keep_last<C: Coupling<R>>(
        &mut self,
        flights: &Flights<R, C>,
        tile: usize,
        bits: u32,
        observations: &[f32],
    ) {
        let (n, size) = (self.drones, self.drones * self.width);
        for lane in lanes_of(bits) {
            let env = tile * LANES + lane;
            let rows = env * size..(env + 1) * size;
            self.final_observations[rows.clone()].copy_from_slice(&observations[rows]);
            for own in 0..n {
                let row = &mut self.final_states[(env * n + own) * STATE..][..STATE];
                write_lane(&state_row(flights.state(tile, own)), lane, row);
            }
        }
    }

    /// Writes the true states.
    fn write_states<C: Coupling<R>>(&self, flights: &Flights<R, C>, rows: &mut [f32]) {
        let n = self.drones;
        for (tile, rows) in rows.chunks_mut(LANES * n * STATE).enumerate() {
            if n == 1 {
                R::run(
                    #[inline(always)]
                    || write(&state_row(flights.state(tile, 0)), rows),
                );
                continue;
            }
            for (i, row) in rows.chunks_exact_mut(STATE).enumerate() {
                write_lane(&state_row(flights.state(tile, i % n)), i / n, row);
            }
        }
    }

    /// Ends the flights of `drones`.
    fn end<C: Coupling<R>>(&mut self, flights: &mut Flights<R, C>, drones: &[bool]) {
        let (n, coupling) = (self.drones, &mut flights.coupling);
        for (tile, bits) in self.bits.iter_mut().enumerate() {
            let mut flying = 0;
            for own in 0..n {
                let flags = drones.iter().skip(tile * LANES * n + own).step_by(n);
                let ends =
                    flags.take(LANES).enumerate().fold(0, |bits, (lane, end)| bits | u32::from(*end) << lane);
                let flies = R::bits(coupling.flies(tile, own)) & !ends;
                coupling.set_flies(tile, own, R::mask(flies));
                flying |= flies as u16;
            }
            // a drone that is alone flies until its episode has ended
            bits.ended = (bits.ended | !flying) & bits.used;
        }
    }

    /// Writes or reads everything that a tile goes on from.
    fn archive<C: Coupling<R>>(
        &mut self,
        flights: &mut Flights<R, C>,
        tile: usize,
        archive: &mut Archive<'_>,
    ) {
        let (bits, seeds) = (&mut self.bits[tile], &mut self.seeds[tile]);
        archive.bits(&mut bits.ended, bits.used);
        archive.seeds(&mut seeds.seed);
        archive.words(&mut seeds.number);
        if let Some(stats) = self.stats.get_mut(tile) {
            stats.numbers().into_iter().for_each(|number| archive.number(number));
        }
        flights.archive(tile, |lane| seeds.key(lane), archive);
        flights.coupling.archive(tile, bits.used, archive);
        if let Some(observer) = &mut self.observer {
            observer.archive(tile, archive);
        }
    }
}

/// Writes the places of the loads; false where there are none.
fn write_loads<R: BatchScalar, C: Coupling<R>>(flights: &Flights<R, C>, rows: &mut [f32]) -> bool {
    for (env, row) in rows.chunks_exact_mut(3).enumerate() {
        let Some(load) = flights.coupling.load(env / LANES) else { return false };
        write_lane(&load.pos_m, env % LANES, row);
    }
    true
}

impl<R: BatchScalar, T: Task, C: Coupling<R>> Shard for EpisodeShard<R, T, C> {
    fn reset(
        &mut self,
        first: usize,
        seeds: Option<&[u64]>,
        mask: Option<&[bool]>,
        measured: &mut [f32],
        observations: &mut [f32],
    ) {
        let (own, observed) =
            if self.book.observer.is_some() { (measured, observations) } else { (observations, measured) };
        for tile in 0..self.tiles() {
            let (env, mut bits) = (first + tile * LANES, 0);
            for lane in
                lanes_of(self.book.bits[tile].used.into()).filter(|lane| mask.is_none_or(|m| m[env + lane]))
            {
                bits |= 1 << lane;
                if let Some(seeds) = seeds {
                    let episodes = &mut self.book.seeds[tile];
                    (episodes.seed[lane], episodes.number[lane]) = (seeds[env + lane], 0);
                }
            }
            self.begin(tile, bits, own, observed);
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
        let observations = std::mem::take(&mut out.observations);
        let observes = self.book.observer.is_some();
        let (own, observed) = if observes { (measured, observations) } else { (observations, measured) };
        let EpisodeShard { episode, book, .. } = self;
        let actions = ActionRows { rows: actions, envs: book.envs, drones: book.drones };
        let mut sink = RowSink::new(book, own, observed, out.reborrow());
        R::run(
            #[inline(always)]
            || episode.tick(tiles.clone(), &actions, &mut sink),
        );
        if sink.some_ended {
            for tile in tiles.clone() {
                let Bits { ended, before, .. } = self.book.bits[tile];
                if (ended | before) != 0 {
                    self.reset_ended(config, tile, StepRows { own, observed, out: &mut out });
                }
            }
        }
        if C::ALONE {
            for (flags, bits) in
                out.flying.chunks_mut(LANES).zip(&self.book.bits).take(tiles.end).skip(tiles.start)
            {
                flags.iter_mut().enumerate().for_each(|(lane, flag)| *flag = bits.ended >> lane & 1 == 0);
            }
        }
    }

    fn tiles(&self) -> usize {
        self.book.bits.len()
    }

    fn ended(&self, tile: usize) -> u16 {
        self.book.bits[tile].ended
    }

    fn first_bad_action(&self, actions: &[f32]) -> Option<usize> {
        R::run(
            #[inline(always)]
            || first_bad_action(actions),
        )
    }

    fn states(&self, rows: &mut [f32]) {
        self.book.write_states(&self.episode.flights, rows);
    }

    fn last_of_episode(&self, env: usize) -> Option<(&[f32], &[f32])> {
        let (width, states) = (self.book.drones * self.book.width, self.book.drones * STATE);
        let observations = self.book.final_observations.get(env * width..(env + 1) * width)?;
        Some((observations, self.book.final_states.get(env * states..(env + 1) * states)?))
    }

    fn outlines(&self, env: usize) -> Vec<Outline> {
        let board = self.episode.flights.board(env / LANES);
        let board: Vec<f64> = board.iter().map(|number| number.lane(env % LANES)).collect();
        self.episode.task.outlines(&board)
    }

    fn loads(&self, rows: &mut [f32]) -> bool {
        write_loads(&self.episode.flights, rows)
    }

    fn end(&mut self, drones: &[bool]) {
        self.book.end(&mut self.episode.flights, drones);
    }

    fn watched(&self) -> &[f32] {
        self.book.judgement.as_ref().map_or(&[], Judgement::rows)
    }

    fn take_fault(&mut self) -> Option<Fault> {
        self.book.judgement.as_mut()?.take_fault()
    }

    fn archive(&mut self, tile: usize, archive: &mut Archive<'_>) {
        self.book.archive(&mut self.episode.flights, tile, archive);
    }

    fn set_force(&mut self, force_n: Option<&[f32]>) {
        let n = self.book.drones;
        for (own, drone) in self.episode.flights.drones.as_mut().iter_mut().enumerate() {
            drone.world.set_force(force_n, [own, n]);
        }
    }
}
