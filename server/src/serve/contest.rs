//! An attempt at a benchmark over a connection: all its episodes in lock-step, and the signed row at the end. Score, clock and seeds stay with
//! the server. A connection that is lost before `finish` leaves an attempt that is listed as abandoned.

use std::sync::Arc;

use crazyflie_env::observation::ACTION;
use crazyflie_env::vector::StepBuffers;
use serde_json::Value;
use tokio::task::block_in_place;

use super::fault::{Code, Fault};
use super::message::{Actions, Benchmark, Step};
use super::replies::Reply;
use super::requests::say;
use super::server_message::{Begun, Numbers, Outcome, Rows, ServerMessage};
use super::wire::{Frame, Head, Kind, Request};
use crate::bench::{Attempt, Bench, Seat, Who, api};

pub(crate) struct Contest {
    bench: Bench,
    /// Elsewhere than in the connection, of which thousands may idle.
    attempt: Box<Attempt>,
    /// The last episode has ended.
    over: bool,
    ticks: u64,
    actions: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
}

impl Contest {
    /// Begins an attempt; what is answered tells what actions mean and what is observed first.
    ///
    /// # Errors
    /// Of the benchmark: its scenario, its token, its limits.
    pub(crate) fn begin(bench: &Bench, id: u64, asked: &Benchmark) -> Result<(Self, Reply), Fault> {
        let attempt = Box::new(block_in_place(|| bench.begin(&asked.scenario, Who::Token(&asked.token), &asked.controller))?);
        let envs = attempt.rows()?;
        let contest = Contest {
            bench: bench.clone(),
            attempt,
            over: false,
            ticks: 0,
            actions: Vec::with_capacity(envs * ACTION),
            terminated: vec![false; envs],
            truncated: vec![false; envs],
        };
        let (attempt, scenario) = (&contest.attempt, contest.attempt.scenario());
        let Seat { interface, tick_s, drones, .. } = attempt.seat()?;
        let reply = say(&ServerMessage::Begun(Box::new(Begun {
            id,
            attempt: attempt.id(),
            scenario: scenario.id(),
            scenario_hash: scenario.hash(),
            num_envs: envs,
            drones,
            width: attempt.width()?,
            tick_s,
            interface,
            phases: scenario.planned_phases(),
            observation: Rows { numbers: attempt.observations()?, width: attempt.width()? },
        })));
        Ok((contest, reply))
    }

    /// # Errors
    /// Before anything moves.
    pub(crate) fn binary(&mut self, request: &Request<'_>) -> Result<Reply, Fault> {
        if request.kind != Kind::Step || request.steps != 1 || request.states {
            return Err(Fault::new(Code::BadFrame, "in an attempt: a step (kind 2) of K = 1, without true states"));
        }
        request.actions(&mut self.actions);
        let mut frame = self.step_once()?;
        frame.flags(&[&self.terminated, &self.truncated]);
        let envs = self.terminated.len();
        frame.head(request.id, Head { kind: Kind::Step, states: false, over: self.over, steps: 1, envs, finals: 0, ticks: self.ticks });
        Ok(Reply::Binary(Arc::new(frame)))
    }

    /// # Errors
    /// Before anything moves.
    pub(crate) fn step(&mut self, id: u64, asked: &Step) -> Result<Reply, Fault> {
        if asked.states {
            return Err(Fault::new(Code::BadMessage, "an attempt does not tell true states"));
        }
        self.actions.clear();
        match &asked.action {
            Actions::One(row) => self.actions.extend(row),
            Actions::Many(rows) => self.actions.extend(rows.iter().flatten()),
        }
        let frame = self.step_once()?;
        let width = self.attempt.width()?;
        let (rows, rewards) = frame.numbers().split_at(self.terminated.len() * width);
        Ok(say(&ServerMessage::Result(Box::new(Outcome {
            id,
            observation: Rows { numbers: rows, width },
            reward: Numbers(rewards),
            terminated: &self.terminated,
            truncated: &self.truncated,
            state: None,
            finals: Vec::new(),
            flying: None,
            metrics: None,
            over: Some(self.over),
        }))))
    }

    fn step_once(&mut self) -> Result<Frame, Fault> {
        let (envs, width) = (self.terminated.len(), self.attempt.width()?);
        let mut frame = Frame::new(Vec::new(), envs * (width + 1));
        let (observations, rewards) = frame.numbers_mut().split_at_mut(envs * width);
        let out = StepBuffers::new(observations, rewards, &mut self.terminated, &mut self.truncated);
        self.over = self.attempt.step(&self.actions, out)?;
        self.ticks += 1;
        Ok(frame)
    }

    /// Scores, signs and stores; the answer comes when the row is on the disk.
    ///
    /// # Errors
    /// `attempt_under_way` before the last episode is over: the attempt is then abandoned.
    pub(crate) fn finish(self, id: u64) -> Result<Reply, Fault> {
        let Contest { bench, attempt, .. } = self;
        let stored = block_in_place(|| attempt.finish().and_then(|document| api::attempt(&bench, &document.id)))?;
        let attempt: Value = serde_json::from_slice(&stored.bytes).map_err(|e| Fault::new(Code::Unavailable, e.to_string()))?;
        Ok(say(&ServerMessage::Finished { id, attempt }))
    }
}
