//! A recorded program: its inputs, its outputs, and the numbers that matter.

use std::collections::HashMap;

use super::Input;
use crate::archive::Ledger;
use crate::scalar::Scalar;
use crate::symbol::{Binary, Graph, Id, Node, Symbol, SymbolWord};

/// A field of the state or of an observation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StateField {
    /// Name, with the unit as its suffix where it has one.
    pub name: String,
    /// Number of values.
    pub length: usize,
}

/// Operations with their inputs and outputs.
#[derive(Debug, Clone)]
pub struct Program {
    /// The computation.
    pub graph: Graph,
    /// Meaning of the graph's inputs.
    pub inputs: Vec<Input>,
    /// The numbers of the state afterwards, in the order of [`super::Recording::state`].
    pub state: Vec<Id>,
    /// The word of the tick afterwards, or those of the next episode; empty where an episode begins, at tick 0.
    pub words: Vec<Id>,
    /// Observations, drone by drone.
    pub observations: Vec<Vec<Id>>,
    /// Verdicts of a tick, drone by drone; empty at the beginning of an episode.
    pub verdicts: Vec<Verdict>,
}

/// Verdict of a tick for a drone.
#[derive(Debug, Clone, Copy)]
pub struct Verdict {
    /// Number.
    pub reward: Id,
    /// Flag: ended by the task, or broken.
    pub terminated: Id,
    /// Flag: out of time.
    pub truncated: Id,
}

/// Hands out inputs, each once.
#[derive(Debug, Default)]
pub(super) struct Tape {
    pub(super) inputs: Vec<Input>,
    places: HashMap<Input, usize>,
}

impl Tape {
    fn place(&mut self, input: Input) -> usize {
        let next = self.inputs.len();
        let place = *self.places.entry(input).or_insert(next);
        if place == next {
            self.inputs.push(input);
        }
        place
    }
    pub(super) fn number(&mut self, input: Input) -> Symbol {
        Symbol::input(self.place(input))
    }
    pub(super) fn word(&mut self, input: Input) -> SymbolWord {
        SymbolWord::input(self.place(input))
    }
}

/// Source of a number of the state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Origin {
    /// It is stored.
    Stored,
    /// It is this number in every flight and at every moment.
    Constant(f64),
    /// It is the number of the tick.
    Count,
}

/// Puts inputs in place of the numbers that a flight goes on from.
pub(super) struct Loader<'a> {
    pub(super) tape: &'a mut Tape,
    pub(super) origins: std::slice::Iter<'a, Origin>,
    pub(super) next: usize,
}

impl Ledger<Symbol> for Loader<'_> {
    fn numbers(&mut self, _: &str, numbers: &mut [Symbol]) {
        for number in numbers {
            *number = match self.origins.next().copied().unwrap_or(Origin::Stored) {
                Origin::Stored => self.tape.number(Input::State(self.next)),
                Origin::Constant(value) => Symbol::from_f64(value),
                Origin::Count => self.tape.number(Input::Count),
            };
            self.next += 1;
        }
    }
}

/// The true state is there whether anything depends on it or not, and who flies.
const SHOWN: [&str; 5] = ["pos_m", "vel_mps", "att_rad", "rate_radps", "flies"];

/// Notes the numbers that a flight goes on from.
#[derive(Default)]
pub(super) struct Notes {
    pub(super) fields: Vec<StateField>,
    pub(super) numbers: Vec<Id>,
    /// Numbers that are there whether anything depends on them or not, see [`SHOWN`].
    pub(super) shown: Vec<bool>,
    /// Put before every name.
    pub(super) prefix: String,
}

impl Ledger<Symbol> for Notes {
    fn begin(&mut self, prefix: String) {
        self.prefix = prefix;
    }

    fn numbers(&mut self, name: &str, numbers: &mut [Symbol]) {
        if numbers.is_empty() {
            return;
        }
        self.fields.push(StateField { name: format!("{}{name}", self.prefix), length: numbers.len() });
        self.numbers.extend(numbers.iter().map(|number| number.id()));
        self.shown.extend(numbers.iter().map(|_| SHOWN.contains(&name)));
    }
}

impl Program {
    /// Returns every output besides numbers of the state.
    fn results(&self) -> Vec<Id> {
        let verdicts = self.verdicts.iter().flat_map(|v| [v.reward, v.terminated, v.truncated]);
        self.observations
            .iter()
            .flatten()
            .copied()
            .chain(verdicts)
            .chain(self.words.iter().copied())
            .collect()
    }

    /// Returns where the numbers of the state come from, for a tick's program; `begun` are their values where a flight
    /// begins. Those that are `shown` are stored.
    pub(super) fn origins(&self, begun: &Program, shown: &[bool]) -> Vec<Origin> {
        let nodes = self.graph.nodes();
        let origin = |i: usize| {
            let first = begun.graph.number(begun.state[i]).filter(|_| !shown[i]);
            let from = |id: Id, input: Input| matches!(nodes[id as usize], Node::Input(_, place) if self.inputs[place] == input);
            let (id, value) = (self.state[i], |id| self.graph.number(id));
            match (first, nodes[id as usize]) {
                (Some(0.0), Node::Binary(Binary::Add, last, one))
                    if value(one) == Some(1.0)
                        && (from(last, Input::State(i)) || from(last, Input::Count)) =>
                {
                    Origin::Count
                }
                (Some(first), _) if from(id, Input::State(i)) || value(id) == Some(first) => {
                    Origin::Constant(first)
                }
                _ => Origin::Stored,
            }
        };
        (0..self.state.len()).map(origin).collect()
    }

    /// Returns the numbers of the state that any output depends on, now or later, and those that `shown` names; as a
    /// flag for each.
    pub(super) fn needed(&self, mut shown: Vec<bool>) -> Vec<bool> {
        loop {
            let kept = self.state.iter().zip(&shown).filter(|(_, on)| **on).map(|(id, _)| *id);
            let live = self.graph.live(self.results().into_iter().chain(kept));
            let mut grown = false;
            for (node, live) in self.graph.nodes().iter().zip(&live) {
                if let (true, Node::Input(_, place)) = (*live, node)
                    && let Input::State(number) = self.inputs[*place]
                    && !shown[number]
                {
                    (shown[number], grown) = (true, true);
                }
            }
            if !grown {
                return shown;
            }
        }
    }

    /// The same program without the numbers of the state that are not `needed`.
    pub(super) fn keep(&mut self, needed: &[bool]) {
        let mut place = Vec::with_capacity(needed.len());
        let mut next = 0;
        for on in needed {
            place.push(next);
            next += usize::from(*on);
        }
        for input in &mut self.inputs {
            if let Input::State(number) = input {
                *number = if needed[*number] { place[*number] } else { usize::MAX };
            }
        }
        let mut flags = needed.iter();
        self.state.retain(|_| flags.next().copied().unwrap_or(false));
    }

    /// Marks the nodes that results and state are made of.
    pub fn live_nodes(&self) -> Vec<bool> {
        self.graph.live(self.results().into_iter().chain(self.state.iter().copied()))
    }
}

/// The fields with the numbers that are needed.
pub(super) fn kept_fields(fields: &[StateField], needed: &[bool]) -> Vec<StateField> {
    let mut flags = needed.iter();
    let kept = fields.iter().map(|field| {
        let length = flags.by_ref().take(field.length).filter(|on| **on).count();
        StateField { name: field.name.clone(), length }
    });
    kept.filter(|field| field.length > 0).collect()
}
