//! Results of a tick as the caller's rows.

use super::METRICS;
use super::buffers::StepBuffers;
use super::observer::{RowPlace, Sight as ObserverSight};
use super::shard::Book;
use crate::coupling::NEIGHBOUR;
use crate::episode::{At, Coupling, DroneResult, Flights, Sight, Sink};
use crate::lanes::LANES;
use crate::observation::{OBSERVATION, Surroundings};
use crate::rows::{flags, lanes_of, write_lane};
use crate::sim_scalar::BatchScalar;

/// Writes the results of a tick into the buffers of a whole shard.
pub(super) struct RowSink<'a, 'b, R: BatchScalar> {
    book: &'a mut Book<R>,
    /// Each drone's own numbers.
    own: &'a mut [f32],
    /// Rows of an observer; empty where there is none.
    observed: &'a mut [f32],
    out: StepBuffers<'b>,
    /// Some environment ended, in this step or before.
    pub(super) some_ended: bool,
    /// State of a tile under way whose drones interact.
    progress: Progress<R>,
}

/// Sums over the drones of a tile, while they are judged one after the other.
struct Progress<R: BatchScalar> {
    /// Some drone that flew is not where it should be.
    late: R::Mask,
    /// Drones that flew and are where they should be.
    arrived: R,
    /// Some drone flies on.
    flying: u16,
}

impl<R: BatchScalar> Progress<R> {
    fn none() -> Self {
        Progress { late: R::nothing(), arrived: R::zero(), flying: 0 }
    }
}

/// Measurements of the episodes of a tile, see [`METRICS`].
#[derive(Debug, Clone, Copy)]
pub(super) struct EpisodeStats<R> {
    collisions: R,
    crashes: R,
    done: R,
    settled_s: R,
    error2_m2: R,
    flown: R,
}

impl<R: BatchScalar> EpisodeStats<R> {
    pub(super) fn none() -> Self {
        let zero = R::zero();
        EpisodeStats {
            collisions: zero,
            crashes: zero,
            done: zero,
            settled_s: zero,
            error2_m2: zero,
            flown: zero,
        }
    }

    /// All numbers, in one order.
    pub(super) fn numbers(&mut self) -> [&mut R; 6] {
        let EpisodeStats { collisions, crashes, done, settled_s, error2_m2, flown } = self;
        [collisions, crashes, done, settled_s, error2_m2, flown]
    }

    /// From nothing in the lanes of `mask`.
    pub(super) fn begun(mut self, mask: R::Mask) -> Self {
        for number in self.numbers() {
            *number = R::select(mask, R::zero(), *number);
        }
        self
    }

    /// Adds a drone's tick.
    #[inline(always)]
    fn add(&mut self, result: &DroneResult<'_, R>) {
        self.collisions += ones(result.hit);
        self.crashes += ones(result.crash);
        self.done += ones(result.done);
        self.error2_m2 += R::select(result.flew, result.error_m * result.error_m, R::zero());
        self.flown += ones(result.flew);
    }

    /// In the order of [`METRICS`].
    #[inline(always)]
    fn row(&self, nearest2_m2: R, arrived: R) -> [R; METRICS.len()] {
        let rms_m = (self.error2_m2 / self.flown.max(R::from_f64(1.0))).sqrt();
        [self.collisions, self.crashes, nearest2_m2.sqrt(), self.settled_s, rms_m, self.done + arrived]
    }
}

#[inline(always)]
fn ones<R: BatchScalar>(mask: R::Mask) -> R {
    R::select(mask, R::from_f64(1.0), R::zero())
}

impl<'a, 'b, R: BatchScalar> RowSink<'a, 'b, R> {
    #[inline(always)]
    pub(super) fn new(
        book: &'a mut Book<R>,
        own: &'a mut [f32],
        observed: &'a mut [f32],
        out: StepBuffers<'b>,
    ) -> Self {
        RowSink { book, own, observed, out, some_ended: false, progress: Progress::none() }
    }

