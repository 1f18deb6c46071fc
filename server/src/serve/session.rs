//! A session: a batch of environments and its last replies. What comes of it depends on options, seeds and actions alone.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use crazyflie_env::Error;
use crazyflie_env::config::Autoreset;
use crazyflie_env::observation::{ACTION, OBSERVATION};
use crazyflie_env::vector::{Out, STATE, VectorEnv};

use super::fault::{Code, Fault};
use super::feed::Clocks;
use super::listed::{End, Listed, Place};
use super::replies::Replies;
use super::settings::Limits;
use super::wire::{Frame, reply_bytes};

pub(crate) struct Session {
    pub(super) env: VectorEnv,
    autoreset: Autoreset,
    place: Place,
    pub(super) replies: Replies,
    /// Of the request that is carried out.
    pub(super) actions: Vec<f32>,
    pub(super) terminated: Vec<bool>,
    pub(super) truncated: Vec<bool>,
    pub(super) most_bytes: usize,
    /// The first reset was done.
    ready: bool,
    clocks: Clocks,
}

/// What a step leaves behind, before it is made a message.
pub(super) struct Stepped {
    pub frame: Frame,
    pub steps: usize,
    pub states: bool,
    pub finals: usize,
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

    /// # Errors
    /// `not_reset`.
    pub(crate) fn states(&self, out: &mut [f32]) -> Result<(), Fault> {
        if !self.ready {
            return Err(Error::NotReset.into());
        }
        Ok(self.env.states(out)?)
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
    ///
    /// # Errors
    /// Before anything moves.
    pub(super) fn advance(&mut self, steps: usize, states: bool) -> Result<Stepped, Fault> {
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
