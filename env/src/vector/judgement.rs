//! Values of a user's own rewards and ends, and the numbers from which callers make theirs.

use super::ShardSpec;
use crate::episode::{DroneResult, FlightPlan};
use crate::error::Result;
use crate::expression::{Moment, Program, find_expression_field, parse_cost};
use crate::lanes::LANES;
use crate::rows::lanes_of;
use crate::sim_scalar::BatchScalar;

/// Names of what a user may decide.
pub(super) const REWARD: &str = "reward";
pub(super) const TERMINATION: &str = "termination";
pub(super) const COST: &str = "cost";

/// Values of a user's own rewards and ends, and numbers that the caller requested.
pub(super) struct Judgement {
    /// The reward is the user's own.
    has_reward: bool,
    /// Places of the numbers that are kept for the caller.
    watched: Vec<usize>,
    /// Kept behind them.
    cost: Option<Program>,
    drones: usize,
    tick_s: f64,
    /// The numbers of the last step, by environment and drone.
    rows: Vec<f32>,
    fault: Option<Fault>,
}

/// The first value of a step that is no number.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fault {
    /// [`REWARD`], [`TERMINATION`] or [`COST`].
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
    let lengths = options.watch.iter().map(|name| Ok(find_expression_field(name)?.length));
    Ok(lengths.sum::<Result<usize>>()? + usize::from(options.cost.is_some()))
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
        let cost = options.cost.as_deref().map(parse_cost).transpose()?;
        let width = watched_width(options)?;
        if !has_reward && options.termination.is_none() && width == 0 {
            return Ok(None);
        }
        let rows = vec![0.0; envs * drones * width];
        Ok(Some(Judgement { has_reward, watched, cost, drones, tick_s, rows, fault: None }))
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
            || {
                let moment = &result.moment;
                let cost = match &self.cost {
                    Some(program) => Some(program.evaluate(moment)),
                    None => None,
                };
                let reward = if self.has_reward { Some(result.reward) } else { None };
                let values = [(REWARD, reward), (TERMINATION, result.condition), (COST, cost)];
                for (name, value) in values {
                    if let (Some(value), None) = (value, self.fault)
                        && let Some((lane, value)) = first_not_finite(&value, alive)
                    {
                        let step = (moment.now_s.lane(lane) / self.tick_s).round() as u64;
                        self.fault = Some(Fault { name, value, env: tile * LANES + lane, drone, step });
                    }
                }
                self.watch(tile, drone, alive, moment, cost);
            },
        );
    }

    /// Keeps the numbers that the caller requested; where no episode is under way, nothing costs anything.
    #[inline(always)]
    fn watch<R: BatchScalar>(
        &mut self,
        tile: usize,
        drone: usize,
        lanes: u32,
        moment: &Moment<'_, R>,
        cost: Option<R>,
    ) {
        let width = self.watched.len() + usize::from(cost.is_some());
        if let Some(cost) = cost {
            let rows = self.rows.chunks_exact_mut(width).skip(tile * LANES * self.drones + drone);
            for (lane, row) in rows.step_by(self.drones).take(LANES).enumerate() {
                row[width - 1] = if lanes >> lane & 1 == 1 { cost.array()[lane] } else { 0.0 };
            }
        }
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
