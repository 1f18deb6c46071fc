//! A session: a batch of environments, the requests to it, its last replies. What comes of it depends on options, seeds and actions alone.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use crazyflie_env::Error;
use crazyflie_env::config::Autoreset;
use crazyflie_env::observation::{ACTION, OBSERVATION};
use crazyflie_env::vector::{Out, STATE, VectorEnv};
use tokio_tungstenite::tungstenite::Utf8Bytes;

use super::fault::{Code, Fault};
use super::feed::Clocks;
use super::listed::{End, Listed, Place};
use super::message::{Actions, Final, Numbers, Outcome, Reset, Rows, Said, Step, observations};
use super::replies::{Replies, Reply};
use super::settings::Limits;
use super::wire::{Frame, Head, Kind, Request, reply_bytes};

/// Environment-steps in one request from which on a thread of its own is worth the change of threads.
const LONG: usize = 8192;

pub(crate) struct Session {
    env: VectorEnv,
    autoreset: Autoreset,
    place: Place,
    replies: Replies,
    actions: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
    most_bytes: usize,
    /// The first reset was done.
    ready: bool,
    clocks: Clocks,
}

/// What a step leaves behind, before it is made a message.
struct Stepped {
    frame: Frame,
    steps: usize,
    states: bool,
    finals: usize,
}

impl Session {
    pub(crate) fn new(env: VectorEnv, autoreset: Autoreset, place: Place, limits: &Limits) -> Self {
        let clocks = Clocks::new(autoreset, env.tick_s());
        let (replies, most_bytes) = (Replies::new(limits), limits.batch_bytes);
        let (actions, terminated, truncated) = (Vec::new(), Vec::new(), Vec::new());
        Session { env, autoreset, place, replies, actions, terminated, truncated, most_bytes, ready: false, clocks }
    }

    pub(crate) fn listed(&self) -> &Arc<Listed> {
        &self.place.listed
    }

    pub(crate) fn last_id(&self) -> Option<u64> {
        self.replies.last()
    }

    /// Over: as `end` says, which is logged.
    pub(crate) fn finish(mut self, end: End) {
        self.place.end = end;
    }

    /// The most steps that fit one reply.
    pub(crate) fn most_steps(&self) -> usize {
        if self.autoreset == Autoreset::Disabled {
            return 1;
        }
        let one = self.reply_bytes(1, false) - super::wire::REPLY_HEADER;
        ((self.most_bytes - super::wire::REPLY_HEADER) / one).clamp(1, usize::from(u16::MAX))
    }

