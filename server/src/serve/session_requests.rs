//! The requests of a session, in binary and in JSON: each is carried out once, and its reply kept.

use std::sync::Arc;

use crazyflie_env::vector::STATE;
use tokio_tungstenite::tungstenite::Utf8Bytes;

use super::replies::Reply;
use super::session::{Session, StepReply};
use super::wire::{BinaryRequest, FrameHeader, ReplyFrame};
use crate::protocol::frame::{FrameKind, Layout};
use crate::protocol::{
    Actions, Code, FinalRow, Numbers, ProtocolError, Reset, Response, Rows, Step, StepResult,
};

/// Environment-steps of one request from which a blocking thread is worth the change of threads.
const LONG: usize = 8192;

impl Session {
    /// Executes a request once: a repeated id gets the reply that is kept, a new one is executed by `act`.
    fn run_once(
        &mut self,
        id: u64,
        act: impl FnOnce(&mut Self) -> Result<Reply, ProtocolError>,
    ) -> Result<Reply, ProtocolError> {
        if let Some(reply) = self.replies.recall(id)? {
            return Ok(reply);
        }
        let reply = act(self).unwrap_or_else(|error| error_reply(Some(id), &error));
        self.replies.keep(id, &reply);
        Ok(reply)
    }

    /// # Errors
    /// `stale_id`; any other fault is a reply, which is kept.
    pub(crate) fn binary(&mut self, request: &BinaryRequest<'_>) -> Result<Reply, ProtocolError> {
        self.run_once(request.id, |session| {
            let envs = session.env.num_envs();
            if request.envs != envs {
                return Err(ProtocolError::new(
                    Code::WrongLength,
                    format!("{} environments, the session has {envs}", request.envs),
                ));
            }
            let frame = match request.kind {
                FrameKind::Step => {
                    request.actions(&mut session.actions);
                    let stepped = run_off_thread_if_long(request.steps * session.layout.rows(), || {
                        session.advance(request.steps, request.states)
                    })?;
                    session.with_flags(request.id, stepped)
                }
                FrameKind::Reset => {
                    let (seeds, mask) = (request.seeds(), request.mask()?);
                    let frame = run_off_thread_if_long(session.layout.rows(), || {
                        session.begin(seeds.as_deref(), mask.as_deref(), request.states)
                    })?;
                    session.with_header(request, frame)
                }
                FrameKind::State => {
                    let mut frame =
                        ReplyFrame::new(session.replies.spare(), session.layout.state_numbers(true));
                    session.states(frame.numbers_mut())?;
                    session.with_header(request, frame)
                }
            };
            Ok(Reply::Binary(Arc::new(frame)))
        })
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
    /// As [`Session::binary`].
    pub(crate) fn reset(&mut self, id: u64, request: &Reset) -> Result<Reply, ProtocolError> {
        self.run_once(id, |session| {
            let seeds = match (request.seed, &request.seeds) {
                (Some(_), Some(_)) => {
                    return Err(ProtocolError::new(
                        Code::BadMessage,
                        "reset: either seed or seeds, not both",
                    ));
                }
                (Some(seed), None) => {
                    Some((0..session.env.num_envs() as u64).map(|i| seed.wrapping_add(i)).collect())
                }
                (None, seeds) => seeds.clone(),
            };
            let frame = session.begin(seeds.as_deref(), request.mask.as_deref(), request.states)?;
            let width = session.layout.width;
            let (rows, states) = frame.numbers().split_at(session.layout.rows() * width);
            session.text(&Response::Observation {
                id,
                observation: Rows { numbers: rows.into(), width },
                state: request.states.then_some(state_rows(states)),
            })
        })
    }

    /// # Errors
    /// As [`Session::binary`].
    pub(crate) fn step(&mut self, id: u64, request: &Step) -> Result<Reply, ProtocolError> {
        self.run_once(id, |session| {
            session.actions.clear();
            match &request.action {
                Actions::One(row) => session.actions.extend(row),
                Actions::Many(rows) => session.actions.extend(rows.iter().flatten()),
            }
            let stepped = session.advance(1, request.states)?;
            session.text(&Response::Result(Box::new(session.step_result(id, &stepped))))
        })
    }

    /// # Errors
    /// As [`Session::binary`].
    pub(crate) fn state(&mut self, id: u64) -> Result<Reply, ProtocolError> {
        self.run_once(id, |session| {
            let mut states = vec![0.0; session.layout.state_numbers(true)];
            session.states(&mut states)?;
            session.text(&Response::State { id, state: state_rows(&states), ticks: session.ticks() })
        })
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
        let reply = json_reply(response);
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

/// Runs work of `steps` environment-steps. Other connections of this thread do not wait for long work.
fn run_off_thread_if_long<T>(steps: usize, work: impl FnOnce() -> T) -> T {
    if steps < LONG { work() } else { tokio::task::block_in_place(work) }
}

pub(crate) fn error_reply(id: Option<u64>, error: &ProtocolError) -> Reply {
    json_reply(&Response::Error {
        id,
        code: error.code.clone(),
        message: (&error.message).into(),
        retry_after_s: error.retry_after_s,
    })
}

/// A message as JSON text.
pub(crate) fn json_reply(response: &Response<'_>) -> Reply {
    // the types of `Response` have neither maps with odd keys nor writers that fail
    let text = serde_json::to_string(response)
        .unwrap_or_else(|e| format!("{{\"type\":\"error\",\"id\":null,\"message\":\"{e}\"}}"));
    Reply::Text(Utf8Bytes::from(text))
}
