//! Rewards and ends of a user's own in place of the task's, and the numbers from which callers make theirs.

use super::ShardSpec;
use crate::error::Result;
use crate::expression::{Moment, Program, find_expression_field, holds, parse_reward, parse_termination};
use crate::lanes::LANES;
use crate::rows::lanes_of;
use crate::sim_scalar::BatchScalar;

/// Names of what a user may decide.
pub(super) const REWARD: &str = "reward";
pub(super) const TERMINATION: &str = "termination";

/// What a user decides in place of the task.
pub(super) struct Judgement {
    reward: Option<Program>,
    termination: Option<Program>,
    /// Places of the numbers that are kept for the caller.
    watched: Vec<usize>,
    drones: usize,
    tick_s: f64,
    /// The numbers of the last step, by environment and drone.
    rows: Vec<f32>,
    fault: Option<Fault>,
}

/// The first value of a step that is no number.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fault {
    /// [`REWARD`] or [`TERMINATION`].
    pub(super) name: &'static str,
    pub(super) value: f32,
    pub(super) env: usize,
    pub(super) drone: usize,
    /// Of the episode, from 1.
    pub(super) step: u64,
}

impl Fault {
    /// Counted from the batch's first environment, where the shard's first is `first_env`.
    pub(super) fn shifted(self, first_env: usize) -> Self {
        Fault { env: first_env + self.env, ..self }
    }
}

/// What a tick was worth, and where the drone's part is done.
pub(super) struct Verdict<R: BatchScalar> {
    pub(super) reward: R,
    pub(super) ends: R::Mask,
}

/// Numbers that are kept of each drone for the caller.
///
/// # Errors
/// As [`find_expression_field`].
pub(super) fn watched_width(options: &crate::config::Options) -> Result<usize> {
    options.watch.iter().map(|name| Ok(find_expression_field(name)?.length)).sum()
}

impl Judgement {
    /// None where all is as the task says.
    pub(super) fn new(spec: &ShardSpec<'_>, drones: usize) -> Result<Option<Self>> {
        let ShardSpec { options, envs, tick_s, .. } = *spec;
        let reward = options.reward.as_deref().map(parse_reward).transpose()?;
        let termination = options.termination.as_deref().map(parse_termination).transpose()?;
        let mut watched = Vec::new();
        for name in &options.watch {
            watched.extend(find_expression_field(name)?.range());
        }
        if reward.is_none() && termination.is_none() && watched.is_empty() {
            return Ok(None);
        }
        let rows = vec![0.0; envs * drones * watched.len()];
        Ok(Some(Judgement { reward, termination, watched, drones, tick_s, rows, fault: None }))
    }

    /// Replaces what the task says of a drone in the lanes of a tile. `alive` are the lanes whose episode is
    /// under way.
    // a function of its own, so that it does not weigh on steps without it
    #[inline(never)]
    pub(super) fn decide<R: BatchScalar>(
        &mut self,
        tile: usize,
        drone: usize,
        alive: u32,
        moment: &Moment<'_, R>,
        verdict: &mut Verdict<R>,
    ) {
        R::run(
            #[inline(always)]
            || self.decide_now(tile, drone, alive, moment, verdict),
        );
    }

    #[inline(always)]
    fn decide_now<R: BatchScalar>(
        &mut self,
        tile: usize,
        drone: usize,
        alive: u32,
        moment: &Moment<'_, R>,
        verdict: &mut Verdict<R>,
    ) {
        let mut wrong = None;
        if let Some(reward) = &self.reward {
            verdict.reward = reward.evaluate(moment);
            wrong = first_not_finite(&verdict.reward, alive).map(|(lane, value)| (REWARD, lane, value));
        }
        if let Some(termination) = &self.termination {
            let condition = termination.evaluate(moment);
            verdict.ends = holds(condition);
            wrong =
                wrong.or(first_not_finite(&condition, alive).map(|(lane, value)| (TERMINATION, lane, value)));
        }
        if let (Some((name, lane, value)), None) = (wrong, self.fault) {
            let step = (moment.now_s.lane(lane) / self.tick_s).round() as u64;
            self.fault = Some(Fault { name, value, env: tile * LANES + lane, drone, step });
        }
        self.watch(tile, drone, alive, moment);
    }

    /// Keeps the numbers that the caller asked for.
    #[inline(always)]
    fn watch<R: BatchScalar>(&mut self, tile: usize, drone: usize, lanes: u32, moment: &Moment<'_, R>) {
        let width = self.watched.len();
        for (i, place) in self.watched.iter().enumerate() {
            let number = moment.number(*place);
            for lane in lanes_of(lanes) {
                let row = (tile * LANES + lane) * self.drones + drone;
                self.rows[row * width + i] = number.array()[lane];
            }
        }
    }

    /// Numbers of the last step, a row for each drone.
    pub(super) fn rows(&self) -> &[f32] {
        &self.rows
    }

    pub(super) fn take_fault(&mut self) -> Option<Fault> {
        self.fault.take()
    }
}

#[inline(always)]
fn first_not_finite<R: BatchScalar>(value: &R, lanes: u32) -> Option<(usize, f32)> {
    let wrong = lanes & !R::bits(value.abs().le(R::from_f64(f32::MAX.into())));
    let lane = lanes_of(wrong).next()?;
    Some((lane, value.array()[lane]))
}
