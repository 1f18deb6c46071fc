//! An environment as it is recorded, and as it is flown in double precision to compare.

use std::marker::PhantomData;

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::EpisodeStart;
use crate::action::{ACTION, Interface};
use crate::archive::Ledger;
use crate::coupling::NEIGHBOUR;
use crate::episode::{
    Alone, At, Coupling, DroneResult, Episode, FlightPlan, Flights, SharedAir, Sight, Sink, Starts,
};
use crate::error::Result;
use crate::estimator::{Estimator, SensorNoise};
use crate::model::Model;
use crate::noise::episode_key;
use crate::observation::{Field, OBSERVATION, Observable, Surroundings, need_estimate, need_truth};
use crate::plant::State;
use crate::scalar::Scalar;
use crate::sim_scalar::SimScalar;
use crate::task::{Start, Task, Visitor};
use crate::world::{RecordedEffect, World};

/// One environment, whatever its task and its number of drones.
pub(super) trait Flight<R: SimScalar> {
    fn drones(&self) -> usize;
    fn world(&mut self, drone: usize) -> &mut World<R>;
    fn effects(&self, drone: usize) -> &[RecordedEffect];
    /// Fields of a drone's own observation.
    fn observed_fields(&self) -> &[Field];
    /// Draws the first episode of a seed, as in a batch whose effects are not drawn.
    fn draw(&self, seed: u64) -> EpisodeStart;
    /// It is under way, with the numbers that it was given.
    fn resume(&mut self);
    /// Begins an episode with the numbers of [`super::EpisodeStart`]: observations, drone by drone.
    fn begin(&mut self, start: &[R]) -> Vec<Vec<R>>;
    /// One tick.
    fn tick(&mut self, actions: &[[R; ACTION]]) -> Vec<DroneTick<R>>;
    /// Shows everything that a drone goes on from.
    fn show_drone(&mut self, drone: usize, ledger: &mut dyn Ledger<R>);
    /// Shows everything that the environment goes on from besides its drones.
    fn show_numbers(&mut self, ledger: &mut dyn Ledger<R>);
}

/// Result of a tick for a drone.
pub(super) struct DroneTick<R: Scalar> {
    pub(super) observation: Vec<R>,
    pub(super) reward: R,
    pub(super) terminated: R::Mask,
    pub(super) truncated: R::Mask,
}

/// An environment of a task.
pub(super) struct RecordedFlight<R: SimScalar, T, C: Coupling<R>> {
    episode: Episode<R, T, C>,
    /// Effects of each drone.
    effects: Vec<Vec<RecordedEffect>>,
    fields: Vec<Field>,
    observers: Vec<RowObserver<R>>,
}

/// Builds the environment of a plan for whatever task there is.
pub(super) struct FlightBuilder<'a, R> {
    pub(super) plan: FlightPlan<'a>,
    pub(super) number: PhantomData<R>,
}

impl<R: SimScalar> Visitor for FlightBuilder<'_, R> {
    type Output = Box<dyn Flight<R>>;
    fn visit<T: Task>(self, task: T, _: usize) -> Result<Box<dyn Flight<R>>> {
        Ok(if const { T::DRONES == 1 } {
            Box::new(RecordedFlight::<R, T, Alone>::new(self.plan, task)?)
        } else {
            Box::new(RecordedFlight::<R, T, SharedAir<R>>::new(self.plan, task)?)
        })
    }
}

/// Turns what a drone measures into what it observes.
struct RowObserver<R: Scalar> {
    /// None where a drone observes what it measures.
    fields: Option<Vec<Field>>,
    estimator: Option<Estimator<R>>,
}

impl<R: SimScalar, T: Task, C: Coupling<R>> RecordedFlight<R, T, C> {
    fn new(plan: FlightPlan<'_>, task: T) -> Result<Self> {
        let FlightPlan { models, interfaces, options, tick_s, .. } = plan;
        let fields = options.observed_fields(T::SURROUNDED)?;
        let observer = |(model, interface): (&&Model, &Interface)| RowObserver {
            fields: options.observes().then(|| fields.clone()),
            estimator: need_estimate(&fields)
                .then(|| Estimator::new(model, interface.input, tick_s, &SensorNoise::default())),
        };
        let observers = models.iter().zip(interfaces).map(observer).collect();
        let mut effects = Vec::new();
        let episode = Episode::new(task, plan, &mut |own, settings| {
            let (world, listed) = World::recorded(models[own], &options.drone_effects(own), settings)?;
            effects.push(listed);
            Ok(world)
        })?;
        Ok(RecordedFlight { episode, effects, fields, observers })
    }
}

impl<R: SimScalar, T: Task, C: Coupling<R>> Flight<R> for RecordedFlight<R, T, C> {
    fn drones(&self) -> usize {
        self.effects.len()
    }

    fn world(&mut self, drone: usize) -> &mut World<R> {
        &mut self.episode.flights.drones.as_mut()[drone].world
    }

    fn effects(&self, drone: usize) -> &[RecordedEffect] {
        &self.effects[drone]
    }

    fn observed_fields(&self) -> &[Field] {
        &self.fields
    }

