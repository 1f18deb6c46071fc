//! A session: a batch of environments and its last replies. Its results depend on options, seeds and actions
//! alone.

use std::sync::atomic::Ordering;

use crazyflie_env::Error;
use crazyflie_env::action::ACTION;
use crazyflie_env::config::Autoreset;
use crazyflie_env::vector::{StepBuffers, VectorEnv};

use super::budget::Buffer;
use super::feed::{EpisodeClocks, FeedRows, WATCHABLE};
use super::metrics::SessionEnd;
use super::replies::ReplyCache;
use super::session_registry::SessionSlot;
use super::settings::Limits;
use super::turns::Turn;
use super::wire::ReplyFrame;
use crate::protocol::frame::Layout;
use crate::protocol::{Code, ProtocolError};

pub(crate) struct Session {
    pub(super) env: VectorEnv,
    pub(super) layout: Layout,
    autoreset: Autoreset,
    pub(super) slot: SessionSlot,
    pub(super) replies: ReplyCache,
    /// Actions of the current request.
    pub(super) actions: Vec<f32>,
    pub(super) terminated: Vec<bool>,
    pub(super) truncated: Vec<bool>,
    /// Flags of the drones that fly on; empty for tasks of one drone.
    pub(super) flying: Vec<bool>,
    /// Environments whose episode ended in the last step.
    over: Vec<bool>,
    pub(super) max_bytes: usize,
    /// The first reset was done.
    ready: bool,
    clocks: EpisodeClocks,
}

impl Session {
    /// `reply_share` is an empty share of the bytes of replies.
    pub(crate) fn new(
        env: VectorEnv,
        autoreset: Autoreset,
        slot: SessionSlot,
        reply_room: Buffer,
        limits: &Limits,
    ) -> Self {
        let clocks = EpisodeClocks::new(autoreset, env.tick_s());
        let (replies, max_bytes) = (ReplyCache::new(limits, reply_room), limits.batch_bytes);
        let layout = Layout::new(&env);
        let (actions, [terminated, truncated, flying, over]) = (Vec::new(), [(); 4].map(|()| Vec::new()));
        Session {
            env,
            layout,
            autoreset,
            slot,
            replies,
            actions,
            terminated,
            truncated,
            flying,
            over,
            max_bytes,
            ready: false,
            clocks,
        }
    }

    /// Makes room for a reply of so many bytes; sessions that wait for their clients may have to go for it.
    ///
    /// # Errors
    /// `too_many` if there is none.
    pub(super) fn make_reply_room(&mut self, reply_bytes: usize) -> Result<(), ProtocolError> {
        let (slot, replies) = (&self.slot, &mut self.replies);
        slot.sessions.make_room(slot.payer(), || replies.make_room(reply_bytes))
    }

    /// Ends the session. `end` goes into the log.
    pub(crate) fn finish(mut self, end: SessionEnd) {
        self.slot.end = end;
    }

    /// The bytes of the reply to a single step, if they are more than one message may have.
    pub(crate) fn too_large(&self) -> Option<usize> {
        Some(self.reply_bytes(1, false)).filter(|bytes| *bytes > self.max_bytes)
    }

    /// The most steps that fit one reply.
    pub(crate) fn max_steps(&self) -> usize {
        if self.autoreset == Autoreset::Disabled {
            return 1;
        }
        let step_bytes = self.reply_bytes(1, false) - crate::protocol::frame::REPLY_HEADER;
        ((self.max_bytes - crate::protocol::frame::REPLY_HEADER) / step_bytes).clamp(1, usize::from(u16::MAX))
    }

    /// At most: every episode may end in every step.
    fn reply_bytes(&self, steps: usize, states: bool) -> usize {
        let finals =
            if self.autoreset == Autoreset::SameStep { 4 * self.layout.final_numbers(states) } else { 0 };
        self.layout
            .reply_bytes(steps, states)
            .saturating_add(finals.saturating_mul(steps).saturating_mul(self.layout.envs))
    }

    /// # Errors
    /// `not_reset`.
    pub(crate) fn states(&self, out: &mut [f32]) -> Result<(), ProtocolError> {
        if !self.ready {
            return Err(Error::NotReset.into());
        }
        Ok(self.env.states(out)?)
    }

