//! The requests of a session, in binary and in JSON: each is carried out once, and its reply kept.

use std::sync::Arc;

use crazyflie_env::vector::STATE;

use super::replies::Reply;
use super::session::{Session, StepReply};
use super::turns::Turn;
use super::wire::{BinaryRequest, FrameHeader, ReplyFrame};
use crate::protocol::frame::{FrameKind, Layout};
use crate::protocol::{Code, FinalRow, Numbers, ProtocolError, Reset, Response, Rows, Step, StepResult};

impl Session {
    /// Keeps the reply to a request that was carried out; an error is a reply as well.
    fn keep(&mut self, id: u64, answer: Result<Reply, ProtocolError>) -> Reply {
        let reply = answer.unwrap_or_else(|error| error_reply(Some(id), &error));
        self.replies.keep(id, &reply);
        reply
    }

    /// Executes a request once: a repeated id gets the reply that is kept.
    ///
    /// # Errors
    /// `stale_id`; any other fault is a reply, which is kept.
    pub(crate) async fn binary(
        &mut self,
        request: &BinaryRequest<'_>,
        turn: &mut Turn<'_>,
    ) -> Result<Reply, ProtocolError> {
        if let Some(reply) = self.replies.recall(request.id)? {
            return Ok(reply);
        }
        let answer = self.binary_answer(request, turn).await;
        Ok(self.keep(request.id, answer))
    }

    async fn binary_answer(
        &mut self,
        request: &BinaryRequest<'_>,
        turn: &mut Turn<'_>,
    ) -> Result<Reply, ProtocolError> {
        let envs = self.env.num_envs();
        if request.envs != envs {
            return Err(ProtocolError::new(
                Code::WrongLength,
                format!("{} environments, the session has {envs}", request.envs),
            ));
        }
        let frame = match request.kind {
            FrameKind::Step => {
                request.actions(&mut self.actions);
                let stepped = self.advance(request.steps, request.states, turn).await?;
                self.with_flags(request.id, stepped)
            }
            FrameKind::Reset => {
                let (seeds, mask) = (request.seeds(), request.mask()?);
                let frame = self.begin(seeds.as_deref(), mask.as_deref(), request.states)?;
                self.with_header(request, frame)
            }
            FrameKind::State => {
                self.make_reply_room(4 * self.layout.state_numbers(true))?;
                let mut frame = ReplyFrame::new(self.replies.spare(), self.layout.state_numbers(true));
                self.states(frame.numbers_mut())?;
                self.with_header(request, frame)
            }
        };
        Ok(Reply::Binary(Arc::new(frame)))
    }

    fn with_header(&self, request: &BinaryRequest<'_>, mut frame: ReplyFrame) -> ReplyFrame {
        let (kind, states, envs) = (request.kind, request.states, request.envs);
        frame.head(
            request.id,
            FrameHeader { kind, states, over: false, steps: 0, envs, finals: 0, ticks: self.ticks() },
        );
        frame
    }

    fn with_flags(&self, id: u64, stepped: StepReply) -> ReplyFrame {
        let StepReply { mut frame, steps, states, finals } = stepped;
        frame.flags(&[&self.terminated, &self.truncated, &self.flying]);
        frame.head(
            id,
            FrameHeader {
                kind: FrameKind::Step,
                states,
                over: false,
                steps,
                envs: self.env.num_envs(),
                finals,
                ticks: self.ticks(),
            },
        );
        frame
    }

    /// # Errors
    /// The errors of [`Session::binary`].
    pub(crate) fn reset(&mut self, id: u64, request: &Reset) -> Result<Reply, ProtocolError> {
        if let Some(reply) = self.replies.recall(id)? {
            return Ok(reply);
        }
        let answer = self.reset_answer(id, request);
        Ok(self.keep(id, answer))
    }

    fn reset_answer(&mut self, id: u64, request: &Reset) -> Result<Reply, ProtocolError> {
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

    /// # Errors
    /// The errors of [`Session::binary`].
    pub(crate) async fn step(
        &mut self,
        id: u64,
        request: &Step,
        turn: &mut Turn<'_>,
    ) -> Result<Reply, ProtocolError> {
        if let Some(reply) = self.replies.recall(id)? {
            return Ok(reply);
        }
        let answer = self.step_answer(id, request, turn).await;
        Ok(self.keep(id, answer))
    }

    async fn step_answer(
        &mut self,
        id: u64,
        request: &Step,
        turn: &mut Turn<'_>,
    ) -> Result<Reply, ProtocolError> {
        request.action.write(&mut self.actions);
        let stepped = self.advance(1, request.states, turn).await?;
        self.text(&Response::Result(Box::new(self.step_result(id, &stepped))))
    }

    /// # Errors
    /// The errors of [`Session::binary`].
    pub(crate) fn state(&mut self, id: u64) -> Result<Reply, ProtocolError> {
        if let Some(reply) = self.replies.recall(id)? {
            return Ok(reply);
        }
        let answer = self.state_answer(id);
        Ok(self.keep(id, answer))
    }

    fn state_answer(&mut self, id: u64) -> Result<Reply, ProtocolError> {
        let mut states = vec![0.0; self.layout.state_numbers(true)];
        self.states(&mut states)?;
        self.text(&Response::State { id, state: state_rows(&states), ticks: self.ticks() })
    }

    fn step_result<'a>(&'a self, id: u64, stepped: &'a StepReply) -> StepResult<'a> {
        let Layout { envs, width, metrics, .. } = self.layout;
        let n = self.layout.rows();
        let (rows, rest) = stepped.frame.numbers().split_at(n * width);
        let (rewards, rest) = rest.split_at(n);
        let (states, rest) = rest.split_at(self.layout.state_numbers(stepped.states));
        let (measured, finals) = rest.split_at(envs * metrics);
        let finals = self.ended_envs().zip(finals.chunks(self.layout.final_numbers(stepped.states))).map(
            |(env, row)| {
                let (observation, state) = row.split_at(self.layout.drones * width);
                FinalRow {
                    env,
                    observation: Numbers(observation.into()),
                    state: stepped.states.then_some(Numbers(state.into())),
                }
            },
        );
        StepResult {
            id,
            observation: Rows { numbers: rows.into(), width },
            reward: Numbers(rewards.into()),
            terminated: (&self.terminated).into(),
            truncated: (&self.truncated).into(),
            state: stepped.states.then_some(state_rows(states)),
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
