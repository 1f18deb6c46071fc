//! What comes of a tick for a drones: collisions, what is known of whom, ends, rows.

use super::drone_batch::{DroneBatch, neighbour};
use crate::coupling::NEIGHBOUR;
use crate::expression::Moment;
use crate::lanes::LANES;
use crate::observation::{OBSERVATION, Surroundings, observe};
use crate::rows::{lanes_of, write_lane};
use crate::scalar::Scalar;
use crate::sim_scalar::BatchScalar;
use crate::swarm::{Harm, mark_hits};
use crate::vector::judgement::Verdict;
use crate::vector::observer::{RowPlace, Sight};
use crate::vector::{BatchConfig, METRICS, StepBuffers};

impl<R: BatchScalar> DroneBatch<R> {
    /// Where everybody is now, who has hit whom, and what is said by radio.
    #[inline(never)]
    pub(in crate::vector) fn regard(&mut self, config: &BatchConfig, tile: usize, place: usize) {
        R::run(
            #[inline(always)]
            || {
                self.collide(config, tile, place);
                self.talk(tile, place);
            },
        );
    }

    /// Who is nearer to another than two radii.
    #[inline(always)]
    fn collide(&mut self, config: &BatchConfig, tile: usize, place: usize) {
        let n = self.drones.len();
        let scene = &mut self.scratch.scene[place * n..(place + 1) * n];
        for (drone, seen) in scene.iter_mut().enumerate() {
            *seen = neighbour(self.drones[drone].state(tile), self.slots[tile * n + drone].flying);
        }
        let nearest2_m2 = &mut self.tiles[tile].stats.nearest2_m2;
        mark_hits(scene, config.radius_m, &mut self.scratch.hit, nearest2_m2);
    }

    /// Everybody says where it is, and listens.
    #[inline(always)]
    fn talk(&mut self, tile: usize, place: usize) {
        let n = self.drones.len();
        let known = &mut self.tiles[tile].known;
        known.tick();
        for (drone, ticks) in self.scratch.ticks.iter().enumerate() {
            known.say(drone, &ticks[place].reading.marker);
            self.scratch.contacts[drone] = ticks[place].contact;
        }
        known.listen(&self.scratch.scene[place * n..(place + 1) * n], &self.drones[0].draw(tile));
    }

    /// Ends, rows and metrics of a tick, from the task's outcomes on the scratch. Returns the environments
    /// that had ended before.
    #[inline(never)]
    pub(in crate::vector) fn write_step(
        &mut self,
        config: &BatchConfig,
        tile: usize,
        place: usize,
        measured: &mut [f32],
        out: &mut StepBuffers<'_>,
    ) -> u16 {
        R::run(
            #[inline(always)]
            || self.write_step_now(config, tile, place, measured, out),
        )
    }

    #[inline(always)]
    fn write_step_now(
        &mut self,
        config: &BatchConfig,
        tile: usize,
        place: usize,
        measured: &mut [f32],
        out: &mut StepBuffers<'_>,
    ) -> u16 {
        let n = self.drones.len();
        let now_s = self.drones[0].time_s(tile);
        let over = R::bits(now_s.gt(R::from_f64(config.last_s))) as u16;
        let (mut late, mut arrived, mut flying) = (R::nothing(), R::zero(), 0);
        let lanes = self.used(tile);
        let mut near = std::mem::take(&mut self.scratch.rows);
        for drone in 0..n {
            let before = self.slot(tile, drone).flying;
            let end = self.end(config, tile, place, drone, over);
            late = late | R::mask(before.into()) & !end.arrived;
            arrived += R::select(
                R::mask(u32::from(before & !end.terminated)) & end.arrived,
                R::from_f64(1.0),
                R::zero(),
            );
            flying |= end.flying;
            let first = tile * LANES * n + drone;
            let rewards = end.reward.array();
            for (to, reward) in out.rewards.iter_mut().skip(first).step_by(n).zip(rewards) {
                *to = *reward;
            }
            for (bits, flags) in [
                (end.terminated, &mut *out.terminated),
                (end.truncated, &mut *out.truncated),
                (end.flying, &mut *out.flying),
            ] {
                for (lane, flag) in flags.iter_mut().skip(first).step_by(n).take(LANES).enumerate() {
                    *flag = bits >> lane & 1 == 1;
                }
            }
            let to = RowPlace { tile, drone, lanes, flying: before.into(), begins: false };
            self.write(place, to, &mut near, measured, out.observations);
        }
        self.scratch.rows = near;
        for (seen, slot) in
            self.scratch.scene[place * n..].iter_mut().zip(&self.slots[tile * n..(tile + 1) * n])
        {
            seen.here = R::select(R::mask(slot.flying.into()), R::from_f64(1.0), R::zero());
        }
        let of = &mut self.tiles[tile];
        of.stats.settled_s = R::select(late, now_s, of.stats.settled_s);
        let metrics = of.stats.row(arrived);
        for lane in lanes_of(lanes) {
            let row = (tile * LANES + lane) * METRICS.len();
            write_lane(&metrics, lane, &mut out.metrics[row..row + METRICS.len()]);
        }
        let before = of.ended;
        of.ended = !flying & of.used;
        before
    }

