//! Binary messages, as `docs/protocol.md` has them.

use bytes::{BufMut, Bytes, BytesMut};
use crazyflie_env::observation::OBSERVATION;
use crazyflie_env::vector::STATE;
use crazyflie_server::protocol::frame::{FrameKind, Layout, MASK, OVER, REPLY, REPLY_HEADER, SEEDS, STATES};

/// The memory of requests: each is written where the one before was.
#[derive(Default)]
pub struct RequestWriter(BytesMut);

impl RequestWriter {
    fn begin(&mut self, id: u64, kind: FrameKind, flags: u8, steps: u16, envs: usize) {
        self.0.put_u64_le(id);
        self.0.put_u8(kind as u8);
        self.0.put_u8(flags);
        self.0.put_u16_le(steps);
        self.0.put_u32_le(envs as u32);
    }

    pub fn step(&mut self, id: u64, states: bool, steps: u16, envs: usize, actions: &[f32]) -> Bytes {
        self.begin(id, FrameKind::Step, if states { STATES } else { 0 }, steps, envs);
        self.0.put_slice(bytemuck::cast_slice(actions));
        self.0.split().freeze()
    }

    pub fn reset(
        &mut self,
        id: u64,
        states: bool,
        envs: usize,
        seeds: Option<&[u64]>,
        mask: Option<&[bool]>,
    ) -> Bytes {
        let flag = |given: bool, flag: u8| if given { flag } else { 0 };
        self.begin(
            id,
            FrameKind::Reset,
            flag(states, STATES) | flag(seeds.is_some(), SEEDS) | flag(mask.is_some(), MASK),
            0,
            envs,
        );
        seeds.unwrap_or_default().iter().for_each(|seed| self.0.put_u64_le(*seed));
        mask.unwrap_or_default().iter().for_each(|chosen| self.0.put_u8(u8::from(*chosen)));
        self.0.split().freeze()
    }

    pub fn state(&mut self, id: u64, envs: usize) -> Bytes {
        self.begin(id, FrameKind::State, 0, 0, envs);
        self.0.split().freeze()
    }
}

/// A reply in its parts, as the bytes that they came as.
pub struct Reply<'a> {
    pub observations: &'a [u8],
    pub rewards: &'a [u8],
    /// Empty unless they were asked for.
    pub states: &'a [u8],
    /// For tasks of several drones: rows for each environment, and whether a drone flies on.
    pub metrics: &'a [u8],
    /// Of each environment whose episode ended: rows of observation and, if asked for, of state.
    pub finals: &'a [u8],
    pub terminated: &'a [u8],
    pub truncated: &'a [u8],
    pub flying: &'a [u8],
}

/// The bytes of a usual reply with its WebSocket header.
pub fn reply_bytes(envs: usize) -> usize {
    REPLY_HEADER + envs * (4 * (OBSERVATION + 1 + STATE) + 2) + 16
}

impl<'a> Reply<'a> {
    /// # Errors
    /// For a reply that does not fit the request.
    pub fn parse(
        bytes: &'a [u8],
        kind: FrameKind,
        states: bool,
        steps: u16,
        layout: &Layout,
    ) -> Result<Self, String> {
        let Layout { envs, width, metrics, .. } = *layout;
        let word =
            |at: usize| bytes.get(at..at + 4).and_then(|word| word.try_into().ok()).map(u32::from_le_bytes);
        let (Some(head), Some(got_envs), Some(finals)) =
            (word(8).map(|head| head & !(u32::from(OVER) << 8)), word(12), word(16))
        else {
            return Err(format!("a message of {} bytes", bytes.len()));
        };
        let flags = if states && kind != FrameKind::State { STATES } else { 0 };
        let want =
            u32::from_le_bytes([kind as u8 | REPLY, flags, steps.to_le_bytes()[0], steps.to_le_bytes()[1]]);
        if head != want || got_envs as usize != envs {
            return Err(format!(
                "a header {head:#010x} of {got_envs} environments, expected {want:#010x} of {envs}"
            ));
        }
        let ticks = if kind == FrameKind::Step { usize::from(steps) } else { 1 };
        let rows = ticks * layout.rows();
        let wide = if states || kind == FrameKind::State { 4 * STATE } else { 0 };
        let (step, seen) = (usize::from(kind == FrameKind::Step), usize::from(kind != FrameKind::State));
        let parts = [
            rows * 4 * width * seen,
            rows * 4 * step,
            rows * wide,
            ticks * envs * 4 * metrics * step,
            finals as usize * 4 * layout.final_numbers(states),
            rows * step,
            rows * step,
            if metrics == 0 { 0 } else { rows * step },
        ];
        let mut rest = bytes.get(REPLY_HEADER..).unwrap_or_default();
        if parts.iter().sum::<usize>() != rest.len() {
            return Err(format!(
                "{} bytes after the header, expected {}",
                rest.len(),
                parts.iter().sum::<usize>()
            ));
        }
        let [observations, rewards, states, metrics, finals, terminated, truncated, flying] =
            parts.map(|count| {
                let (part, after) = rest.split_at(count);
                rest = after;
                part
            });
        Ok(Reply { observations, rewards, states, metrics, finals, terminated, truncated, flying })
    }
}

/// Numbers as they came into the numbers that they are.
pub fn copy(from: &[u8], into: &mut [f32]) {
    bytemuck::cast_slice_mut(into).copy_from_slice(from);
}

pub fn copy_flags(from: &[u8], into: &mut [bool]) {
    into.iter_mut().zip(from).for_each(|(flag, byte)| *flag = *byte != 0);
}
