//! A session over a client, with the results of its last step.

use crazyflie_env::observation::{Interface, OBSERVATION};
use crazyflie_env::vector::StepBuffers;
use crazyflie_server::protocol::SessionInfo;
use crazyflie_server::protocol::frame::{FrameKind, Layout};
use serde::Deserialize;
use tungstenite::Message;

use super::client::Client;
use super::client_error::ClientError;
use super::wire::{self, Reply, RequestWriter};

/// What a session or an attempt is, from the reply that began it.
#[derive(Debug, Clone)]
pub struct StartedSession {
    pub layout: Layout,
    pub tick_s: f64,
    pub interface: Interface,
    /// Of one binary request; an attempt at the benchmark is flown tick by tick.
    pub max_steps: usize,
    /// Name and token of a session to come back to; an attempt has none.
    pub key: Option<(String, String)>,
    /// True states come with every reply.
    pub with_states: bool,
}

/// A reply that begins something, as far as it is needed here.
#[derive(Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum Beginning {
    Made(Box<SessionInfo>),
    /// Of an attempt at the benchmark.
    Begun {
        num_envs: usize,
        width: usize,
        tick_s: f64,
        interface: Interface,
    },
}

impl StartedSession {
    pub fn new(beginning: Beginning, with_states: bool) -> Self {
        match beginning {
            Beginning::Made(info) => {
                let SessionInfo { num_envs, drones, metrics, max_steps, tick_s, interface, .. } = *info;
                let layout = Layout { envs: num_envs, drones, width: info.observation, metrics };
                let key = Some((info.session, info.token));
                StartedSession { layout, tick_s, interface, max_steps, key, with_states }
            }
            // an attempt counts its drones as environments
            Beginning::Begun { num_envs, width, tick_s, interface } => {
                let layout = Layout { envs: num_envs, drones: 1, width, metrics: 0 };
                StartedSession { layout, tick_s, interface, max_steps: 1, key: None, with_states }
            }
        }
    }
}

pub struct Session {
    pub client: Client,
    writer: RequestWriter,
    /// True states come with every reply.
    pub with_states: bool,
    pub layout: Layout,
    /// Of the last reply, where a task has several drones.
    pub flying: Vec<bool>,
    pub metrics: Vec<f32>,
    /// Those of the last reply, of all its steps.
    pub states: Vec<f32>,
    /// Final rows of the last reply, and of which of its steps x environments they are.
    pub finals: Vec<f32>,
    ended: Vec<usize>,
}

impl Session {
    pub fn new(client: Client) -> Self {
        let layout = Layout { envs: 0, drones: 1, width: OBSERVATION, metrics: 0 };
        let (states, finals, ended) = (Vec::new(), Vec::new(), Vec::new());
        let (flying, metrics) = (Vec::new(), Vec::new());
        Session {
            client,
            writer: RequestWriter::default(),
            with_states: false,
            layout,
            flying,
            metrics,
            states,
            finals,
            ended,
        }
    }

    /// Numbers of the last rows of an environment.
    pub fn final_width(&self) -> usize {
        self.layout.final_numbers(self.with_states)
    }

    /// # Errors
    /// [`ClientError`] of any kind.
    pub fn reset(
        &mut self,
        seeds: Option<&[u64]>,
        mask: Option<&[bool]>,
        rows: &mut [f32],
    ) -> Result<(), ClientError> {
        let id = self.client.next_id();
        let request = self.writer.reset(id, self.with_states, self.layout.envs, seeds, mask);
        let reply = self.exchange(id, request)?;
        let reply = self.parse_reply(&reply, FrameKind::Reset, 0)?;
        match mask {
            None => wire::copy(reply.observations, rows),
            Some(mask) => {
                let numbers = self.layout.drones * self.layout.width;
                let chosen = rows
                    .chunks_exact_mut(numbers)
                    .zip(reply.observations.chunks_exact(4 * numbers))
                    .zip(mask);
                chosen.filter(|(_, chosen)| **chosen).for_each(|((row, from), _)| wire::copy(from, row));
            }
        }
        self.states.resize(reply.states.len() / 4, 0.0);
        wire::copy(reply.states, &mut self.states);
        self.finals.clear();
        self.ended.clear();
        Ok(())
    }