    fn draw(&self, seed: u64) -> EpisodeStart {
        let (task, drones) = (&self.episode.task, self.drones());
        let key = episode_key(seed, 0);
        let (mut drawn, mut board) = (vec![Start::origin(); drones], vec![0.0; task.board()]);
        task.start(&mut Pcg64Mcg::seed_from_u64(key), &mut drawn, &mut board);
        let mut starts = Starts::<f64>::origin(drones, board.len());
        starts.set_lane(0, &drawn, &board, task.load());
        EpisodeStart {
            keys: (0..drones).map(|drone| C::drone_key(key, drone)).collect(),
            numbers: starts.numbers(task.load().is_some()).into_iter().map(|number| *number).collect(),
        }
    }

    fn resume(&mut self) {
        for observer in &mut self.observers {
            if let Some(estimator) = &mut observer.estimator {
                estimator.resume();
            }
        }
    }

    fn begin(&mut self, start: &[R]) -> Vec<Vec<R>> {
        let mut starts = Starts::origin(self.drones(), self.episode.task.board());
        let slots = starts.numbers(self.episode.task.load().is_some());
        slots.into_iter().zip(start).for_each(|(slot, number)| *slot = *number);
        let mut notes = RowNotes { observers: &mut self.observers, rows: Vec::new(), ticks: Vec::new() };
        self.episode.begin(0, everywhere::<R>(), &starts, &mut notes);
        notes.rows
    }

    fn tick(&mut self, actions: &[[R; ACTION]]) -> Vec<DroneTick<R>> {
        let mut notes = RowNotes { observers: &mut self.observers, rows: Vec::new(), ticks: Vec::new() };
        self.episode.tick(0..1, actions, &mut notes);
        notes.ticks
    }

    fn show_drone(&mut self, drone: usize, ledger: &mut dyn Ledger<R>) {
        self.episode.flights.show_numbers(0, drone, ledger);
        if let Some(estimator) = &mut self.observers[drone].estimator {
            estimator.show_numbers(ledger);
        }
        let slot = self.episode.flights.slot_mut(0, drone);
        ledger.numbers("last_action", &mut slot.last_action);
        ledger.numbers("goal", &mut slot.goal);
    }

    fn show_numbers(&mut self, ledger: &mut dyn Ledger<R>) {
        ledger.numbers("board", self.episode.flights.board_mut(0));
        self.episode.flights.coupling.show_numbers(0, ledger);
    }
}

/// Notes observations and the results of ticks.
struct RowNotes<'a, R: Scalar> {
    observers: &'a mut [RowObserver<R>],
    rows: Vec<Vec<R>>,
    ticks: Vec<DroneTick<R>>,
}

impl<R: SimScalar> RowNotes<'_, R> {
    /// A drone's own numbers, then what it knows of the others; nothing where it does not fly.
    fn observe<C: Coupling<R>>(
        &mut self,
        at: At,
        begun: bool,
        flights: &Flights<R, C>,
        sight: &Sight<'_, R>,
        flies: R::Mask,
    ) -> Vec<R> {
        R::enter("observation");
        let world = &flights.drones.as_ref()[at.own].world;
        let mut numbers = self.observers[at.own].observe(sight, world.state(0), begun);
        if C::ALONE {
            return numbers;
        }
        let drones = flights.drones.as_ref().len();
        for other in (0..drones).filter(|other| *other != at.own) {
            numbers.extend::<[R; NEIGHBOUR]>(flights.coupling.neighbour_row(at, other, world.time_s(0)));
        }
        numbers.into_iter().map(|number| R::select(flies, number, R::zero())).collect()
    }
}

impl<R: SimScalar> RowObserver<R> {
    /// The numbers of an observation; `begun` where the episode begins.
    fn observe(&mut self, sight: &Sight<'_, R>, x: &State<R>, begun: bool) -> Vec<R> {
        let row: &[R; OBSERVATION] = sight.row;
        let Some(fields) = &self.fields else { return row.to_vec() };
        let begun = begun.then(everywhere::<R>);
        let estimate = self.estimator.as_mut().map(|filter| filter.estimate(begun, row));
        let none = Surroundings::none();
        let around = sight.surroundings.unwrap_or(&none);
        let all = Observable::new(need_truth(fields), row, x, estimate, around);
        let within = |field: &Field| {
            let [low, high] = [field.low, field.high].map(R::from_f64);
            all.field(field).iter().map(|number| number.clamp(low, high)).collect::<Vec<R>>()
        };
        fields.iter().flat_map(within).collect()
    }
}

impl<R: SimScalar, C: Coupling<R>> Sink<R, C> for RowNotes<'_, R> {
    fn looks_around(&self) -> bool {
        self.observers.iter().any(|observer| observer.fields.is_some())
    }

    fn begin(&mut self, at: At, _: R::Mask, flights: &Flights<R, C>, sight: &Sight<'_, R>) {
        let row = self.observe(at, true, flights, sight, flights.coupling.flies(0, at.own));
        self.rows.push(row);
    }

    fn tick(&mut self, at: At, flights: &Flights<R, C>, sight: &Sight<'_, R>, result: &DroneResult<'_, R>) {
        let observation = self.observe(at, false, flights, sight, result.flew);
        let DroneResult { reward, terminated, truncated, .. } = *result;
        self.ticks.push(DroneTick { observation, reward, terminated, truncated });
        R::enter("task");
    }
}

/// True in every lane.
fn everywhere<R: Scalar>() -> R::Mask {
    !R::nothing()
}
