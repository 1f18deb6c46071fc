//! A session over a client, with the results of its last step.

use crazyflie_env::observation::{Interface, OBSERVATION};
use crazyflie_env::vector::StepBuffers;
use serde::Deserialize;
use tungstenite::Message;

use super::client::Client;
use super::client_error::ClientError;
use super::wire::{self, FrameKind, Layout, Reply, RequestWriter};

/// Reply to `make` or `benchmark`: the new session or attempt.
#[derive(Debug, Clone, Deserialize)]
pub struct SessionInfo {
    pub num_envs: usize,
    /// In each environment. An attempt's rows are all its drones'.
    #[serde(default = "default_drones", rename = "drones")]
    drones: usize,
    /// Numbers in a row of observations: `observation` of a session, `width` of an attempt.
    observation: Option<serde_json::Value>,
    width: Option<usize>,
    #[serde(default)]
    metrics: usize,
    pub tick_s: f64,
    pub interface: Interface,
    /// Of one binary request; an attempt at the benchmark is flown tick by tick.
    #[serde(default = "default_max_steps")]
    pub max_steps: u16,
    pub session: Option<String>,
    pub token: Option<String>,
}

fn default_drones() -> usize {
    1
}

impl SessionInfo {
    pub fn layout(&self) -> Layout {
        let session_width = self
            .observation
            .as_ref()
            .and_then(serde_json::Value::as_u64)
            .and_then(|width| usize::try_from(width).ok());
        // an attempt tells its drones, and counts them as environments
        let drones = if self.width.is_some() { 1 } else { self.drones };
        Layout {
            envs: self.num_envs,
            drones,
            width: self.width.or(session_width).unwrap_or(OBSERVATION),
            metrics: self.metrics,
        }
    }
}

fn default_max_steps() -> u16 {
    1
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
