//! Running an environment on symbols, and in double precision.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::flight::{Flight, RecordedFlight};
use super::program::{Loader, Notes, Tape, Verdict, kept_fields};
use super::{DoubleFlight, EpisodeStart, Input, ParameterGroup, Program, Recorder, Recording};
use crate::action::ACTION;
use crate::archive::Ledger;
use crate::coupling::NEIGHBOUR_FIELDS;
use crate::episode::{Coupling, FlightPlan, Starts};
use crate::error::Result;
use crate::noise::episode_key;
use crate::observation::Field;
use crate::rows::state_row;
use crate::scalar::{Scalar, Word};
use crate::sim_scalar::SimScalar;
use crate::symbol::{Symbol, SymbolWord, enter, record};
use crate::task::{Start, Task};

/// Shows all numbers: each drone's under its own names, then those of the environment.
fn show_numbers<R: SimScalar>(flight: &mut dyn Flight<R>, ledger: &mut dyn DroneLedger<R>) {
    let drones = flight.drones();
    for place in 0..drones {
        ledger.begin(if drones > 1 { format!("drone{place}_") } else { String::new() });
        flight.show_drone(place, ledger.ledger());
    }
    ledger.begin(String::new());
    flight.show_numbers(ledger.ledger());
}

/// A ledger that names drones apart.
trait DroneLedger<R> {
    fn begin(&mut self, prefix: String);
    fn ledger(&mut self) -> &mut dyn Ledger<R>;
}

impl DroneLedger<Symbol> for Loader<'_> {
    fn begin(&mut self, _: String) {}
    fn ledger(&mut self) -> &mut dyn Ledger<Symbol> {
        self
    }
}

impl DroneLedger<Symbol> for Notes {
    fn begin(&mut self, prefix: String) {
        self.prefix = prefix;
    }
    fn ledger(&mut self) -> &mut dyn Ledger<Symbol> {
        self
    }
}

/// Puts inputs in the place of all parameters. All drones have the same effects, hence the same inputs.
fn set_parameters(flight: &mut dyn Flight<Symbol>, tape: &mut Tape) -> Result<Vec<ParameterGroup>> {
    let mut groups = Vec::new();
    for drone in 0..flight.drones() {
        groups = flight.effects(drone).iter().map(ParameterGroup::from_effect).collect();
        for (i, group) in groups.iter().enumerate() {
            let number = |(j, parameter): (usize, &super::Parameter)| {
                // how much there is to compute must be known before
                if parameter.counts {
                    Symbol::from_f64(parameter.value().round())
                } else {
                    tape.number(Input::Parameter(i, j))
                }
            };
            let params: Vec<Symbol> = group.parameters.iter().enumerate().map(number).collect();
            flight.world(drone).set_params(group.name, &params)?;
        }
    }
    Ok(groups)
}