    /// Executes `steps` steps; returns the number of episodes that ended.
    ///
    /// # Errors
    /// [`ClientError`] of any kind.
    pub fn step(&mut self, steps: u16, actions: &[f32], out: StepBuffers<'_>) -> Result<usize, ClientError> {
        let id = self.client.next_id();
        let request = self.writer.step(id, self.with_states, steps, self.layout.envs, actions);
        let reply = self.exchange(id, request)?;
        let reply = self.parse_reply(&reply, FrameKind::Step, steps)?;
        wire::copy(reply.observations, out.observations);
        wire::copy(reply.rewards, out.rewards);
        wire::copy_flags(reply.terminated, out.terminated);
        wire::copy_flags(reply.truncated, out.truncated);
        self.states.resize(reply.states.len() / 4, 0.0);
        wire::copy(reply.states, &mut self.states);
        self.finals.resize(reply.finals.len() / 4, 0.0);
        wire::copy(reply.finals, &mut self.finals);
        self.metrics.resize(reply.metrics.len() / 4, 0.0);
        wire::copy(reply.metrics, &mut self.metrics);
        self.flying.resize(reply.flying.len(), false);
        wire::copy_flags(reply.flying, &mut self.flying);
        let ends: Vec<bool> = out.terminated.iter().zip(&*out.truncated).map(|(t, o)| t | o).collect();
        self.ended.clear();
        if !self.finals.is_empty() {
            let drones = self.layout.drones;
            // where one has crashed and others fly on, nothing has ended; who was reset in the same step
            // flies again
            let all = |env: &usize| {
                self.flying
                    .get(env * drones..(env + 1) * drones)
                    .is_none_or(|flying| !flying.contains(&false))
            };
            let over =
                ends.chunks(drones).enumerate().filter(|(_, ends)| ends.contains(&true)).map(|(env, _)| env);
            self.ended.extend(over.filter(all));
            let (got, count) = (self.finals.len() / self.final_width(), self.ended.len());
            if got != count {
                return Err(self.client.unexpected(format!("{got} final rows for {count} ends")));
            }
        }
        Ok(ends.into_iter().filter(|ended| *ended).count())
    }

    /// The true states as they are now.
    ///
    /// # Errors
    /// [`ClientError`] of any kind.
    pub fn states(&mut self, out: &mut [f32]) -> Result<(), ClientError> {
        if self.states.len() >= out.len() {
            out.copy_from_slice(&self.states[self.states.len() - out.len()..]);
            return Ok(());
        }
        let id = self.client.next_id();
        let request = self.writer.state(id, self.layout.envs);
        let reply = self.exchange(id, request)?;
        wire::copy(self.parse_reply(&reply, FrameKind::State, 0)?.states, out);
        Ok(())
    }

    /// The final row of an environment whose episode ended in the last step, the only one of its request.
    pub fn final_of(&self, env: usize) -> Option<&[f32]> {
        let at = self.ended.binary_search(&env).ok()?;
        self.finals.chunks_exact(self.final_width()).nth(at)
    }

    fn exchange(&mut self, id: u64, request: bytes::Bytes) -> Result<bytes::Bytes, ClientError> {
        match self.client.exchange(id, Message::Binary(request))? {
            Message::Binary(bytes) => Ok(bytes),
            _ => Err(self.client.unexpected("a text for a binary request".into())),
        }
    }

    fn parse_reply<'a>(
        &self,
        bytes: &'a [u8],
        kind: FrameKind,
        steps: u16,
    ) -> Result<Reply<'a>, ClientError> {
        Reply::parse(bytes, kind, self.with_states, steps, &self.layout)
            .map_err(|why| self.client.unexpected(why))
    }
}
