//! The requests of a session, in binary and in JSON: each is carried out once, and its reply kept.

use std::sync::Arc;

use crazyflie_env::vector::STATE;

use super::replies::Reply;
use super::session::Session;
use super::turns::Turn;
use super::wire::{BinaryRequest, ReplyFrame};
use crate::protocol::frame::{FrameKind, Layout};
use crate::protocol::{Code, FinalRow, Numbers, ProtocolError, Reset, Response, Rows, Step, StepResult};

/// A request to a session.
#[derive(Clone, Copy)]
pub(crate) enum SessionRequest<'a> {
    Binary(&'a BinaryRequest<'a>),
    Reset(&'a Reset),
    Step(&'a Step),
    State,
}

impl SessionRequest<'_> {
    /// Steps of the environments, or as much work.
    pub(crate) fn steps(self) -> usize {
        match self {
            SessionRequest::Binary(request) => request.steps,
            SessionRequest::Reset(_) | SessionRequest::Step(_) => 1,
            SessionRequest::State => 0,
        }
    }
}

impl Session {
    /// Executes a request once: a repeated id gets the reply that is kept.
    ///
    /// # Errors
    /// `stale_id`; any other fault is a reply, which is kept.
    pub(crate) async fn execute(
        &mut self,
        id: u64,
        request: SessionRequest<'_>,
        turn: &mut Turn<'_>,
    ) -> Result<Reply, ProtocolError> {
        if let Some(reply) = self.replies.recall(id)? {
            return Ok(reply);
        }
        let answer = match request {
            SessionRequest::Binary(request) => self.binary(request, turn).await,
            SessionRequest::Reset(request) => self.reset(id, request),
            SessionRequest::Step(request) => self.step(id, request, turn).await,
            SessionRequest::State => self.state(id),
        };
        let reply = answer.unwrap_or_else(|error| error_reply(Some(id), &error));
        self.replies.keep(id, &reply);
        Ok(reply)
    }

    async fn binary(
        &mut self,
        request: &BinaryRequest<'_>,
        turn: &mut Turn<'_>,
    ) -> Result<Reply, ProtocolError> {
        let envs = self.env.num_envs();
        ProtocolError::unless(request.envs == envs, Code::WrongLength, || {
            format!("{} environments, the session has {envs}", request.envs)
        })?;
        let (mut frame, finals) = match request.kind {
            FrameKind::Step => {
                request.actions(&mut self.actions);
                let (mut frame, finals) = self.advance(request.steps, request.states, turn).await?;
                frame.flags(&[&self.terminated, &self.truncated, &self.flying]);
                (frame, finals)
            }
            FrameKind::Reset => {
                let (seeds, mask) = (request.seeds(), request.mask()?);
                (self.begin(seeds.as_deref(), mask.as_deref(), request.states)?, 0)
            }
            FrameKind::State => {
                self.make_reply_room(4 * self.layout.state_numbers(true))?;
                let mut frame = ReplyFrame::new(self.replies.spare(), self.layout.state_numbers(true));
                self.states(frame.numbers_mut())?;
                (frame, 0)
            }
        };
        frame.head(request, false, finals, self.ticks());
        Ok(Reply::Binary(Arc::new(frame)))
    }

    fn reset(&mut self, id: u64, request: &Reset) -> Result<Reply, ProtocolError> {
        let seeds = match (request.seed, &request.seeds) {
            (Some(_), Some(_)) => {
                return Err(ProtocolError::new(Code::BadMessage, "reset: either seed or seeds, not both"));
            }
            (Some(seed), None) => {
                Some((0..self.env.num_envs() as u64).map(|i| seed.wrapping_add(i)).collect())
            }
            (None, seeds) => seeds.clone(),
        };
        let frame = self.begin(seeds.as_deref(), request.mask.as_deref(), request.states)?;
        let width = self.layout.width;
        let (rows, states) = frame.numbers().split_at(self.layout.rows() * width);
        self.text(&Response::Observation {
            id,
            observation: Rows { numbers: rows.into(), width },
            state: request.states.then_some(state_rows(states)),
        })
    }

    async fn step(&mut self, id: u64, request: &Step, turn: &mut Turn<'_>) -> Result<Reply, ProtocolError> {
        request.action.write(&mut self.actions);
        let (frame, _) = self.advance(1, request.states, turn).await?;
        self.text(&Response::Result(Box::new(self.step_result(id, &frame, request.states))))
    }

    fn state(&mut self, id: u64) -> Result<Reply, ProtocolError> {
        let mut states = vec![0.0; self.layout.state_numbers(true)];
        self.states(&mut states)?;
        self.text(&Response::State { id, state: state_rows(&states), ticks: self.ticks() })
    }

    fn step_result<'a>(&'a self, id: u64, frame: &'a ReplyFrame, has_states: bool) -> StepResult<'a> {
        let Layout { envs, width, metrics, .. } = self.layout;
        let n = self.layout.rows();
        let (rows, rest) = frame.numbers().split_at(n * width);
        let (rewards, rest) = rest.split_at(n);
        let (states, rest) = rest.split_at(self.layout.state_numbers(has_states));
        let (measured, finals) = rest.split_at(envs * metrics);
        let finals =
            self.ended_envs().zip(finals.chunks(self.layout.final_numbers(has_states))).map(|(env, row)| {
                let (observation, state) = row.split_at(self.layout.drones * width);
                FinalRow {
                    env,
                    observation: Numbers(observation.into()),
                    state: has_states.then_some(Numbers(state.into())),
                }
            });
        StepResult {
            id,
            observation: Rows { numbers: rows.into(), width },
            reward: Numbers(rewards.into()),
            terminated: (&self.terminated).into(),
            truncated: (&self.truncated).into(),
            state: has_states.then_some(state_rows(states)),
            finals: finals.collect(),
            flying: (metrics > 0).then_some((&self.flying[..]).into()),
            metrics: (metrics > 0).then_some(Rows { numbers: measured.into(), width: metrics.max(1) }),
            over: None,
        }
    }

    fn text(&self, response: &Response<'_>) -> Result<Reply, ProtocolError> {
        let reply = Reply::json(response);
        match &reply {
            Reply::Text(text) if text.len() > self.max_bytes => {
                Err(ProtocolError::new(Code::TooLarge, "the reply is too long as JSON: ask in binary"))
            }
            _ => Ok(reply),
        }
    }
}

fn state_rows(numbers: &[f32]) -> Rows<'_> {
    Rows { numbers: numbers.into(), width: STATE }
}

pub(crate) fn error_reply(id: Option<u64>, error: &ProtocolError) -> Reply {
    Reply::json(&Response::Error {
        id,
        code: error.code.clone(),
        message: (&error.message).into(),
        retry_after_s: error.retry_after_s,
    })
}
