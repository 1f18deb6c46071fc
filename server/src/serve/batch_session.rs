//! A batch of an extension over a connection: steps in JSON and in binary frames, without true states. It is
//! not resumed.

use std::sync::Arc;

use crazyflie_env::action::ACTION;
use crazyflie_env::vector::StepBuffers;

use super::extension::{Batch, Begun};
use super::replies::Reply;
use super::wire::{BinaryRequest, ReplyFrame};
use crate::protocol::frame::FrameKind;
use crate::protocol::{Code, Numbers, ProtocolError, Response, Rows, Step, StepResult};

pub(crate) struct BatchSession {
    pub batch: Box<dyn Batch>,
    width: usize,
    /// The last episode has ended.
    over: bool,
    ticks: u64,
    actions: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
}

impl BatchSession {
    /// A session of what has begun, and the reply to the request that began it.
    pub(crate) fn new(begun: Begun) -> (Self, Reply) {
        let Begun { batch, rows, width, reply } = begun;
        let (actions, flags) = (Vec::with_capacity(rows * ACTION), vec![false; rows]);
        let (terminated, truncated) = (flags.clone(), flags);
        (BatchSession { batch, width, over: false, ticks: 0, actions, terminated, truncated }, reply)
    }

    /// # Errors
    /// Before anything moves.
    pub(crate) fn binary(&mut self, request: &BinaryRequest<'_>) -> Result<Reply, ProtocolError> {
        let is_step = request.kind == FrameKind::Step && request.steps == 1 && !request.states;
        ProtocolError::unless(is_step, Code::BadFrame, || {
            "expected a step (kind 2) of K = 1, without true states: this is no session of make".into()
        })?;
        request.actions(&mut self.actions);
        let mut frame = self.advance()?;
        frame.flags(&[&self.terminated, &self.truncated]);
        frame.head(request, self.over, 0, self.ticks);
        Ok(Reply::Binary(Arc::new(frame)))
    }

    /// # Errors
    /// Before anything moves.
    pub(crate) fn step(&mut self, id: u64, request: &Step) -> Result<Reply, ProtocolError> {
        ProtocolError::unless(!request.states, Code::BadMessage, || "true states are not told here".into())?;
        request.action.write(&mut self.actions);
        let frame = self.advance()?;
        let (rows, rewards) = frame.numbers().split_at(self.terminated.len() * self.width);
        Ok(Reply::json(&Response::Result(Box::new(StepResult {
            id,
            observation: Rows { numbers: rows.into(), width: self.width },
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

    fn advance(&mut self) -> Result<ReplyFrame, ProtocolError> {
        let (envs, width) = (self.terminated.len(), self.width);
        let mut frame = ReplyFrame::new(Vec::new(), envs * (width + 1));
        let (observations, rewards) = frame.numbers_mut().split_at_mut(envs * width);
        let out = StepBuffers::new(observations, rewards, &mut self.terminated, &mut self.truncated);
        self.over = self.batch.step(&self.actions, out)?;
        self.ticks += 1;
        Ok(frame)
    }
}