    /// The rows of a drone that is alone: a tile's lie one after the other.
    #[inline(always)]
    fn tick_alone(&mut self, at: At, sight: &Sight<'_, R>, result: &DroneResult<'_, R>) {
        let At { tile, .. } = at;
        let (terminated, truncated) = (R::bits(result.terminated), R::bits(result.truncated));
        let first = tile * LANES;
        match (
            self.own.get_mut(first * OBSERVATION..(first + LANES) * OBSERVATION),
            self.out.rewards.get_mut(first..).and_then(<[f32]>::first_chunk_mut::<LANES>),
            self.out.terminated.get_mut(first..).and_then(<[bool]>::first_chunk_mut::<LANES>),
            self.out.truncated.get_mut(first..).and_then(<[bool]>::first_chunk_mut::<LANES>),
        ) {
            (Some(rows), Some(rewards), Some(terminations), Some(truncations)) => {
                R::write(sight.row, rows, OBSERVATION);
                *rewards = *result.reward.array();
                flags(terminated, terminations);
                flags(truncated, truncations);
            }
            // copies, so that what is written above stays in registers
            _ => self.write_tail(tile, [terminated, truncated], &{ *sight.row }, &{ result.reward }),
        }
        let bits = &mut self.book.bits[tile];
        bits.before = bits.ended;
        bits.ended = (terminated | truncated) as u16 & bits.used;
        self.some_ended |= (bits.before | bits.ended) != 0;
    }

    /// The rows of a last tile of fewer than sixteen environments.
    #[cold]
    #[inline(never)]
    fn write_tail(&mut self, tile: usize, ends: [u32; 2], row: &[R; OBSERVATION], reward: &R) {
        let first = tile * LANES;
        for lane in 0..self.book.envs - first {
            let env = first + lane;
            write_lane(row, lane, &mut self.own[env * OBSERVATION..(env + 1) * OBSERVATION]);
            self.out.rewards[env] = reward.array()[lane];
            self.out.terminated[env] = ends[0] >> lane & 1 == 1;
            self.out.truncated[env] = ends[1] >> lane & 1 == 1;
        }
    }

    /// The rows of one of several drones; the last one completes the tile.
    #[inline(always)]
    fn tick_several<C: Coupling<R>>(
        &mut self,
        at: At,
        flights: &Flights<R, C>,
        sight: &Sight<'_, R>,
        result: &DroneResult<'_, R>,
    ) {
        let At { tile, own, .. } = at;
        let n = self.book.drones;
        if own == 0 {
            self.progress = Progress::none();
        }
        let (flew, not_ended) = (result.flew, !result.terminated);
        self.progress.late = self.progress.late | flew & !result.moment.arrived;
        self.progress.arrived += ones(flew & not_ended & result.moment.arrived);
        let flies = R::bits(flew & not_ended & !result.truncated) as u16;
        self.progress.flying |= flies;
        self.book.stats[tile].add(result);
        let first = tile * LANES * n + own;
        let rewards = result.reward.array();
        for (to, reward) in self.out.rewards.iter_mut().skip(first).step_by(n).zip(rewards) {
            *to = *reward;
        }
        for (bits, flags) in [
            (R::bits(result.terminated) as u16, &mut *self.out.terminated),
            (R::bits(result.truncated) as u16, &mut *self.out.truncated),
            (flies, &mut *self.out.flying),
        ] {
            for (lane, flag) in flags.iter_mut().skip(first).step_by(n).take(LANES).enumerate() {
                *flag = bits >> lane & 1 == 1;
            }
        }
        let lanes = self.book.bits[tile].used.into();
        let to = RowPlace { tile, drone: own, lanes, flying: R::bits(flew), begins: false };
        self.write_several(at, to, flights, sight);
        if own + 1 == n {
            self.complete(tile, flights, result.moment.now_s);
        }
    }

    /// Metrics of a tile, and whose episodes have ended.
    #[inline(always)]
    fn complete<C: Coupling<R>>(&mut self, tile: usize, flights: &Flights<R, C>, now_s: R) {
        let Progress { late, arrived, flying } = self.progress;
        let (stats, bits) = (&mut self.book.stats[tile], &mut self.book.bits[tile]);
        stats.settled_s = R::select(late, now_s, stats.settled_s);
        let metrics = stats.row(flights.coupling.nearest2_m2(tile), arrived);
        for lane in lanes_of(bits.used.into()) {
            let row = (tile * LANES + lane) * METRICS.len();
            write_lane(&metrics, lane, &mut self.out.metrics[row..row + METRICS.len()]);
        }
        bits.before = bits.ended;
        bits.ended = !flying & bits.used;
        self.some_ended |= (bits.before | bits.ended) != 0;
    }