    /// Whether a drone's flight ends, and what the tick was worth.
    #[inline(always)]
    fn end(&mut self, config: &BatchConfig, tile: usize, place: usize, drone: usize, over: u16) -> End<R> {
        let outcome = self.scratch.outcomes[drone];
        let (x, contact) = (self.drones[drone].state(tile), &self.scratch.contacts[drone]);
        let flies = R::mask(self.slot(tile, drone).flying.into());
        let worth = (outcome.reward, config.crash_cost);
        let Harm { hit, crash, reward: task_reward } =
            Harm::new([flies, self.scratch.hit[drone]], x, contact, worth);
        let mut verdict = Verdict { reward: task_reward, ends: outcome.ends };
        self.judge_anew(tile, place, drone, hit | crash, &mut verdict);
        let done = flies & verdict.ends & !(hit | crash);
        let one = |mask: R::Mask| R::select(mask, R::from_f64(1.0), R::zero());
        let stats = &mut self.tiles[tile].stats;
        stats.collisions += one(hit);
        stats.crashes += one(crash);
        stats.done += one(done);
        stats.error2_m2 += R::select(flies, outcome.error_m * outcome.error_m, R::zero());
        stats.flown += one(flies);
        let terminated = R::bits(hit | crash | done) as u16;
        let action = self.scratch.actions[drone][place];
        let slot = self.slot_mut(tile, drone);
        let truncated = slot.flying & !terminated & over;
        slot.flying &= !(terminated | over);
        slot.last_action = action;
        let reward = R::select(flies, verdict.reward, R::zero());
        End { reward, arrived: outcome.arrived, terminated, truncated, flying: slot.flying }
    }

    /// A user's own reward and end in place of the task's.
    #[inline(always)]
    fn judge_anew(
        &mut self,
        tile: usize,
        place: usize,
        drone: usize,
        broken: R::Mask,
        verdict: &mut Verdict<R>,
    ) {
        let n = self.drones.len();
        let Some(judgement) = &mut self.judgement else { return };
        let (slot, world) = (&self.slots[tile * n + drone], &self.drones[drone]);
        let (now_s, setpoint) = (world.time_s(tile), &self.scratch.setpoints[drone]);
        let reading = &self.scratch.ticks[drone][place].reading;
        let own = observe(reading, now_s, setpoint, &self.scratch.actions[drone][place]);
        let moment = Moment {
            own: &own,
            x: world.state(tile),
            setpoint,
            last_action: &slot.last_action,
            impact_mps: self.scratch.contacts[drone].impact_mps,
            now_s,
            broken,
            arrived: self.scratch.outcomes[drone].arrived,
            task_reward: verdict.reward,
        };
        judgement.decide(tile, drone, slot.flying.into(), &moment, verdict);
    }

    /// The first observations of the envs of `bits`.
    #[inline(never)]
    pub(in crate::vector) fn show(
        &mut self,
        tile: usize,
        bits: u32,
        measured: &mut [f32],
        observations: &mut [f32],
    ) {
        let mut near = std::mem::take(&mut self.scratch.rows);
        R::run(
            #[inline(always)]
            || {
                // no closure in a closure: it may be compiled without the instructions of `run`
                for drone in 0..self.len() {
                    let to = RowPlace { tile, drone, lanes: bits, flying: bits, begins: true };
                    self.write(0, to, &mut near, measured, observations);
                }
            },
        );
        self.scratch.rows = near;
    }

    /// A drone's rows: what it observes where it flew, zeros elsewhere. They
    /// are put together in `near`, which stays in the cache, because the envs of a tile are far from each
    /// other.
    #[inline(always)]
    fn write(
        &mut self,
        place: usize,
        to: RowPlace,
        near: &mut [f32],
        measured: &mut [f32],
        observations: &mut [f32],
    ) {
        let (n, RowPlace { tile, drone, lanes, flying, .. }) = (self.drones.len(), to);
        let width = OBSERVATION + NEIGHBOUR * (n - 1);
        let now_s = self.drones[drone].time_s(tile);
        let reading = &self.scratch.ticks[drone][place].reading;
        let own =
            observe(reading, now_s, &self.scratch.setpoints[drone], &self.slot(tile, drone).last_action);
        R::write(&own, near, width);
        let truth = &self.scratch.scene[place * n..(place + 1) * n];
        let mut at = OBSERVATION;
        for other in (0..n).filter(|other| *other != drone) {
            R::write(
                &self.tiles[tile].known.neighbour_row(drone, other, truth, now_s),
                &mut near[at..],
                width,
            );
            at += NEIGHBOUR;
        }
        let rows = if let Some(observer) = &mut self.observer {
            let x = self.drones[drone].state(tile);
            let sight = Sight { own: &own, x, rows: near, surroundings: Surroundings::none() };
            observer.write(to, &sight, observations);
            measured
        } else {
            observations
        };
        let first = (tile * LANES * n + drone) * width;
        for lane in lanes_of(lanes) {
            let row = &mut rows[first + lane * n * width..][..width];
            if flying >> lane & 1 == 1 {
                copy(&near[lane * width..(lane + 1) * width], row)
            } else {
                row.fill(0.0)
            }
        }
    }
}

/// Rows are short: a call of the library's copy would take as long as the copying.
#[inline(always)]
fn copy(from: &[f32], to: &mut [f32]) {
    const { assert!(OBSERVATION.is_multiple_of(8) && NEIGHBOUR.is_multiple_of(8)) };
    for (to, from) in to.as_chunks_mut::<8>().0.iter_mut().zip(from.as_chunks::<8>().0) {
        *to = *from;
    }
}

/// How a tick ended for a drone, world by world.
struct End<R: Scalar> {
    reward: R,
    arrived: R::Mask,
    terminated: u16,
    truncated: u16,
    flying: u16,
}
