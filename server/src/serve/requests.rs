//! The requests of a session, in binary and in JSON: each is carried out once, and its reply kept.

use std::sync::Arc;

use crazyflie_env::vector::STATE;
use tokio_tungstenite::tungstenite::Utf8Bytes;

use super::fault::{Code, Fault};
use super::message::{Actions, Reset, Step};
use super::replies::Reply;
use super::server_message::{Final, Numbers, Outcome, Rows, ServerMessage};
use super::session::{Session, StepReply};
use super::wire::{Frame, Head, Kind, Layout, Request};

/// Environment-steps in one request from which on a thread of its own is worth the change of threads.
const LONG: usize = 8192;

impl Session {
    /// A request by id: from memory if it was carried out before, by `act` otherwise.
    fn once(&mut self, id: u64, act: impl FnOnce(&mut Self) -> Result<Reply, Fault>) -> Result<Reply, Fault> {
        if let Some(reply) = self.replies.recall(id)? {
            return Ok(reply);
        }
        let reply = act(self).unwrap_or_else(|fault| refusal(Some(id), &fault));
        self.replies.keep(id, &reply);
        Ok(reply)
    }

    /// # Errors
    /// `stale_id`; any other fault is a reply, which is kept.
    pub(crate) fn binary(&mut self, request: &Request<'_>) -> Result<Reply, Fault> {
        self.once(request.id, |session| {
            let envs = session.env.num_envs();
            if request.envs != envs {
                return Err(Fault::new(Code::WrongLength, format!("{} environments, the session has {envs}", request.envs)));
            }
            let frame = match request.kind {
                Kind::Step => {
                    request.actions(&mut session.actions);
                    let stepped = long(request.steps * session.layout.rows(), || session.advance(request.steps, request.states))?;
                    session.finished(request.id, stepped)
                }
                Kind::Reset => {
                    let (seeds, mask) = (request.seeds(), request.mask()?);
                    let frame = long(session.layout.rows(), || session.begin(seeds.as_deref(), mask.as_deref(), request.states))?;
                    session.headed(request, frame)
                }
                Kind::State => {
                    let mut frame = Frame::new(session.replies.spare(), session.layout.state_numbers(true));
                    session.states(frame.numbers_mut())?;
                    session.headed(request, frame)
                }
            };
            Ok(Reply::Binary(Arc::new(frame)))
        })
    }

    fn headed(&self, request: &Request<'_>, mut frame: Frame) -> Frame {
        let (kind, states, envs) = (request.kind, request.states, request.envs);
        frame.head(request.id, Head { kind, states, over: false, steps: 0, envs, finals: 0, ticks: self.ticks() });
        frame
    }

    fn finished(&self, id: u64, stepped: StepReply) -> Frame {
        let StepReply { mut frame, steps, states, finals } = stepped;
        frame.flags(&[&self.terminated, &self.truncated, &self.flying]);
        frame.head(id, Head { kind: Kind::Step, states, over: false, steps, envs: self.env.num_envs(), finals, ticks: self.ticks() });
        frame
    }

    /// # Errors
    /// As [`Session::binary`].
    pub(crate) fn reset(&mut self, id: u64, asked: &Reset) -> Result<Reply, Fault> {
        self.once(id, |session| {
            let seeds = match (asked.seed, &asked.seeds) {
                (Some(_), Some(_)) => return Err(Fault::new(Code::BadMessage, "reset: either seed or seeds, not both")),
                (Some(seed), None) => Some((0..session.env.num_envs() as u64).map(|i| seed.wrapping_add(i)).collect()),
                (None, seeds) => seeds.clone(),
            };
            let frame = session.begin(seeds.as_deref(), asked.mask.as_deref(), asked.states)?;
            let width = session.layout.width;
            let (rows, states) = frame.numbers().split_at(session.layout.rows() * width);
            session.text(&ServerMessage::Observation {
                id,
                observation: Rows { numbers: rows, width },
                state: asked.states.then_some(state_rows(states)),
            })
        })
    }

    /// # Errors
    /// As [`Session::binary`].
    pub(crate) fn step(&mut self, id: u64, asked: &Step) -> Result<Reply, Fault> {
        self.once(id, |session| {
            session.actions.clear();
            match &asked.action {
                Actions::One(row) => session.actions.extend(row),
                Actions::Many(rows) => session.actions.extend(rows.iter().flatten()),
            }
            let stepped = session.advance(1, asked.states)?;
            session.text(&ServerMessage::Result(Box::new(session.outcome(id, &stepped))))
        })
    }

    /// # Errors
    /// As [`Session::binary`].
    pub(crate) fn state(&mut self, id: u64) -> Result<Reply, Fault> {
        self.once(id, |session| {
            let mut states = vec![0.0; session.layout.state_numbers(true)];
            session.states(&mut states)?;
            session.text(&ServerMessage::State { id, state: state_rows(&states), ticks: session.ticks() })
        })
    }

    fn outcome<'a>(&'a self, id: u64, stepped: &'a StepReply) -> Outcome<'a> {
        let Layout { envs, width, metrics, .. } = self.layout;
        let n = self.layout.rows();
        let (rows, rest) = stepped.frame.numbers().split_at(n * width);
        let (rewards, rest) = rest.split_at(n);
        let (states, rest) = rest.split_at(self.layout.state_numbers(stepped.states));
        let (measured, finals) = rest.split_at(envs * metrics);
        let finals = self.ended().zip(finals.chunks(self.layout.final_numbers(stepped.states))).map(|(env, row)| {
            let (observation, state) = row.split_at(self.layout.drones * width);
            Final { env, observation: Numbers(observation), state: stepped.states.then_some(Numbers(state)) }
        });
        Outcome {
            id,
            observation: Rows { numbers: rows, width },
            reward: Numbers(rewards),
            terminated: &self.terminated,
            truncated: &self.truncated,
            state: stepped.states.then_some(state_rows(states)),
            finals: finals.collect(),
            flying: (metrics > 0).then_some(&self.flying[..]),
            metrics: (metrics > 0).then_some(Rows { numbers: measured, width: metrics.max(1) }),
            over: None,
        }
    }

    fn text(&self, said: &ServerMessage<'_>) -> Result<Reply, Fault> {
        let reply = say(said);
        match &reply {
            Reply::Text(text) if text.len() > self.most_bytes => {
                Err(Fault::new(Code::TooLarge, "the reply is too long as JSON: ask in binary"))
            }
            _ => Ok(reply),
        }
    }
}

fn state_rows(numbers: &[f32]) -> Rows<'_> {
    Rows { numbers, width: STATE }
}

/// Work of so many environment-steps; other connections of this thread do not wait for long work.
fn long<T>(steps: usize, work: impl FnOnce() -> T) -> T {
    if steps < LONG { work() } else { tokio::task::block_in_place(work) }
}

pub(crate) fn refusal(id: Option<u64>, fault: &Fault) -> Reply {
    say(&ServerMessage::Error { id, code: fault.code, message: &fault.message, retry_after_s: fault.retry_after_s })
}

/// A message as JSON text.
pub(crate) fn say(said: &ServerMessage<'_>) -> Reply {
    // the types of `ServerMessage` have neither maps with odd keys nor writers that fail
    let text = serde_json::to_string(said).unwrap_or_else(|e| format!("{{\"type\":\"error\",\"id\":null,\"message\":\"{e}\"}}"));
    Reply::Text(Utf8Bytes::from(text))
}
