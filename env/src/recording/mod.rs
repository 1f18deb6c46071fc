//! An environment as programs: one for the first moment of an episode, one for a tick. They are what a world of
//! symbols wrote down, with every effect, sensor, task and reward in it, and can be written out in any language.

mod parameters;
mod program;
mod several;
mod single;

pub use parameters::{Parameter, ParameterGroup};
pub use program::{Program, StateField, Verdict};
use program::Tape;

use crate::config::Options;
use crate::error::{Error, Result, check_range};
use crate::model::Model;
use crate::noise::{EpisodeKeys, channel};
use crate::observation::{Field, Interface};
use crate::symbol::{Symbol, record};
use crate::task::{self, Start, Task, Visitor};
use crate::vector::VectorEnv;

/// A number or word that a program needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Input {
    /// A number of the state, by its place.
    State(usize),
    /// A word of a drone's noise: the drone, and 0 for the low, 1 for the high word of the episode's key, 2 for the
    /// tick.
    Word(usize, usize),
    /// A number of a drone's action.
    Action(usize, usize),
    /// A parameter, by its group and its place there.
    Parameter(usize, usize),
    /// A number of how the episode starts.
    Start(usize),
}

/// Words of a drone, see [`Input::Word`].
pub const WORDS: usize = 3;

/// An environment, recorded.
#[derive(Debug, Clone)]
pub struct Recording {
    /// What can be chosen.
    pub options: Options,
    /// Seconds per tick.
    pub tick_s: f64,
    /// How many drones fly.
    pub drones: usize,
    /// Parameters of the effects.
    pub parameters: Vec<ParameterGroup>,
    /// What a flight goes on from, besides the words.
    pub state: Vec<StateField>,
    /// Fields of a drone's observation, in order.
    pub observation: Vec<Field>,
    /// From a start to a state and observations.
    pub begin: Program,
    /// From a state and actions to a state, observations, rewards and ends.
    pub tick: Program,
    /// From the words of an episode to those of the next: key, low and high, and one to pick a start by.
    pub fork: Program,
    /// The starts that were drawn.
    pub starts: Vec<EpisodeStart>,
    /// What actions are mapped to, for each drone.
    pub interfaces: Vec<Interface>,
}

/// How an episode starts.
#[derive(Debug, Clone)]
pub struct EpisodeStart {
    /// What each drone's noise is made from.
    pub keys: Vec<u64>,
    /// See [`Input::Start`].
    pub numbers: Vec<f64>,
}

/// Records the environment of these options, with `starts` episodes' starts: those of the seeds from
/// `first_seed` on.
///
/// # Errors
/// As [`VectorEnv::new`]; [`Error::Config`] naming the option that cannot be recorded.
pub fn record_environment(
    models: &[Model],
    options: &Options,
    (first_seed, starts): (u64, usize),
) -> Result<Recording> {
    // everything that a batch refuses is refused here, in the same words
    let batch = VectorEnv::new(models, options, 1)?;
    check_range("starts", starts as f64, 1.0, 1e6)?;
    for (name, given) in [
        ("wind_field", options.wind_field.is_some()),
        ("history", options.history != 1),
        ("watch", !options.watch.is_empty()),
        ("each", !options.each.is_empty()),
    ] {
        if given {
            return Err(Error::Config(format!(
                "{name}: a recorded environment does not have this option; leave it out"
            )));
        }
    }
    let drones = batch.num_drones();
    let models: Vec<&Model> = (0..drones).map(|j| models.get(j).unwrap_or(&models[0])).collect();
    let recorder = Recorder {
        models: &models,
        interfaces: batch.interfaces(),
        options,
        tick_s: batch.tick_s(),
        seeds: (first_seed..first_seed + starts as u64).collect(),
    };
    task::visit(&options.task, options.drones, &options.task_options, recorder)
}

/// Records whatever task there is.
struct Recorder<'a> {
    models: &'a [&'a Model],
    interfaces: &'a [Interface],
    options: &'a Options,
    tick_s: f64,
    seeds: Vec<u64>,
}

impl Recorder<'_> {
    /// Past this an episode is over, as in a batch.
    fn last_s(&self) -> f64 {
        match self.options.max_episode_steps {
            0 => f64::INFINITY,
            steps => (f64::from(steps) - 0.5) * self.tick_s,
        }
    }
}

/// Derives an episode's words from those of another.
fn record_fork() -> Result<Program> {
    let mut tape = Tape::default();
    let (words, graph) = record(|| {
        let [low, high, tick] = [0, 1, 2].map(|i| tape.word(Input::Word(0, i)));
        let keys = EpisodeKeys::<Symbol>::from_words([low, high]);
        let draw = keys.draw(&tick);
        let names = ["next episode, low", "next episode, high", "next start"];
        Ok(names.map(|name| draw.word(channel(name)).id()).to_vec())
    })?;
    Ok(Program {
        graph,
        inputs: tape.inputs,
        state: Vec::new(),
        ticks: words,
        observations: Vec::new(),
        verdicts: Vec::new(),
    })
}

/// The numbers of drones' starts, and of what stands on the board.
fn start_numbers(starts: &[Start], board: &[f64]) -> Vec<f64> {
    let mut numbers = Vec::new();
    for start in starts {
        numbers.extend(start.pos_m);
        numbers.push(start.yaw_rad);
        numbers.extend(start.goal);
    }
    numbers.extend(board);
    numbers
}

impl Visitor for Recorder<'_> {
    type Output = Recording;
    fn visit<T: Task>(self, task: T, drones: usize) -> Result<Recording> {
        if const { T::DRONES == 1 } {
            self.record_single(&task)
        } else {
            self.record_several(&task, drones)
        }
    }
}

#[cfg(test)]
mod tests;
