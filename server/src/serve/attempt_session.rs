//! An attempt at a benchmark over a connection: all its episodes in lock-step, and the signed row at the end.
//! Score, clock and seeds stay with the server. A connection that is lost before `finish` leaves an attempt
//! that is listed as abandoned.

use std::sync::Arc;

use crazyflie_env::action::ACTION;
use crazyflie_env::vector::StepBuffers;
use tokio::task::block_in_place;
use tracing::error;

use super::metrics::Metrics;
use super::replies::Reply;
use super::session_requests::json_reply;
use super::wire::{BinaryRequest, FrameHeader, ReplyFrame};
use crate::bench::{Attempt, AttemptSpec, Bench, Submitter, api};
use crate::protocol::frame::FrameKind;
use crate::protocol::{
    Actions, AttemptInfo, Benchmark, Code, Numbers, ProtocolError, Response, Rows, Step, StepResult,
};

pub(crate) struct AttemptSession {
    bench: Bench,
    metrics: Arc<Metrics>,
    /// On the heap: thousands of connections may idle without one.
    attempt: Box<Attempt>,
    /// The last episode has ended.
    over: bool,
    is_finished: bool,
    ticks: u64,
    actions: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
}

impl AttemptSession {
    /// Begins an attempt. The reply has the action ranges and the first observations.
    ///
    /// # Errors
    /// Of the benchmark: its scenario, its token, its limits.
    pub(crate) fn begin(
        bench: &Bench,
        metrics: &Arc<Metrics>,
        id: u64,
        request: &Benchmark,
    ) -> Result<(Self, Reply), ProtocolError> {
        let attempt = Box::new(block_in_place(|| {
            bench.begin(&request.scenario, Submitter::Token(&request.token), &request.controller)
        })?);
        let envs = attempt.rows()?;
        metrics.attempts_begun.inc();
        let session = AttemptSession {
            bench: bench.clone(),
            metrics: metrics.clone(),
            attempt,
            over: false,
            is_finished: false,
            ticks: 0,
            actions: Vec::with_capacity(envs * ACTION),
            terminated: vec![false; envs],
            truncated: vec![false; envs],
        };
        let (attempt, scenario) = (&session.attempt, session.attempt.scenario());
        let AttemptSpec { interface, tick_s, drones, .. } = attempt.spec()?;
        let reply = json_reply(&Response::Begun(Box::new(AttemptInfo {
            id,
            attempt: attempt.id().into(),
            scenario: scenario.id(),
            scenario_hash: scenario.hash().into(),
            num_envs: envs,
            drones,
            width: attempt.width()?,
            tick_s,
            interface,
            phases: scenario.planned_phases().into(),
            observation: Rows { numbers: attempt.observations()?.into(), width: attempt.width()? },
        })));
        Ok((session, reply))
    }

    /// # Errors
    /// Before anything moves.
    pub(crate) fn binary(&mut self, request: &BinaryRequest<'_>) -> Result<Reply, ProtocolError> {
        if request.kind != FrameKind::Step || request.steps != 1 || request.states {
            return Err(ProtocolError::new(
                Code::BadFrame,
                "in an attempt: a step (kind 2) of K = 1, without true states",
            ));
        }
        request.actions(&mut self.actions);
        let mut frame = self.step_once()?;
        frame.flags(&[&self.terminated, &self.truncated]);
        let envs = self.terminated.len();
        frame.head(
            request.id,
            FrameHeader {
                kind: FrameKind::Step,
                states: false,
                over: self.over,
                steps: 1,
                envs,
                finals: 0,
                ticks: self.ticks,
            },
        );
        Ok(Reply::Binary(Arc::new(frame)))
    }

    /// # Errors
    /// Before anything moves.
    pub(crate) fn step(&mut self, id: u64, request: &Step) -> Result<Reply, ProtocolError> {
        if request.states {
            return Err(ProtocolError::new(Code::BadMessage, "an attempt does not tell true states"));
        }
        self.actions.clear();
        match &request.action {
            Actions::One(row) => self.actions.extend(row),
            Actions::Many(rows) => self.actions.extend(rows.iter().flatten()),
        }
        let frame = self.step_once()?;
        let width = self.attempt.width()?;
        let (rows, rewards) = frame.numbers().split_at(self.terminated.len() * width);
        Ok(json_reply(&Response::Result(Box::new(StepResult {
            id,
            observation: Rows { numbers: rows.into(), width },
            reward: Numbers(rewards.into()),
            terminated: (&self.terminated).into(),
            truncated: (&self.truncated).into(),
            state: None,
            finals: Vec::new(),
            flying: None,
            metrics: None,
            over: Some(self.over),
        }))))
    }

    fn step_once(&mut self) -> Result<ReplyFrame, ProtocolError> {
        let (envs, width) = (self.terminated.len(), self.attempt.width()?);
        let mut frame = ReplyFrame::new(Vec::new(), envs * (width + 1));
        let (observations, rewards) = frame.numbers_mut().split_at_mut(envs * width);
        let out = StepBuffers::new(observations, rewards, &mut self.terminated, &mut self.truncated);
        self.over = self.attempt.step(&self.actions, out)?;
        self.ticks += 1;
        Ok(frame)
    }

    /// Scores, signs and stores; the answer comes when the row is on the disk. If it cannot be stored, the request may
    /// be repeated.
    ///
    /// # Errors
    /// `attempt_under_way` before the last episode is over: the attempt is then abandoned.
    pub(crate) fn finish(&mut self, id: u64) -> Result<Reply, ProtocolError> {
        let (bench, attempt) = (&self.bench, &mut self.attempt);
        let stored =
            block_in_place(|| attempt.finish().and_then(|document| api::attempt(bench, &document.id)));
        let stored = stored.inspect_err(|problem| {
            if problem.status() >= 500 {
                error!(attempt = self.attempt.id(), %problem, "the attempt cannot be stored; its client may try again");
            }
        })?;
        self.is_finished = true;
        self.metrics.attempts_finished.inc();
        let attempt = serde_json::from_slice(&stored.bytes)
            .map_err(|e| ProtocolError::new(Code::Unavailable, e.to_string()))?;
        Ok(json_reply(&Response::Finished { id, attempt }))
    }

    /// Whether there is nothing left to do: stored, or abandoned.
    pub(crate) fn is_closed(&self) -> bool {
        self.is_finished || self.attempt.is_closed()
    }
}

impl Drop for AttemptSession {
    fn drop(&mut self) {
        if !self.is_finished {
            self.metrics.attempts_abandoned.inc();
        }
    }
}
