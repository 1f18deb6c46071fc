//! Running an environment on symbols, and in double precision.

use super::flight::{Flight, Plan};
use super::program::{Loader, Notes, Tape, Verdict, kept_fields};
use super::several::{self, SwarmFlight};
use super::single::{self, SingleFlight};
use super::{DoubleFlight, EpisodeStart, Input, ParameterGroup, Program, Recorder, Recording};
use crate::action::ACTION;
use crate::archive::Ledger;
use crate::coupling::NEIGHBOUR_FIELDS;
use crate::error::Result;
use crate::observation::Field;
use crate::rows::state_row;
use crate::scalar::{Scalar, Word};
use crate::sim_scalar::SimScalar;
use crate::symbol::{Symbol, SymbolWord, enter, record};
use crate::task::Task;

fn flight<'a, R: SimScalar, T: Task>(
    plan: Plan<'a>,
    task: &'a T,
    drones: usize,
) -> Result<Box<dyn Flight<R> + 'a>> {
    if const { T::DRONES == 1 } {
        Ok(Box::new(SingleFlight::<R, T>::new(plan, task)?))
    } else {
        Ok(Box::new(SwarmFlight::<R, T>::new(plan, task, drones)?))
    }
}

/// Shows all numbers: each drone's under its own names, then those of the environment.
fn show_numbers<R: SimScalar>(flight: &mut dyn Flight<R>, ledger: &mut dyn DroneLedger<R>) {
    let several = flight.drones().len() > 1;
    for (place, drone) in flight.drones().iter_mut().enumerate() {
        ledger.begin(if several { format!("drone{place}_") } else { String::new() });
        drone.show_numbers(ledger.ledger());
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
    for drone in flight.drones() {
        groups = drone.effects.iter().map(ParameterGroup::from_effect).collect();
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
            drone.world.set_params(group.name, &params)?;
        }
    }
    Ok(groups)
}

impl Recorder<'_> {
    fn plan(&self) -> Plan<'_> {
        Plan { models: self.models, interfaces: self.interfaces, options: self.options, tick_s: self.tick_s }
    }

    fn start<T: Task>(&self, task: &T, drones: usize, seed: u64) -> EpisodeStart {
        if const { T::DRONES == 1 } {
            single::draw_start(task, seed)
        } else {
            several::draw_start(task, drones, seed)
        }
    }

    pub(super) fn record<T: Task>(self, task: &T, drones: usize) -> Result<Recording> {
        let starts: Vec<EpisodeStart> =
            self.seeds.iter().map(|seed| self.start(task, drones, *seed)).collect();
        let numbers = starts.first().map_or(0, |start| start.numbers.len());
        let mut begin = self.record_begin(task, drones, numbers)?;
        let (mut tick, state, parameters) = self.record_tick(task, drones)?;
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
        let mut fields = self.plan().fields::<T>()?;
        for _ in 1..drones {
            fields.extend(NEIGHBOUR_FIELDS);
        }
        Ok(fields)
    }

    fn record_begin<T: Task>(&self, task: &T, drones: usize, numbers: usize) -> Result<Program> {
        let mut tape = Tape::default();
        let ((notes, observations), graph) = record(|| {
            let mut flight = flight::<Symbol, T>(self.plan(), task, drones)?;
            set_parameters(&mut *flight, &mut tape)?;
            enter("start");
            for (place, drone) in flight.drones().iter_mut().enumerate() {
                let [low, high] = [0, 1].map(|i| tape.word(Input::Word(place, i)));
                drone.world.set_words([low, high, SymbolWord::from_u32(0)]);
            }
            let start: Vec<Symbol> = (0..numbers).map(|i| tape.number(Input::Start(i))).collect();
            let rows = flight.begin(&start);
            let mut notes = Notes::default();
            show_numbers(&mut *flight, &mut notes);
            Ok((notes, rows))
        })?;
        Ok(Program {
            graph,
            inputs: tape.inputs,
            state: notes.numbers,
            ticks: Vec::new(),
            observations: observations
                .iter()
                .map(|row| row.iter().map(|number| number.id()).collect())
                .collect(),
            verdicts: Vec::new(),
        })
    }

    fn record_tick<T: Task>(&self, task: &T, drones: usize) -> Result<(Program, Notes, Vec<ParameterGroup>)> {
        let mut tape = Tape::default();
        let ((notes, groups, words, results), graph) = record(|| {
            let mut flight = flight::<Symbol, T>(self.plan(), task, drones)?;
            let groups = set_parameters(&mut *flight, &mut tape)?;
            show_numbers(&mut *flight, &mut Loader { tape: &mut tape, next: 0 });
            let mut actions = Vec::new();
            for (place, drone) in flight.drones().iter_mut().enumerate() {
                drone.resume();
                drone.world.set_words([0, 1, 2].map(|i| tape.word(Input::Word(place, i))));
                drone.world.stop_clock();
                actions.push(std::array::from_fn(|i| tape.number(Input::Action(place, i))));
            }
            let results = flight.tick(&actions)?;
            let words: Vec<_> = flight.drones().iter().map(|drone| drone.world.tick_word().id()).collect();
            flight.drones().iter_mut().for_each(|drone| drone.world.turn_rings());
            let mut notes = Notes::default();
            show_numbers(&mut *flight, &mut notes);
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
    pub(super) fn fly_double<T: Task>(
        self,
        task: &T,
        drones: usize,
        actions: &[f64],
    ) -> Result<DoubleFlight> {
        let seed = self.seeds.first().copied().unwrap_or(0);
        let start = self.start(task, drones, seed);
        let mut flight = flight::<f64, T>(self.plan(), task, drones)?;
        for (drone, key) in flight.drones().iter_mut().zip(&start.keys) {
            let groups: Vec<ParameterGroup> = drone.effects.iter().map(ParameterGroup::from_effect).collect();
            for group in &groups {
                let values: Vec<f64> = group.parameters.iter().map(super::Parameter::value).collect();
                drone.world.set_params(group.name, &values)?;
            }
            drone.world.set_words([*key as u32, (*key >> 32) as u32, 0]);
        }
        let mut out =
            DoubleFlight { observations: flight.begin(&start.numbers).concat(), ..DoubleFlight::default() };
        for row in actions.chunks_exact(ACTION * drones) {
            let actions: Vec<[f64; ACTION]> =
                row.chunks_exact(ACTION).map(|own| std::array::from_fn(|i| own[i])).collect();
            for result in flight.tick(&actions)? {
                out.observations.extend(result.observation);
                out.rewards.push(result.reward);
                out.terminated.push(result.terminated);
                out.truncated.push(result.truncated);
            }
            for drone in flight.drones() {
                out.states.extend(state_row(drone.state()));
            }
        }
        Ok(out)
    }
}