    /// At most: every episode may end in every step.
    fn reply_bytes(&self, steps: usize, states: bool) -> usize {
        let finals = if self.autoreset == Autoreset::SameStep { 4 * (OBSERVATION + if states { STATE } else { 0 }) } else { 0 };
        reply_bytes(steps, self.env.num_envs(), states).saturating_add(finals.saturating_mul(steps).saturating_mul(self.env.num_envs()))
    }

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
                    let stepped = long(request.steps * envs, || session.advance(request.steps, request.states))?;
                    session.finished(request.id, stepped)
                }
                Kind::Reset => {
                    let (seeds, mask) = (request.seeds(), request.mask()?);
                    let frame = long(envs, || session.begin(seeds.as_deref(), mask.as_deref(), request.states))?;
                    session.headed(request, frame)
                }
                Kind::State => {
                    let mut frame = Frame::new(session.replies.spare(), envs * STATE);
                    session.states(frame.numbers_mut())?;
                    session.headed(request, frame)
                }
            };
            Ok(Reply::Binary(Arc::new(frame)))
        })
    }

    fn headed(&self, request: &Request<'_>, mut frame: Frame) -> Frame {
        let (kind, states, envs) = (request.kind, request.states, request.envs);
        frame.head(request.id, Head { kind, states, steps: 0, envs, finals: 0, ticks: self.ticks() });
        frame
    }

    fn finished(&self, id: u64, stepped: Stepped) -> Frame {
        let Stepped { mut frame, steps, states, finals } = stepped;
        frame.flags([&self.terminated, &self.truncated]);
        frame.head(id, Head { kind: Kind::Step, states, steps, envs: self.env.num_envs(), finals, ticks: self.ticks() });
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
            let (rows, states) = frame.numbers().split_at(session.env.num_envs() * OBSERVATION);
            session.text(&Said::Observation { id, observation: observations(rows), state: asked.states.then_some(state_rows(states)) })
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
            session.text(&Said::Result(Box::new(session.outcome(id, &stepped))))
        })
    }

    /// # Errors
    /// As [`Session::binary`].
    pub(crate) fn state(&mut self, id: u64) -> Result<Reply, Fault> {
        self.once(id, |session| {
            let mut states = vec![0.0; session.env.num_envs() * STATE];
            session.states(&mut states)?;
            session.text(&Said::State { id, state: state_rows(&states), ticks: session.ticks() })
        })
    }

    /// # Errors
    /// `not_reset`.
    pub(crate) fn states(&self, out: &mut [f32]) -> Result<(), Fault> {
        if !self.ready {
            return Err(Error::NotReset.into());
        }
        Ok(self.env.states(out)?)
    }

    fn outcome<'a>(&'a self, id: u64, stepped: &'a Stepped) -> Outcome<'a> {
        let n = self.env.num_envs();
        let (rows, rest) = stepped.frame.numbers().split_at(n * OBSERVATION);
        let (rewards, rest) = rest.split_at(n);
        let (states, finals) = rest.split_at(if stepped.states { n * STATE } else { 0 });
        let width = OBSERVATION + if stepped.states { STATE } else { 0 };
        let ended = (0..n).filter(|env| self.terminated[*env] | self.truncated[*env]);
        let finals = ended.zip(finals.chunks(width)).map(|(env, row)| {
            let (observation, state) = row.split_at(OBSERVATION);
            Final { env, observation: Numbers(observation), state: stepped.states.then_some(Numbers(state)) }
        });
        Outcome {
            id,
            observation: observations(rows),
            reward: Numbers(rewards),
            terminated: &self.terminated,
            truncated: &self.truncated,
            state: stepped.states.then_some(state_rows(states)),
            finals: finals.collect(),
        }
    }

    fn text(&self, said: &Said<'_>) -> Result<Reply, Fault> {
        let reply = say(said);
        match &reply {
            Reply::Text(text) if text.len() > self.most_bytes => {
                Err(Fault::new(Code::TooLarge, "the reply is too long as JSON: ask in binary"))
            }
            _ => Ok(reply),
        }
    }

    pub(crate) fn ticks(&self) -> u64 {
        self.place.listed.steps.load(Ordering::Relaxed)
    }

    /// Episodes begin; their observations, and the states if asked for.
    ///
    /// # Errors
    /// For seeds and masks that do not fit.
    pub(crate) fn begin(&mut self, seeds: Option<&[u64]>, mask: Option<&[bool]>, states: bool) -> Result<Frame, Fault> {
        let n = self.env.num_envs();
        let mut frame = Frame::new(self.replies.spare(), n * (OBSERVATION + if states { STATE } else { 0 }));
        let (observations, rest) = frame.numbers_mut().split_at_mut(n * OBSERVATION);
        // rows that do not begin are nothing, not what was in the memory before
        observations.fill(0.0);
        self.env.reset(seeds, mask, observations)?;
        self.ready = true;
        self.clocks.begin(mask);
        if self.place.listed.feed.watchers() > 0 && mask.is_none() {
            self.clocks.show(&self.place.listed.feed, &self.env, observations, None);
        }
        if states {
            self.env.states(rest)?;
        }
        Ok(frame)
    }

    /// One step of a single environment: observation and reward, terminated and truncated.
    ///
    /// # Errors
    /// For an action that cannot be carried out, now or ever.
    pub(crate) fn act(&mut self, action: &[f32; ACTION]) -> Result<(Frame, [bool; 2]), Fault> {
        self.actions.clear();
        self.actions.extend(action);
        let stepped = self.advance(1, false)?;
        Ok((stepped.frame, [self.terminated[0], self.truncated[0]]))
    }

    /// Carries out the actions that are in `self.actions`.
    fn advance(&mut self, steps: usize, states: bool) -> Result<Stepped, Fault> {
        let n = self.env.num_envs();
        self.check(steps, states)?;
        let [rows, rewards, wide] = [OBSERVATION, 1, if states { STATE } else { 0 }].map(|width| steps * n * width);
        let mut frame = Frame::new(self.replies.spare(), rows + rewards + wide);
        self.terminated.resize(steps * n, false);
        self.truncated.resize(steps * n, false);
        let mut finals = 0;
        for k in 0..steps {
            let part = k * n..(k + 1) * n;
            let (observations, rest) = frame.numbers_mut().split_at_mut(rows);
            let (rewards, rest) = rest.split_at_mut(rewards);
            let out = Out {
                observations: &mut observations[k * n * OBSERVATION..(k + 1) * n * OBSERVATION],
                rewards: &mut rewards[part.clone()],
                terminated: &mut self.terminated[part.clone()],
                truncated: &mut self.truncated[part.clone()],
            };
            self.env.step(&self.actions[k * n * ACTION..(k + 1) * n * ACTION], out)?;
            if states {
                self.env.states(&mut rest[k * n * STATE..(k + 1) * n * STATE])?;
            }
            self.clocks.step(&self.terminated[part.clone()], &self.truncated[part]);
            if self.autoreset == Autoreset::SameStep {
                finals += self.finals(&mut frame, k, states);
            }
        }
        self.place.stepped(steps);
        if self.place.listed.feed.watchers() > 0 {
            let (observations, rest) = frame.numbers()[(steps - 1) * n * OBSERVATION..].split_at(n * OBSERVATION);
            self.clocks.show(&self.place.listed.feed, &self.env, observations, Some(&rest[(steps - 1) * n..]));
        }
        Ok(Stepped { frame, steps, states, finals })
    }

    /// Adds the last rows of the episodes that ended in step `k`; how many.
    fn finals(&self, frame: &mut Frame, k: usize, states: bool) -> usize {
        let n = self.env.num_envs();
        let mut count = 0;
        for env in (0..n).filter(|env| self.terminated[k * n + env] | self.truncated[k * n + env]) {
            if let Some((observation, state)) = self.env.last_of_episode(env) {
                frame.push(observation);
                if states {
                    frame.push(state);
                }
                count += 1;
            }
        }
        count
    }

    /// Everything that could go wrong after the first of several steps.
    fn check(&self, steps: usize, states: bool) -> Result<(), Fault> {
        let (n, bytes) = (self.env.num_envs(), self.reply_bytes(steps, states));
        if bytes > self.most_bytes {
            let most = self.most_bytes;
            return Err(Fault::new(Code::TooLarge, format!("the reply may take {bytes} bytes, more than {most}: ask for fewer steps")));
        }
        if self.actions.len() != steps * n * ACTION {
            let want = steps * n * ACTION;
            return Err(Fault::new(Code::WrongLength, format!("actions: expected {want} numbers, got {}", self.actions.len())));
        }
        if steps == 1 {
            return Ok(());
        }
        if self.autoreset == Autoreset::Disabled {
            return Err(Fault::new(Code::BadFrame, "several steps in one message need automatic resets"));
        }
        let bad = |a: &f32| !(-1.0..=1.0).contains(a);
        if !self.actions.iter().fold(false, |any, action| any | bad(action)) {
            return Ok(());
        }
        let at = self.actions.iter().position(bad).unwrap_or_default();
        let (step, env, axis, value) = (at / (n * ACTION), at / ACTION % n, at % ACTION, self.actions[at]);
        Err(Fault::new(Code::BadAction, format!("step {step}: actions[{env}][{axis}] is {value}, expected a number from -1 to 1")))
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
    say(&Said::Error { id, code: fault.code, message: &fault.message })
}

/// A message as JSON text.
pub(crate) fn say(said: &Said<'_>) -> Reply {
    // the types of `Said` have neither maps with odd keys nor writers that fail
    let text = serde_json::to_string(said).unwrap_or_else(|e| format!("{{\"type\":\"error\",\"id\":null,\"message\":\"{e}\"}}"));
    Reply::Text(Utf8Bytes::from(text))
}
