//! Recording an environment of one drone.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::parameters::set_parameters;
use super::program::{Loader, Notes, Tape, Verdict, kept_fields};
use super::{EpisodeStart, Input, ParameterGroup, Program, Recorder, Recording, StateField, WORDS, start_numbers};
use crate::action::Onboard;
use crate::archive::Ledger;
use crate::effects::Reading;
use crate::episode::{TickResult, first_row, judge_tick, lift_before};
use crate::error::{Error, Result};
use crate::estimator::{Estimator, SensorNoise};
use crate::expression::{Moment, holds, parse_reward, parse_termination};
use crate::noise::episode_key;
use crate::observation::{
    ACTION, Field, OBSERVATION, is_of_surroundings, need_estimate, observable,
};
use crate::plant::{Command, State};
use crate::scalar::{Scalar, Word};
use crate::symbol::{Id, Symbol, SymbolWord, enter, record};
use crate::task::{GOAL, Start, Task};
use crate::world::{Settings, World};

/// What is recorded of a drone: all that a batch keeps of a tile.
struct Flight {
    world: World<Symbol>,
    onboard: Option<Onboard<Symbol>>,
    estimator: Option<Estimator<Symbol>>,
    last_action: [Symbol; ACTION],
    goal: [Symbol; GOAL],
    board: Vec<Symbol>,
}

/// The true state is there whether anything depends on it or not.
const SHOWN: [&str; 4] = ["pos_m", "vel_mps", "att_rad", "rate_radps"];

impl Flight {
    fn show_numbers(&mut self, ledger: &mut impl Ledger<Symbol>) {
        self.world.show_numbers(0, ledger);
        if let Some(onboard) = &mut self.onboard {
            onboard.show_numbers(0, ledger);
        }
        if let Some(estimator) = &mut self.estimator {
            estimator.show_numbers(ledger);
        }
        ledger.numbers("last_action", &mut self.last_action);
        ledger.numbers("goal", &mut self.goal);
        ledger.numbers("board", &mut self.board);
    }
}