    /// A drone's rows: its own numbers, then what it knows of the others; zeros where it does not fly. They are put
    /// together where they stay in the cache, because the environments of a tile are far from each other.
    #[inline(always)]
    fn write_several<C: Coupling<R>>(
        &mut self,
        at: At,
        to: RowPlace,
        flights: &Flights<R, C>,
        sight: &Sight<'_, R>,
    ) {
        let (n, RowPlace { tile, drone, lanes, flying, .. }) = (self.book.drones, to);
        let width = OBSERVATION + NEIGHBOUR * (n - 1);
        let now_s = flights.drones.as_ref()[drone].world.time_s(tile);
        let near = &mut self.book.near;
        R::write(sight.row, near, width);
        let mut column = OBSERVATION;
        for other in (0..n).filter(|other| *other != drone) {
            R::write(&flights.coupling.neighbour_row(at, other, now_s), &mut near[column..], width);
            column += NEIGHBOUR;
        }
        if let Some(observer) = &mut self.book.observer {
            let x = flights.state(tile, drone);
            let seen = ObserverSight { own: sight.row, x, rows: near, surroundings: around(sight) };
            observer.write(to, &seen, self.observed);
        }
        let first = (tile * LANES * n + drone) * width;
        for lane in lanes_of(lanes) {
            let row = &mut self.own[first + lane * n * width..][..width];
            if flying >> lane & 1 == 1 {
                copy(&near[lane * width..(lane + 1) * width], row)
            } else {
                row.fill(0.0)
            }
        }
    }
}

/// Surroundings of a drone.
#[inline(always)]
fn around<R: BatchScalar>(sight: &Sight<'_, R>) -> Surroundings<R> {
    sight.surroundings.copied().unwrap_or_else(Surroundings::none)
}

/// Rows are short: a call of the library's copy would take as long as the copying.
#[inline(always)]
fn copy(from: &[f32], to: &mut [f32]) {
    const { assert!(OBSERVATION.is_multiple_of(8) && NEIGHBOUR.is_multiple_of(8)) };
    for (to, from) in to.as_chunks_mut::<8>().0.iter_mut().zip(from.as_chunks::<8>().0) {
        *to = *from;
    }
}

impl<R: BatchScalar, C: Coupling<R>> Sink<R, C> for RowSink<'_, '_, R> {
    #[inline(always)]
    fn looks_around(&self) -> bool {
        self.book.observer.is_some()
    }

    // once for all tasks
    #[inline(never)]
    fn begin(&mut self, at: At, mask: R::Mask, flights: &Flights<R, C>, sight: &Sight<'_, R>) {
        let lanes = R::bits(mask);
        let place = RowPlace { tile: at.tile, drone: at.own, lanes, flying: lanes, begins: true };
        R::run(
            #[inline(always)]
            || self.write_several(at, place, flights, sight),
        );
    }

    #[inline(always)]
    fn tick(&mut self, at: At, flights: &Flights<R, C>, sight: &Sight<'_, R>, result: &DroneResult<'_, R>) {
        if let Some(judgement) = &mut self.book.judgement {
            let bits = self.book.bits[at.tile];
            let alive = if C::ALONE { (bits.used & !bits.ended).into() } else { R::bits(result.flew) };
            // a result of its own, so that the other one stays in registers
            judgement.note(at.tile, at.own, alive, &DroneResult { ..*result });
        }
        if !C::ALONE {
            return self.tick_several(at, flights, sight, result);
        }
        if let Some(observer) = &mut self.book.observer {
            let used = self.book.bits[at.tile].used.into();
            let place = RowPlace { tile: at.tile, drone: 0, lanes: used, flying: used, begins: false };
            let (own, x) = (sight.row, result.moment.x);
            let seen = ObserverSight { own, x, rows: &[], surroundings: around(sight) };
            observer.write(place, &seen, self.observed);
        }
        self.tick_alone(at, sight, result);
    }
}
