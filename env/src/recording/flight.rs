//! An environment as it is recorded, and as it is flown in double precision to compare.

use crate::action::{ACTION, Interface, Onboard};
use crate::archive::Ledger;
use crate::config::Options;
use crate::error::{Error, Result};
use crate::estimator::{Estimator, SensorNoise};
use crate::expression::{Moment, holds, parse_reward, parse_termination};
use crate::model::Model;
use crate::observation::{Field, OBSERVATION, Surroundings, is_of_surroundings, need_estimate, observable};
use crate::plant::State;
use crate::scalar::Scalar;
use crate::sim_scalar::SimScalar;
use crate::task::{GOAL, Task};
use crate::world::{RecordedEffect, Settings, World};

/// One environment, whatever its task and its number of drones.
pub(super) trait Flight<R: SimScalar> {
    fn drones(&mut self) -> &mut [Drone<R>];
    /// Begins an episode with the numbers of [`super::EpisodeStart`]: observations, drone by drone.
    fn begin(&mut self, start: &[R]) -> Vec<Vec<R>>;
    /// One tick.
    ///
    /// # Errors
    /// Those of the user's own expressions.
    fn tick(&mut self, actions: &[[R; ACTION]]) -> Result<Vec<DroneTick<R>>>;
    /// Shows everything that the environment goes on from besides its drones.
    fn show_numbers(&mut self, ledger: &mut dyn Ledger<R>);
}

/// What came of a tick for a drone.
pub(super) struct DroneTick<R: Scalar> {
    pub(super) observation: Vec<R>,
    pub(super) reward: R,
    pub(super) terminated: R::Mask,
    pub(super) truncated: R::Mask,
}

/// What is the same for all tasks.
#[derive(Clone, Copy)]
pub(super) struct Plan<'a> {
    pub(super) models: &'a [&'a Model],
    pub(super) interfaces: &'a [Interface],
    pub(super) options: &'a Options,
    pub(super) tick_s: f64,
}

/// A drone with all that is kept of it.
pub(super) struct Drone<R: SimScalar> {
    pub(super) world: World<R>,
    pub(super) effects: Vec<RecordedEffect>,
    pub(super) onboard: Option<Onboard<R>>,
    estimator: Option<Estimator<R>>,
    pub(super) last_action: [R; ACTION],
    pub(super) goal: [R; GOAL],
}

impl Plan<'_> {
    /// Past this an episode is over, as in a batch.
    pub(super) fn last_s(&self) -> f64 {
        match self.options.max_episode_steps {
            0 => f64::INFINITY,
            steps => (f64::from(steps) - 0.5) * self.tick_s,
        }
    }

    /// Fields of an observation.
    ///
    /// # Errors
    /// [`Error::Config`] for fields of gates where the task has none.
    pub(super) fn fields<T: Task>(&self) -> Result<Vec<Field>> {
        let fields = self.options.observation.sources()?;
        match fields.iter().find(|field| !T::SURROUNDED && is_of_surroundings(field)) {
            None => Ok(fields),
            Some(field) => Err(Error::Config(format!(
                "observation: the task {} has no gates and no obstacles, hence no field {:?}",
                self.options.task, field.name
            ))),
        }
    }

    pub(super) fn drone<R: SimScalar>(&self, place: usize) -> Result<Drone<R>> {
        let (model, interface) = (self.models[place], &self.interfaces[place]);
        let settings = Settings { input: interface.input, physics_hz: self.options.physics_hz };
        let (world, effects) = World::recorded(model, &self.options.drone_effects(place), settings)?;
        let estimates = need_estimate(&self.options.observation.sources()?);
        let filter = || Estimator::new(model, interface.input, self.tick_s, &SensorNoise::default());
        Ok(Drone {
            world: world.at_level(self.options.action),
            effects,
            onboard: Onboard::new(model, interface, self.tick_s, 1)?,
            estimator: estimates.then(filter),
            last_action: [R::zero(); ACTION],
            goal: [R::zero(); GOAL],
        })
    }

    /// The user's own reward and end, in place of the task's.
    pub(super) fn decide<R: Scalar>(
        &self,
        moment: &Moment<'_, R>,
        (mut reward, mut ends): (R, R::Mask),
    ) -> Result<(R, R::Mask)> {
        if let Some(text) = &self.options.reward {
            reward = parse_reward(text)?.evaluate(moment);
        }
        if let Some(text) = &self.options.termination {
            ends = holds(parse_termination(text)?.evaluate(moment));
        }
        Ok((reward, ends))
    }
}

impl<R: SimScalar> Drone<R> {
    pub(super) fn show_numbers(&mut self, ledger: &mut dyn Ledger<R>) {
        self.world.show_numbers(0, ledger);
        if let Some(onboard) = &mut self.onboard {
            onboard.show_numbers(0, ledger);
        }
        if let Some(estimator) = &mut self.estimator {
            estimator.show_numbers(ledger);
        }
        ledger.numbers("last_action", &mut self.last_action);
        ledger.numbers("goal", &mut self.goal);
    }

    /// It is under way, with the numbers that it was given.
    pub(super) fn resume(&mut self) {
        if let Some(estimator) = &mut self.estimator {
            estimator.resume();
        }
    }

    pub(super) fn state(&self) -> &State<R> {
        self.world.state(0)
    }

    /// The numbers of an observation; `begun` where the episode begins.
    pub(super) fn observation(
        &mut self,
        options: &Options,
        fields: &[Field],
        row: &[R; OBSERVATION],
        (begun, surroundings): (bool, Surroundings<R>),
    ) -> Vec<R> {
        R::enter("observation");
        if !options.observes() {
            return row.to_vec();
        }
        let begun = begun.then(everywhere::<R>);
        let estimate = self.estimator.as_mut().map(|filter| filter.estimate(begun, row));
        let all = observable(row, self.world.state(0), estimate, &surroundings);
        let within = |field: &Field| {
            let [low, high] = [field.low, field.high].map(R::from_f64);
            all[field.range()].iter().map(|number| number.clamp(low, high)).collect::<Vec<R>>()
        };
        fields.iter().flat_map(within).collect()
    }
}

/// True in every lane.
pub(super) fn everywhere<R: Scalar>() -> R::Mask {
    !R::nothing()
}

/// Hands out the numbers of a start one after the other.
pub(super) struct StartNumbers<'a, R>(pub(super) &'a [R]);

impl<R: Scalar> StartNumbers<'_, R> {
    pub(super) fn take<const N: usize>(&mut self) -> [R; N] {
        let Some((first, rest)) = self.0.split_first_chunk() else { return [R::zero(); N] };
        self.0 = rest;
        *first
    }
}
