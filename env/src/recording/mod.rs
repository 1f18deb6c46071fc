//! An environment as programs: one for the first moment of an episode, one for a tick. They are what a world of
//! symbols wrote down, with every effect, sensor, task and reward in it, and can be written out in any language.

mod flight;
mod parameters;
mod program;
mod record;

pub use parameters::{Parameter, ParameterGroup};
use program::Tape;
pub use program::{Program, StateField, Verdict};

use crate::action::{ACTION, Interface};
use crate::config::Options;
use crate::coupling::Knowledge;
use crate::error::{Error, Result, check_length, check_range};
use crate::model::Model;
use crate::noise::{EpisodeKeys, channel};
use crate::observation::Field;
use crate::symbol::{Symbol, record};
use crate::vector::VectorEnv;

/// A number or word that a program needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Input {
    /// A number of the state, by its place.
    State(usize),
    /// A word of the key of a drone's episode: the drone, and 0 for the low, 1 for the high one.
    Word(usize, usize),
    /// The word of the tick, counted from the episode's first.
    Tick,
    /// The same as a number.
    Count,
    /// A number of a drone's action.
    Action(usize, usize),
    /// A parameter, by its group and its place there.
    Parameter(usize, usize),
    /// A number of how the episode starts.
    Start(usize),
}

/// An environment, recorded.
#[derive(Debug, Clone)]
pub struct Recording {
    /// The options.
    pub options: Options,
    /// Seconds per tick.
    pub tick_s: f64,
    /// Number of drones.
    pub drones: usize,
    /// Parameters of the effects.
    pub parameters: Vec<ParameterGroup>,
    /// State from which a flight continues, besides the words: what differs between flights and moments.
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
}

/// Returns the starts' numbers: each that is the same in all of them, and none for the others.
pub fn common_numbers(starts: &[EpisodeStart]) -> Vec<Option<f64>> {
    let Some((first, rest)) = starts.split_first() else { return Vec::new() };
    let same = |(i, number): (usize, &f64)| rest.iter().all(|s| s.numbers[i] == *number).then_some(*number);
    first.numbers.iter().enumerate().map(same).collect()
}

/// Start of an episode.
#[derive(Debug, Clone)]
pub struct EpisodeStart {
    /// Keys of each drone's noise.
    pub keys: Vec<u64>,
    /// See [`Input::Start`].
    pub numbers: Vec<f64>,
}

/// Records the environment of these options, with `starts` episodes' starts: those of the seeds from
/// `first_seed` on.
///
/// # Errors
/// The errors of [`VectorEnv::new`]; [`Error::Config`] naming the option that cannot be recorded.
pub fn record_environment(
    models: &[Model],
    options: &Options,
    (first_seed, starts): (u64, usize),
) -> Result<Recording> {
    check_range("starts", starts as f64, 1.0, 1e6)?;
    let seeds = (first_seed..first_seed.saturating_add(starts as u64)).collect();
    recorder(models, options, seeds, |recorder, _| recorder.record())
}

/// Creates the recorder and passes it to `then` with the number of drones.
fn recorder<V>(
    models: &[Model],
    options: &Options,
    seeds: Vec<u64>,
    then: impl FnOnce(Recorder<'_>, usize) -> Result<V>,
) -> Result<V> {
    // everything that a batch refuses is refused here, in the same words
    let batch = VectorEnv::new(models, options, 1)?;
    for (name, given) in [
        ("wind_field", options.wind_field.is_some()),
        ("history", options.history != 1),
        ("watch", !options.watch.is_empty()),
        ("neighbours by radio", matches!(options.neighbours, Knowledge::Radio { .. })),
    ] {
        if given {
            return Err(Error::Config(format!(
                "{name}: a recorded environment does not have this option; leave it out"
            )));
        }
    }
    let drones = batch.num_drones();
    let models: Vec<&Model> = (0..drones).map(|j| models.get(j).unwrap_or(&models[0])).collect();
    let recorder =
        Recorder { models: &models, interfaces: batch.interfaces(), options, tick_s: batch.tick_s(), seeds };
    then(recorder, drones)
}

/// A flight in double precision: rows of the first moment and of every tick, drone by drone.
#[derive(Debug, Clone, Default)]
pub struct DoubleFlight {
    /// Observations, from the first moment on.
    pub observations: Vec<f64>,
    /// Rewards of the ticks.
    pub rewards: Vec<f64>,
    /// Ended by the task, or broken.
    pub terminated: Vec<bool>,
    /// Out of time.
    pub truncated: Vec<bool>,
    /// True states after the ticks, rows of [`crate::vector::STATE`].
    pub states: Vec<f64>,
}

/// Flies the first episode of a seed in double precision, tick by tick with rows of `actions`; drawn parameters have
/// the middle of what they are drawn from. It goes on where an episode would have ended.
///
/// # Errors
/// The errors of [`record_environment`]; [`Error::Shape`] for actions that are no whole rows.
pub fn fly_double(models: &[Model], options: &Options, seed: u64, actions: &[f64]) -> Result<DoubleFlight> {
    recorder(models, options, vec![seed], |recorder, drones| {
        let row = drones * ACTION;
        check_length("actions", actions.len().next_multiple_of(row), actions.len())?;
        recorder.fly_double(actions)
    })
}

/// Records whatever task there is.
struct Recorder<'a> {
    models: &'a [&'a Model],
    interfaces: &'a [Interface],
    options: &'a Options,
    tick_s: f64,
    seeds: Vec<u64>,
}

/// Derives an episode's words from those of another.
fn record_fork() -> Result<Program> {
    let mut tape = Tape::default();
    let (words, graph) = record(|| {
        let keys = EpisodeKeys::<Symbol>::from_words([0, 1].map(|i| tape.word(Input::Word(0, i))));
        let tick = tape.word(Input::Tick);
        let draw = keys.draw(&tick);
        let names = ["next episode, low", "next episode, high", "next start"];
        Ok(names.map(|name| draw.word(channel(name)).id()).to_vec())
    })?;
    Ok(Program {
        graph,
        inputs: tape.inputs,
        state: Vec::new(),
        words,
        observations: Vec::new(),
        verdicts: Vec::new(),
    })
}

#[cfg(test)]
mod tests;
