//! One world in flight. Its results are a function of its plan and of the actions, to the bit.

use std::time::{Duration, Instant};

use crazyflie_control::{ControllerSpec, MultiController};
use crazyflie_env::action::ACTION;
use crazyflie_env::error::{Error, Result};
use crazyflie_env::vector::{METRICS, VectorEnv};
use sha2::{Digest, Sha256};

use super::WorldPlan;
use crate::flight::{EnvBatch, crowd, metric};

/// Ticks that are flown to measure the work of a world.
const TRIAL_TICKS: usize = 5;

pub(crate) struct WorldFlight {
    autopilot: MultiController,
    /// One environment.
    pub batch: EnvBatch,
    pub ticks: u64,
    /// Hash of all states and observations so far.
    digest: Sha256,
}

impl WorldFlight {
    /// # Errors
    /// For a plan that cannot be flown.
    pub(crate) fn new(plan: &WorldPlan) -> Result<WorldFlight> {
        let (model, options) = (plan.model()?, plan.options()?);
        let env = VectorEnv::new(std::slice::from_ref(&model), &options, 1)?;
        let autopilot = crowd(&model, &env, &[ControllerSpec::named(&plan.autopilot)?], true)?;
        let batch = EnvBatch::begin(env, &[plan.seed])?;
        let mut flight = WorldFlight { autopilot, batch, ticks: 0, digest: Sha256::new() };
        flight.observe();
        Ok(flight)
    }

    /// Work of a world of this plan that the autopilot flies in real time, in thousandths of a core: the fastest of
    /// a few ticks, so that other work on the machine counts little.
    ///
    /// # Errors
    /// The errors of [`WorldFlight::new`].
    pub(crate) fn measure_work(plan: &WorldPlan) -> Result<usize> {
        let mut trial = WorldFlight::new(plan)?;
        let (nobody, mut fastest) = (vec![None; trial.drones()], Duration::MAX);
        for _ in 0..TRIAL_TICKS {
            if trial.is_over() {
                break;
            }
            let began = Instant::now();
            trial.step(&nobody)?;
            fastest = fastest.min(began.elapsed());
        }
        Ok((1000.0 * fastest.as_secs_f64() / trial.tick_s()).ceil().clamp(1.0, 1e6) as usize)
    }

    pub(crate) fn drones(&self) -> usize {
        self.batch.env.num_drones()
    }

    pub(crate) fn tick_s(&self) -> f64 {
        self.batch.env.tick_s()
    }

    /// A drone's observation; empty for a drone that does not exist.
    pub(crate) fn observation(&self, drone: usize) -> &[f32] {
        self.batch.observations.chunks(self.batch.env.width()).nth(drone).unwrap_or_default()
    }

    /// Returns whether no drone flies any more.
    pub(crate) fn is_over(&self) -> bool {
        !self.batch.flying.contains(&true)
    }

    /// Hands a drone over to the autopilot.
    pub(crate) fn take_over(&mut self, drone: usize) {
        self.autopilot.take_over(drone);
    }

    /// Flies a tick; the autopilot flies drones without an action.
    ///
    /// # Errors
    /// Before anything moves, for an action that is not made of numbers from -1 to 1, and when nobody flies.
    pub(crate) fn step(&mut self, pilot_actions: &[Option<[f32; ACTION]>]) -> Result<()> {
        self.autopilot.act(&self.batch.observations, &mut self.batch.actions)?;
        for (row, pilot_action) in self.batch.actions.as_chunks_mut().0.iter_mut().zip(pilot_actions) {
            *row = pilot_action.unwrap_or(*row);
        }
        self.advance()
    }

    /// Flies a tick with an action for each drone.
    ///
    /// # Errors
    /// The errors of [`WorldFlight::step`], and one for another number of actions.
    pub(crate) fn step_with(&mut self, actions: &[[f32; ACTION]]) -> Result<()> {
        if actions.len() != self.drones() {
            return Err(Error::Config(format!(
                "actions of {} drones, the world has {}",
                actions.len(),
                self.drones()
            )));
        }
        self.batch.actions.copy_from_slice(actions.as_flattened());
        self.advance()
    }

    fn advance(&mut self) -> Result<()> {
        self.batch.step()?;
        self.ticks += 1;
        self.observe();
        Ok(())
    }

    fn observe(&mut self) {
        self.digest.update(bytemuck::cast_slice::<f32, u8>(&self.batch.states));
        self.digest.update(bytemuck::cast_slice::<f32, u8>(&self.batch.observations));
    }

    /// SHA-256 of the true states and observations of all drones at every tick from the first on, as
    /// little-endian `f32`, in hexadecimal.
    pub(crate) fn hash(&self) -> String {
        hex::encode(self.digest.clone().finalize())
    }

    /// By name; none before the first tick.
    pub(crate) fn metrics(&self) -> impl Iterator<Item = (&'static str, f32)> {
        METRICS
            .iter()
            .zip(&self.batch.metrics)
            .filter(|_| self.ticks > 0)
            .map(|((name, _, _), value)| (*name, *value))
    }

    /// Smallest distance so far between two drones that flew.
    pub(crate) fn least_separation_m(&self) -> f32 {
        metric(&self.batch.metrics, "min_separation_m").unwrap_or(f32::INFINITY)
    }
}