impl Recorder<'_> {
    pub(super) fn record_single<T: Task>(self, task: &T) -> Result<Recording> {
        let fields = self.options.observation.sources()?;
        if let Some(field) = fields.iter().find(|field| !T::SURROUNDED && is_of_surroundings(field)) {
            return Err(Error::Config(format!(
                "observation: the task {} has no gates and no obstacles, hence no field {:?}",
                self.options.task, field.name
            )));
        }
        let (begin, _, _) = self.record_begin(task, &fields)?;
        let (mut tick, state, parameters) = self.record_tick(task, &fields)?;
        let mut begin = begin;
        let shown = state.iter().flat_map(|f| vec![SHOWN.contains(&f.name.as_str()); f.length]).collect();
        let needed = tick.needed(shown);
        tick.keep(&needed);
        begin.keep(&needed);
        Ok(Recording {
            options: self.options.clone(),
            tick_s: self.tick_s,
            drones: 1,
            parameters,
            state: kept_fields(&state, &needed),
            observation: fields,
            begin,
            tick,
            fork: super::record_fork()?,
            starts: self.seeds.iter().map(|seed| draw_start(task, *seed)).collect(),
            interfaces: self.interfaces.to_vec(),
        })
    }

    /// A drone with inputs in place of its parameters.
    fn flight<T: Task>(
        &self,
        task: &T,
        fields: &[Field],
        tape: &mut Tape,
    ) -> Result<(Flight, Vec<ParameterGroup>)> {
        let (model, interface) = (self.models[0], &self.interfaces[0]);
        let settings = Settings { input: interface.input, physics_hz: self.options.physics_hz };
        let (world, effects) = World::recorded(model, &self.options.drone_effects(0), settings)?;
        let mut world = world.at_level(self.options.action);
        let groups: Vec<ParameterGroup> = effects.iter().map(ParameterGroup::from_effect).collect();
        set_parameters(&mut world, &groups, tape)?;
        let estimator = need_estimate(fields).then(|| {
            let mut filter = Estimator::new(model, interface.input, self.tick_s, &SensorNoise::default());
            filter.resume();
            filter
        });
        let flight = Flight {
            world,
            onboard: Onboard::new(model, interface, self.tick_s, 1)?,
            estimator,
            last_action: [Symbol::zero(); ACTION],
            goal: [Symbol::zero(); GOAL],
            board: vec![Symbol::zero(); task.board()],
        };
        Ok((flight, groups))
    }

    fn record_begin<T: Task>(
        &self,
        task: &T,
        fields: &[Field],
    ) -> Result<(Program, Vec<StateField>, Vec<ParameterGroup>)> {
        let mut tape = Tape::default();
        let ((notes, groups, observation), graph) = record(|| {
            let (mut flight, groups) = self.flight(task, fields, &mut tape)?;
            enter("start");
            let (low, high) = (tape.word(Input::Word(0, 0)), tape.word(Input::Word(0, 1)));
            flight.world.set_words([low, high, SymbolWord::from_u32(0)]);
            let mut start = (0..).map(|i| Input::Start(i));
            let mut next = || tape.number(start.next().unwrap_or(Input::Start(0)));
            let mut x = State::<Symbol>::rest();
            x.pos_m = [next(), next(), next()];
            x.att_rad[2] = next();
            flight.goal.iter_mut().for_each(|slot| *slot = next());
            flight.board.iter_mut().for_each(|slot| *slot = next());
            let observation = self.begin(task, fields, &mut flight, &x);
            let mut notes = Notes::default();
            flight.show_numbers(&mut notes);
            Ok((notes, groups, observation))
        })?;
        let program = Program {
            graph,
            inputs: tape.inputs,
            state: notes.numbers,
            ticks: Vec::new(),
            observations: vec![observation],
            verdicts: Vec::new(),
        };
        Ok((program, notes.fields, groups))
    }

    /// The first moment of an episode.
    fn begin<T: Task>(&self, task: &T, fields: &[Field], flight: &mut Flight, x: &State<Symbol>) -> Vec<Id> {
        let (interface, everywhere) = (&self.interfaces[0], World::everywhere());
        let u = Command::level(lift_before(interface, x.pos_m[2]));
        flight.last_action = interface.action_before(x, &u);
        if let Some(onboard) = &mut flight.onboard {
            onboard.start(0, everywhere);
        }
        let reading: Reading<Symbol> = flight.world.start(0, everywhere, x, &u);
        enter("task");
        let Flight { world, goal, board, last_action, .. } = flight;
        let row = first_row(task, world, 0, goal, board, (&reading, last_action));
        self.observation(task, fields, flight, &row, Some(everywhere))
    }

    fn record_tick<T: Task>(
        &self,
        task: &T,
        fields: &[Field],
    ) -> Result<(Program, Vec<StateField>, Vec<ParameterGroup>)> {
        let mut tape = Tape::default();
        let ((notes, groups, tick, observation, verdict), graph) = record(|| {
            let (mut flight, groups) = self.flight(task, fields, &mut tape)?;
            flight.show_numbers(&mut Loader { tape: &mut tape, next: 0 });
            let words = [0, 1, 2].map(|i| tape.word(Input::Word(0, i)));
            flight.world.set_words(words);
            flight.world.stop_clock();
            let action = std::array::from_fn(|i| tape.number(Input::Action(0, i)));
            let (observation, verdict) = self.tick(task, fields, &mut flight, &action)?;
            flight.world.turn_rings();
            let mut notes = Notes::default();
            flight.show_numbers(&mut notes);
            Ok((notes, groups, flight.world.tick_word().id(), observation, verdict))
        })?;
        let program = Program {
            graph,
            inputs: tape.inputs,
            state: notes.numbers,
            ticks: vec![tick],
            observations: vec![observation],
            verdicts: vec![verdict],
        };
        debug_assert_eq!(WORDS, 3);
        Ok((program, notes.fields, groups))
    }

    /// A tick, as a batch steps it.
    fn tick<T: Task>(
        &self,
        task: &T,
        fields: &[Field],
        flight: &mut Flight,
        action: &[Symbol; ACTION],
    ) -> Result<(Vec<Id>, Verdict)> {
        enter("command");
        let interface = &self.interfaces[0];
        let command = match &mut flight.onboard {
            None => interface.command(action),
            Some(onboard) => onboard.command(0, action, flight.world.state(0)),
        };
        enter("model");
        let tick = flight.world.step(0, &command);
        enter("task");
        let Flight { world, goal, board, last_action, .. } = flight;
        let result = TickResult { tile: 0, action, last_action, tick: &tick };
        let judged = judge_tick(task, world, goal, board, &result);
        let moment = Moment {
            own: &judged.row,
            x: world.state(0),
            setpoint: &judged.setpoint,
            last_action,
            impact_mps: tick.contact.impact_mps,
            now_s: judged.now_s,
            broken: judged.broken,
            arrived: judged.arrived,
            task_reward: judged.reward,
        };
        let (mut reward, mut ends) = (judged.reward, judged.ends);
        if let Some(text) = &self.options.reward {
            reward = parse_reward(text)?.evaluate(&moment);
        }
        if let Some(text) = &self.options.termination {
            ends = holds(parse_termination(text)?.evaluate(&moment));
        }
        let verdict = Verdict {
            reward: reward.id(),
            terminated: (ends | judged.broken).id(),
            truncated: judged.now_s.gt(Symbol::from_f64(self.last_s())).id(),
        };
        flight.last_action = *action;
        Ok((self.observation(task, fields, flight, &judged.row, None), verdict))
    }

    /// The numbers of an observation.
    fn observation<T: Task>(
        &self,
        task: &T,
        fields: &[Field],
        flight: &mut Flight,
        row: &[Symbol; OBSERVATION],
        begun: Option<<Symbol as Scalar>::Mask>,
    ) -> Vec<Id> {
        enter("observation");
        if !self.options.observes() {
            return row.iter().map(|number| number.id()).collect();
        }
        let estimate = flight.estimator.as_mut().map(|filter| filter.estimate(begun, row));
        let x = flight.world.state(0);
        let surroundings = task.surroundings(&x.pos_m, &flight.goal, &flight.board);
        let all = observable(row, x, estimate, &surroundings);
        let within = |field: &Field| {
            let [low, high] = [field.low, field.high].map(Symbol::from_f64);
            all[field.range()].iter().map(|number| number.clamp(low, high).id()).collect::<Vec<Id>>()
        };
        fields.iter().flat_map(within).collect()
    }
}

/// How the first episode of a seed starts, as in a batch whose effects are not drawn.
fn draw_start<T: Task>(task: &T, seed: u64) -> EpisodeStart {
    let key = episode_key(seed, 0);
    let mut start = Start { pos_m: [0.0; 3], yaw_rad: 0.0, goal: [0.0; GOAL] };
    let mut board = vec![0.0; task.board()];
    task.start(&mut Pcg64Mcg::seed_from_u64(key), std::slice::from_mut(&mut start), &mut board);
    EpisodeStart { keys: vec![key], numbers: start_numbers(&[start], &board) }
}
