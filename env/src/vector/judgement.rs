//! Values of a user's own rewards and ends, and the numbers from which callers make theirs.

use super::ShardSpec;
use crate::episode::{DroneResult, FlightPlan};
use crate::error::Result;
use crate::expression::{Moment, find_expression_field};
use crate::lanes::LANES;
use crate::rows::lanes_of;
use crate::sim_scalar::BatchScalar;

/// Names of what a user may decide.
pub(super) const REWARD: &str = "reward";
pub(super) const TERMINATION: &str = "termination";

/// Values of a user's own rewards and ends, and numbers that the caller requested.
pub(super) struct Judgement {
    /// The reward is the user's own.
    has_reward: bool,
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
    /// Step of the episode, from 1.
    pub(super) step: u64,
}

impl Fault {
    /// Counted from the batch's first environment, where the shard's first is `first_env`.
    pub(super) fn shifted(self, first_env: usize) -> Self {
        Fault { env: first_env + self.env, ..self }
    }
}

/// Numbers that are kept of each drone for the caller.
///
/// # Errors
/// The errors of [`find_expression_field`].
pub(super) fn watched_width(options: &crate::config::Options) -> Result<usize> {
    options.watch.iter().map(|name| Ok(find_expression_field(name)?.length)).sum()
}

impl Judgement {
    /// Creates it; none if the task's own rewards and ends apply.
    pub(super) fn new(spec: &ShardSpec<'_>, drones: usize) -> Result<Option<Self>> {
        let ShardSpec { plan: FlightPlan { options, tick_s, .. }, envs } = *spec;
        let mut watched = Vec::new();
        for name in &options.watch {
            watched.extend(find_expression_field(name)?.range());
        }
        let has_reward = options.reward.is_some();
        if !has_reward && options.termination.is_none() && watched.is_empty() {
            return Ok(None);
        }
        let rows = vec![0.0; envs * drones * watched.len()];
        Ok(Some(Judgement { has_reward, watched, drones, tick_s, rows, fault: None }))
    }

    /// Notes a drone's tick in the lanes of a tile: the first value that is no number, and the numbers that the
    /// caller requested. `alive` are the lanes whose episode is under way.
    // a function of its own, so that it does not weigh on steps without it
    #[inline(never)]
    pub(super) fn note<R: BatchScalar>(
        &mut self,
        tile: usize,
        drone: usize,
        alive: u32,
        result: &DroneResult<'_, R>,
    ) {
        R::run(
            #[inline(always)]
            || self.note_now(tile, drone, alive, result),
        );
    }

    #[inline(always)]
    fn note_now<R: BatchScalar>(
        &mut self,
        tile: usize,
        drone: usize,
        alive: u32,
        result: &DroneResult<'_, R>,
    ) {
        let moment = &result.moment;
        let values = [(REWARD, self.has_reward.then_some(result.reward)), (TERMINATION, result.condition)];
        for (name, value) in values {
            if let (Some(value), None) = (value, self.fault)
                && let Some((lane, value)) = first_not_finite(&value, alive)
            {
                let step = (moment.now_s.lane(lane) / self.tick_s).round() as u64;
                self.fault = Some(Fault { name, value, env: tile * LANES + lane, drone, step });
            }
        }
        self.watch(tile, drone, alive, moment);
    }

    /// Keeps the numbers that the caller requested.
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
