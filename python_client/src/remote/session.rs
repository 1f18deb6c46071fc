//! A session over a link: what was made, and what the last step left behind.

use crazyflie_env::observation::{Interface, OBSERVATION};
use crazyflie_env::vector::{Out, STATE};
use serde::Deserialize;
use tungstenite::Message;

use super::link::Link;
use super::trouble::Trouble;
use super::wire::{self, Kind, Reply, Writer};

/// The server's description of what it made.
#[derive(Debug, Clone, Deserialize)]
pub struct Made {
    pub num_envs: usize,
    /// Numbers in a row of observations; of an attempt in which drones see each other more than usual.
    #[serde(default = "alone")]
    pub width: usize,
    pub tick_s: f64,
    pub interface: Interface,
    /// Of one binary request; an attempt at the benchmark is flown tick by tick.
    #[serde(default = "one")]
    pub max_steps: u16,
    pub session: Option<String>,
    pub token: Option<String>,
}

fn alone() -> usize {
    OBSERVATION
}

fn one() -> u16 {
    1
}

pub struct Session {
    pub link: Link,
    writer: Writer,
    /// True states come with every reply.
    pub with_states: bool,
    pub envs: usize,
    pub width: usize,
    /// Those of the last reply, of all its steps.
    pub states: Vec<f32>,
    /// Final rows of the last reply, and of which of its steps x environments they are.
    pub finals: Vec<f32>,
    ended: Vec<usize>,
}

impl Session {
    pub fn new(link: Link) -> Self {
        let (states, finals, ended) = (Vec::new(), Vec::new(), Vec::new());
        Session { link, writer: Writer::default(), with_states: false, envs: 0, width: OBSERVATION, states, finals, ended }
    }

    /// Numbers of a final row.
    pub fn final_width(&self) -> usize {
        self.width + if self.with_states { STATE } else { 0 }
    }

    /// # Errors
    /// [`Trouble`] of any kind.
    pub fn reset(&mut self, seeds: Option<&[u64]>, mask: Option<&[bool]>, rows: &mut [f32]) -> Result<(), Trouble> {
        let id = self.link.next_id();
        let request = self.writer.reset(id, self.with_states, self.envs, seeds, mask);
        let reply = self.exchange(id, request)?;
        let reply = self.parsed(&reply, Kind::Reset, 0)?;
        match mask {
            None => wire::copy(reply.observations, rows),
            Some(mask) => {
                let chosen = rows.chunks_exact_mut(self.width).zip(reply.observations.chunks_exact(4 * self.width)).zip(mask);
                chosen.filter(|(_, chosen)| **chosen).for_each(|((row, from), _)| wire::copy(from, row));
            }
        }
        self.states.resize(reply.states.len() / 4, 0.0);
        wire::copy(reply.states, &mut self.states);
        self.finals.clear();
        self.ended.clear();
        Ok(())
    }

    /// So many steps; returns the number of episodes that ended.
    ///
    /// # Errors
    /// [`Trouble`] of any kind.
    pub fn step(&mut self, steps: u16, actions: &[f32], out: Out<'_>) -> Result<usize, Trouble> {
        let id = self.link.next_id();
        let request = self.writer.step(id, self.with_states, steps, self.envs, actions);
        let reply = self.exchange(id, request)?;
        let reply = self.parsed(&reply, Kind::Step, steps)?;
        wire::copy(reply.observations, out.observations);
        wire::copy(reply.rewards, out.rewards);
        wire::copy_flags(reply.terminated, out.terminated);
        wire::copy_flags(reply.truncated, out.truncated);
        self.states.resize(reply.states.len() / 4, 0.0);
        wire::copy(reply.states, &mut self.states);
        self.finals.resize(reply.finals.len() / 4, 0.0);
        wire::copy(reply.finals, &mut self.finals);
        let ends = out.terminated.iter().zip(&*out.truncated).map(|(t, o)| t | o);
        let count = ends.clone().filter(|ended| *ended).count();
        self.ended.clear();
        if !self.finals.is_empty() {
            self.ended.extend(ends.enumerate().filter_map(|(at, ended)| ended.then_some(at)));
            let rows = self.finals.len() / self.final_width();
            if rows != count {
                return Err(self.link.strange(format!("{rows} final rows for {count} ends")));
            }
        }
        Ok(count)
    }

    /// The true states as they are now.
    ///
    /// # Errors
    /// [`Trouble`] of any kind.
    pub fn states(&mut self, out: &mut [f32]) -> Result<(), Trouble> {
        if self.states.len() >= out.len() {
            out.copy_from_slice(&self.states[self.states.len() - out.len()..]);
            return Ok(());
        }
        let id = self.link.next_id();
        let request = self.writer.state(id, self.envs);
        let reply = self.exchange(id, request)?;
        wire::copy(self.parsed(&reply, Kind::State, 0)?.states, out);
        Ok(())
    }

    /// The final row of an environment whose episode ended in the last step, the only one of its request.
    pub fn final_of(&self, env: usize) -> Option<&[f32]> {
        let at = self.ended.binary_search(&env).ok()?;
        self.finals.chunks_exact(self.final_width()).nth(at)
    }

    fn exchange(&mut self, id: u64, request: bytes::Bytes) -> Result<bytes::Bytes, Trouble> {
        match self.link.exchange(id, Message::Binary(request))? {
            Message::Binary(bytes) => Ok(bytes),
            _ => Err(self.link.strange("a text for a binary request".into())),
        }
    }

    fn parsed<'a>(&self, bytes: &'a [u8], kind: Kind, steps: u16) -> Result<Reply<'a>, Trouble> {
        Reply::parse(bytes, kind, self.with_states, steps, self.envs, self.width).map_err(|why| self.link.strange(why))
    }
}
