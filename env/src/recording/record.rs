//! Running an environment on symbols, and in double precision.

use std::marker::PhantomData;

use super::flight::{Flight, FlightBuilder};
use super::program::{Loader, Notes, Origin, Tape, Verdict, kept_fields};
use super::{
    DoubleFlight, EpisodeStart, Input, ParameterGroup, Program, Recorder, Recording, common_numbers,
};
use crate::action::ACTION;
use crate::archive::Ledger;
use crate::coupling::NEIGHBOUR_FIELDS;
use crate::episode::FlightPlan;
use crate::error::Result;
use crate::rows::state_row;
use crate::scalar::{Scalar, Word};
use crate::sim_scalar::SimScalar;
use crate::symbol::{Symbol, SymbolWord, enter, record};
use crate::task;

/// Shows all numbers: each drone's under its own names, then those of the environment.
fn show_numbers<R: SimScalar>(flight: &mut dyn Flight<R>, ledger: &mut dyn Ledger<R>) {
    let drones = flight.drones();
    for place in 0..drones {
        ledger.begin(if drones > 1 { format!("drone{place}_") } else { String::new() });
        flight.show_drone(place, ledger);
    }
    ledger.begin(String::new());
    flight.show_numbers(ledger);
}

/// Puts inputs in the place of all parameters: of each drone's where they are `apart`, otherwise the same for all.
fn set_parameters(
    flight: &mut dyn Flight<Symbol>,
    tape: &mut Tape,
    apart: bool,
) -> Result<Vec<ParameterGroup>> {
    let mut all = Vec::new();
    for drone in 0..flight.drones() {
        let prefix = if apart { format!("drone{drone}_") } else { String::new() };
        let first = if apart { all.len() } else { 0 };
        all.truncate(first);
        all.extend(flight.effects(drone).iter().map(|effect| ParameterGroup::from_effect(effect, &prefix)));
        for (i, group) in all.iter().enumerate().skip(first) {
            let number = |(j, parameter): (usize, &super::Parameter)| {
                // a count fixes the size of the computation, so it is no symbol
                if parameter.counts {
                    Symbol::from_f64(parameter.value().round())
                } else {
                    tape.number(Input::Parameter(i, j))
                }
            };
            let params: Vec<Symbol> = group.parameters.iter().enumerate().map(number).collect();
            flight.world(drone).set_params(group.effect, &params)?;
        }
    }
    Ok(all)
}

impl Recorder<'_> {
    /// The environment, whose numbers are `R`; within [`record`] where they are symbols.
    fn flight<R: SimScalar>(&self) -> Result<Box<dyn Flight<R>>> {
        let Recorder { models, interfaces, options, tick_s, .. } = *self;
        let plan = FlightPlan { models, interfaces, options, tick_s, tiles: 1 };
        task::visit(
            &options.task,
            options.drones,
            &options.task_options,
            FlightBuilder { plan, number: PhantomData },
        )
    }

    pub(super) fn record(&self) -> Result<Recording> {
        let outside = self.flight::<f64>()?;
        let drones = outside.drones();
        let starts: Vec<EpisodeStart> = self.seeds.iter().map(|seed| outside.draw(*seed)).collect();
        let mut begin = self.record_begin(drones, &common_numbers(&starts))?;
        let mut origins = vec![Origin::Stored; begin.state.len()];
        // with what is known, more may turn out to be known
        let (mut tick, state, parameters) = loop {
            let recorded = self.record_tick(drones, &origins)?;
            let new_origins = recorded.0.origins(&begin, &recorded.1.shown);
            if new_origins == origins {
                break recorded;
            }
            origins = new_origins;
        };
        let needed = tick.needed(state.shown);
        tick.keep(&needed);
        begin.keep(&needed);
        let mut observation = outside.observed_fields().to_vec();
        (1..drones).for_each(|_| observation.extend(NEIGHBOUR_FIELDS));
        Ok(Recording {
            options: self.options.clone(),
            tick_s: self.tick_s,
            drones,
            parameters,
            state: kept_fields(&state.fields, &needed),
            observation,
            begin,
            tick,
            fork: super::record_fork()?,
            starts,
        })
    }

    fn record_begin(&self, drones: usize, numbers: &[Option<f64>]) -> Result<Program> {
        let mut tape = Tape::default();
        let ((notes, observations), graph) = record(|| {
            let mut flight = self.flight::<Symbol>()?;
            set_parameters(&mut *flight, &mut tape, !self.options.each.is_empty())?;
            enter("start");
            for drone in 0..drones {
                let [low, high] = [0, 1].map(|i| tape.word(Input::Word(drone, i)));
                flight.world(drone).set_words([low, high, SymbolWord::from_u32(0)]);
            }
            let number = |(i, known): (usize, &Option<f64>)| {
                known.map_or_else(|| tape.number(Input::Start(i)), Symbol::from_f64)
            };
            let start: Vec<Symbol> = numbers.iter().enumerate().map(number).collect();
            let rows = flight.begin(&start);
            let mut notes = Notes::default();
            show_numbers(&mut *flight, &mut notes);
            Ok((notes, rows))
        })?;
        Ok(Program {
            graph,
            inputs: tape.inputs,
            state: notes.numbers,
            words: Vec::new(),
            observations: observations
                .iter()
                .map(|row| row.iter().map(|number| number.id()).collect())
                .collect(),
            verdicts: Vec::new(),
        })
    }

    fn record_tick(
        &self,
        drones: usize,
        origins: &[Origin],
    ) -> Result<(Program, Notes, Vec<ParameterGroup>)> {
        let mut tape = Tape::default();
        let ((notes, groups, words, results), graph) = record(|| {
            let mut flight = self.flight::<Symbol>()?;
            let groups = set_parameters(&mut *flight, &mut tape, !self.options.each.is_empty())?;
            show_numbers(&mut *flight, &mut Loader { tape: &mut tape, origins: origins.iter(), next: 0 });
            flight.resume();
            let mut actions = Vec::new();
            for drone in 0..drones {
                let world = flight.world(drone);
                let [low, high] = [0, 1].map(|i| tape.word(Input::Word(drone, i)));
                world.set_words([low, high, tape.word(Input::Tick)]);
                world.stop_clock();
                actions.push(std::array::from_fn(|i| tape.number(Input::Action(drone, i))));
            }
            let results = flight.tick(&actions);
            // all drones fly the same tick
            let words = vec![flight.world(0).tick_word().id()];
            (0..drones).for_each(|drone| flight.world(drone).turn_rings());
            let mut notes = Notes::default();
            show_numbers(&mut *flight, &mut notes);
            Ok((notes, groups, words, results))
        })?;
        let ids = |row: &[Symbol]| row.iter().map(|number| number.id()).collect();
        let program = Program {
            graph,
            inputs: tape.inputs,
            state: notes.numbers.clone(),
            words,
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
    pub(super) fn fly_double(&self, actions: &[f64]) -> Result<DoubleFlight> {
        let mut flight = self.flight::<f64>()?;
        let (drones, start) = (flight.drones(), flight.draw(self.seeds.first().copied().unwrap_or(0)));
        for (drone, key) in start.keys.iter().enumerate() {
            let groups: Vec<ParameterGroup> =
                flight.effects(drone).iter().map(|effect| ParameterGroup::from_effect(effect, "")).collect();
            for group in &groups {
                let values: Vec<f64> = group.parameters.iter().map(super::Parameter::value).collect();
                flight.world(drone).set_params(group.effect, &values)?;
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