    pub(crate) fn ticks(&self) -> u64 {
        self.slot.entry.steps.load(Ordering::Relaxed)
    }

    /// Begins episodes; returns their observations, and the states if requested.
    ///
    /// # Errors
    /// For seeds and masks that do not fit.
    pub(crate) fn begin(
        &mut self,
        seeds: Option<&[u64]>,
        mask: Option<&[bool]>,
        states: bool,
    ) -> Result<ReplyFrame, ProtocolError> {
        let numbers = self.layout.rows() * self.layout.width;
        self.make_reply_room(4 * (numbers + self.layout.state_numbers(states)))?;
        let mut frame = ReplyFrame::new(self.replies.spare(), numbers + self.layout.state_numbers(states));
        let (observations, rest) = frame.numbers_mut().split_at_mut(numbers);
        // rows that do not begin are nothing, not what was in the memory before
        observations.fill(0.0);
        self.env.reset(seeds, mask, observations)?;
        self.ready = true;
        self.clocks.begin(mask);
        if self.slot.entry.feed.watchers() > 0 && mask.is_none() {
            let shown = FeedRows { observations, rewards: None, flying: &[], metrics: &[] };
            self.clocks.show(&self.slot.entry.feed, &self.env, &shown);
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
    pub(crate) async fn act(
        &mut self,
        action: &[f32; ACTION],
        turn: &mut Turn<'_>,
    ) -> Result<(ReplyFrame, [bool; 2]), ProtocolError> {
        self.actions.clear();
        self.actions.extend(action);
        let (frame, _) = self.advance(1, false, turn).await?;
        Ok((frame, [self.terminated[0], self.truncated[0]]))
    }

    /// Carries out the actions that are in `self.actions`. Others have their turns between the steps. Returns the reply
    /// and the number of ended episodes whose last rows are in it.
    ///
    /// # Errors
    /// Before anything moves.
    pub(super) async fn advance(
        &mut self,
        steps: usize,
        states: bool,
        turn: &mut Turn<'_>,
    ) -> Result<(ReplyFrame, usize), ProtocolError> {
        self.check(steps, states)?;
        self.make_reply_room(self.reply_bytes(steps, states))?;
        let Layout { envs, width, metrics, .. } = self.layout;
        let n = self.layout.rows();
        let numbers = n * (width + 1) + self.layout.state_numbers(states) + envs * metrics;
        let mut frame = ReplyFrame::new(self.replies.spare(), steps * numbers);
        self.terminated.resize(steps * n, false);
        self.truncated.resize(steps * n, false);
        self.flying.resize(if metrics == 0 { 0 } else { steps * n }, false);
        let mut finals = 0;
        for k in 0..steps {
            if k > 0 {
                turn.pause_if_due().await;
            }
            finals += self.step_once(&mut frame, k, steps, states)?;
        }
        self.slot.count_steps(steps);
        if self.slot.entry.feed.watchers() > 0 {
            self.show_last(&frame, steps, states);
        }
        Ok((frame, finals))
    }

    /// Flies step `k` of `steps` and writes its rows to their places in the frame. Returns the number of ended
    /// episodes whose last rows are sent.
    fn step_once(
        &mut self,
        frame: &mut ReplyFrame,
        k: usize,
        steps: usize,
        states: bool,
    ) -> Result<usize, ProtocolError> {
        let Layout { envs, width, metrics, .. } = self.layout;
        let (n, wide) = (self.layout.rows(), self.layout.state_numbers(states));
        let part = k * n..(k + 1) * n;
        let (observations, rest) = frame.numbers_mut().split_at_mut(steps * n * width);
        let (rewards, rest) = rest.split_at_mut(steps * n);
        let (state_rows, rest) = rest.split_at_mut(steps * wide);
        let out = StepBuffers {
            observations: &mut observations[k * n * width..(k + 1) * n * width],
            rewards: &mut rewards[part.clone()],
            terminated: &mut self.terminated[part.clone()],
            truncated: &mut self.truncated[part.clone()],
            flying: self.flying.get_mut(part.clone()).unwrap_or_default(),
            metrics: &mut rest[k * envs * metrics..(k + 1) * envs * metrics],
        };
        self.env.step(&self.actions[k * n * ACTION..(k + 1) * n * ACTION], out)?;
        if states {
            self.env.states(&mut state_rows[k * wide..(k + 1) * wide])?;
        }
        // nobody asks when the other episodes end
        let observed_envs = if self.autoreset == Autoreset::SameStep { envs } else { envs.min(WATCHABLE) };
        let mut over = std::mem::take(&mut self.over);
        over.clear();
        over.extend((0..observed_envs).map(|env| self.has_ended(k, env)));
        self.clocks.step(&over);
        let finals =
            if self.autoreset == Autoreset::SameStep { self.finals(frame, &over, states) } else { 0 };
        self.over = over;
        Ok(finals)
    }

    /// Shows watchers the last of `steps`.
    fn show_last(&mut self, frame: &ReplyFrame, steps: usize, states: bool) {
        let Layout { envs, width, metrics, .. } = self.layout;
        let (n, wide, last) = (self.layout.rows(), self.layout.state_numbers(states), steps - 1);
        let (observations, rest) = frame.numbers()[last * n * width..].split_at(n * width);
        let (rewards, rest) = rest.split_at(steps * n);
        let measured = &rest[steps * wide + last * envs * metrics..][..metrics];
        let (rewards, flying) = (Some(&rewards[last * n..]), self.flying.get(last * n..).unwrap_or_default());
        let shown = FeedRows { observations, rewards, flying, metrics: measured };
        self.clocks.show(&self.slot.entry.feed, &self.env, &shown);
    }

    /// Returns whether the episode of an environment ended in step `k`: with several drones, when the last one's
    /// flight did.
    fn has_ended(&self, k: usize, env: usize) -> bool {
        let Layout { drones, metrics, .. } = self.layout;
        let from = k * self.layout.rows() + env * drones;
        let part = from..from + drones;
        let any = part.clone().any(|row| self.terminated[row] | self.truncated[row]);
        if metrics == 0 {
            return any;
        }
        // a drone reset in the same step flies again
        let flags = &self.flying[part];
        any && if self.autoreset == Autoreset::SameStep {
            flags.iter().all(|flies| *flies)
        } else {
            !flags.contains(&true)
        }
    }

    /// Adds the last rows of the episodes that are `over`; how many.
    fn finals(&self, frame: &mut ReplyFrame, over: &[bool], states: bool) -> usize {
        let mut count = 0;
        for (env, _) in over.iter().enumerate().filter(|(_, over)| **over) {
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

    /// The environments whose episode ended in a single step.
    pub(super) fn ended_envs(&self) -> impl Iterator<Item = usize> {
        (0..self.layout.envs).filter(|env| self.has_ended(0, *env))
    }

    /// Everything that could go wrong after the first of several steps.
    fn check(&self, steps: usize, states: bool) -> Result<(), ProtocolError> {
        let (n, drones, bytes) = (self.layout.rows(), self.layout.drones, self.reply_bytes(steps, states));
        let (max, want, got) = (self.max_bytes, steps * n * ACTION, self.actions.len());
        ProtocolError::unless(bytes <= max, Code::TooLarge, || {
            format!("the reply may take {bytes} bytes, more than {max}: ask for fewer steps")
        })?;
        ProtocolError::unless(got == want, Code::WrongLength, || {
            format!("actions: expected {want} numbers, got {got}")
        })?;
        if steps == 1 {
            return Ok(());
        }
        ProtocolError::unless(self.autoreset != Autoreset::Disabled, Code::BadFrame, || {
            "several steps in one message need automatic resets".into()
        })?;
        let bad = |a: &f32| !(-1.0..=1.0).contains(a);
        if !self.actions.iter().fold(false, |any, action| any | bad(action)) {
            return Ok(());
        }
        let i = self.actions.iter().position(bad).unwrap_or_default();
        let (step, row, axis, value) = (i / (n * ACTION), i / ACTION % n, i % ACTION, self.actions[i]);
        let place = if self.layout.metrics == 0 {
            format!("[{row}]")
        } else {
            format!("[{}][{}]", row / drones, row % drones)
        };
        Err(ProtocolError::new(
            Code::BadAction,
            format!("step {step}: actions{place}[{axis}] is {value}, expected a number from -1 to 1"),
        ))
    }
}