impl Recorder<'_> {
    fn plan(&self) -> FlightPlan<'_> {
        let Recorder { models, interfaces, options, tick_s, .. } = *self;
        FlightPlan { models, interfaces, options, tick_s, tiles: 1 }
    }

    /// Draws the first episode of a seed, as in a batch whose effects are not drawn.
    fn start<R: SimScalar, T: Task, C: Coupling<R>>(
        &self,
        task: &T,
        drones: usize,
        seed: u64,
    ) -> EpisodeStart {
        let key = episode_key(seed, 0);
        let (mut drawn, mut board) = (vec![Start::origin(); drones], vec![0.0; task.board()]);
        task.start(&mut Pcg64Mcg::seed_from_u64(key), &mut drawn, &mut board);
        let mut starts = Starts::<f64>::origin(drones, board.len());
        starts.set_lane(0, &drawn, &board, task.load());
        EpisodeStart {
            keys: (0..drones).map(|drone| C::drone_key(key, drone)).collect(),
            numbers: starts.numbers(task.load().is_some()),
        }
    }

    pub(super) fn record<T: Task, C: Coupling<Symbol>>(self, task: T, drones: usize) -> Result<Recording> {
        let starts: Vec<EpisodeStart> =
            self.seeds.iter().map(|seed| self.start::<Symbol, T, C>(&task, drones, *seed)).collect();
        let numbers = starts.first().map_or(0, |start| start.numbers.len());
        let (mut begin, task) = self.record_begin::<T, C>(task, drones, numbers)?;
        let (mut tick, state, parameters) = self.record_tick::<T, C>(task, drones)?;
        let needed = tick.needed(state.shown);
        tick.keep(&needed);
        begin.keep(&needed);
        Ok(Recording {
            options: self.options.clone(),
            tick_s: self.tick_s,
            drones,
            parameters,
            state: kept_fields(&state.fields, &needed),
            observation: self.observation_fields::<T>(drones)?,
            begin,
            tick,
            fork: super::record_fork()?,
            starts,
        })
    }

    /// A drone's own fields, then those of the others.
    fn observation_fields<T: Task>(&self, drones: usize) -> Result<Vec<Field>> {
        let mut fields = self.options.observed_fields(T::SURROUNDED)?;
        for _ in 1..drones {
            fields.extend(NEIGHBOUR_FIELDS);
        }
        Ok(fields)
    }

    fn record_begin<T: Task, C: Coupling<Symbol>>(
        &self,
        task: T,
        drones: usize,
        numbers: usize,
    ) -> Result<(Program, T)> {
        let mut tape = Tape::default();
        let ((notes, observations, task), graph) = record(|| {
            let mut flight = RecordedFlight::<Symbol, T, C>::new(self.plan(), task)?;
            set_parameters(&mut flight, &mut tape)?;
            enter("start");
            for drone in 0..drones {
                let [low, high] = [0, 1].map(|i| tape.word(Input::Word(drone, i)));
                flight.world(drone).set_words([low, high, SymbolWord::from_u32(0)]);
            }
            let start: Vec<Symbol> = (0..numbers).map(|i| tape.number(Input::Start(i))).collect();
            let rows = flight.begin(&start);
            let mut notes = Notes::default();
            show_numbers(&mut flight, &mut notes);
            Ok((notes, rows, flight.into_task()))
        })?;
        let program = Program {
            graph,
            inputs: tape.inputs,
            state: notes.numbers,
            ticks: Vec::new(),
            observations: observations
                .iter()
                .map(|row| row.iter().map(|number| number.id()).collect())
                .collect(),
            verdicts: Vec::new(),
        };
        Ok((program, task))
    }

    fn record_tick<T: Task, C: Coupling<Symbol>>(
        &self,
        task: T,
        drones: usize,
    ) -> Result<(Program, Notes, Vec<ParameterGroup>)> {
        let mut tape = Tape::default();
        let ((notes, groups, words, results), graph) = record(|| {
            let mut flight = RecordedFlight::<Symbol, T, C>::new(self.plan(), task)?;
            let groups = set_parameters(&mut flight, &mut tape)?;
            show_numbers(&mut flight, &mut Loader { tape: &mut tape, next: 0 });
            flight.resume();
            let mut actions = Vec::new();
            for drone in 0..drones {
                let world = flight.world(drone);
                world.set_words([0, 1, 2].map(|i| tape.word(Input::Word(drone, i))));
                world.stop_clock();
                actions.push(std::array::from_fn(|i| tape.number(Input::Action(drone, i))));
            }
            let results = flight.tick(&actions);
            let words: Vec<_> = (0..drones).map(|drone| flight.world(drone).tick_word().id()).collect();
            (0..drones).for_each(|drone| flight.world(drone).turn_rings());
            let mut notes = Notes::default();
            show_numbers(&mut flight, &mut notes);
            Ok((notes, groups, words, results))
        })?;
        let ids = |row: &[Symbol]| row.iter().map(|number| number.id()).collect();
        let program = Program {
            graph,
            inputs: tape.inputs,
            state: notes.numbers.clone(),
            ticks: words,
            observations: results.iter().map(|result| ids(&result.observation)).collect(),
            verdicts: results
                .iter()
                .map(|result| Verdict {
                    reward: result.reward.id(),
                    terminated: result.terminated.id(),
                    truncated: result.truncated.id(),
                })
                .collect(),
        };
        Ok((program, notes, groups))
    }

    /// Flies the episode of a seed in double precision, with the effects' own values; it is not reset at its end.
    pub(super) fn fly_double<T: Task, C: Coupling<f64>>(
        self,
        task: T,
        drones: usize,
        actions: &[f64],
    ) -> Result<DoubleFlight> {
        let seed = self.seeds.first().copied().unwrap_or(0);
        let start = self.start::<f64, T, C>(&task, drones, seed);
        let mut flight = RecordedFlight::<f64, T, C>::new(self.plan(), task)?;
        for (drone, key) in start.keys.iter().enumerate() {
            let groups: Vec<ParameterGroup> =
                flight.effects(drone).iter().map(ParameterGroup::from_effect).collect();
            for group in &groups {
                let values: Vec<f64> = group.parameters.iter().map(super::Parameter::value).collect();
                flight.world(drone).set_params(group.name, &values)?;
            }
            flight.world(drone).set_words([*key as u32, (*key >> 32) as u32, 0]);
        }
        let mut out =
            DoubleFlight { observations: flight.begin(&start.numbers).concat(), ..DoubleFlight::default() };
        for row in actions.chunks_exact(ACTION * drones) {
            let actions: Vec<[f64; ACTION]> =
                row.chunks_exact(ACTION).map(|own| std::array::from_fn(|i| own[i])).collect();
            for result in flight.tick(&actions) {
                out.observations.extend(result.observation);
                out.rewards.push(result.reward);
                out.terminated.push(result.terminated);
                out.truncated.push(result.truncated);
            }
            for drone in 0..drones {
                out.states.extend(state_row(flight.world(drone).state(0)));
            }
        }
        Ok(out)
    }
}
