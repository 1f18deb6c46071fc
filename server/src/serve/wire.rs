//! Binary messages: `docs/protocol.md` explains every byte.

use std::sync::Arc;

use bytemuck::{cast_slice, cast_slice_mut};
use bytes::Bytes;
use crazyflie_env::action::ACTION;

use crate::protocol::frame::{FrameKind, MASK, OVER, REPLY, REPLY_HEADER, REQUEST_HEADER, SEEDS, STATES};
use crate::protocol::{Code, MAX_ID, ProtocolError};

/// A reply's header in words of four bytes.
const REPLY_WORDS: usize = REPLY_HEADER / 4;

/// A request, its payload still as bytes.
#[derive(Debug, PartialEq)]
pub(crate) struct BinaryRequest<'a> {
    pub id: u64,
    pub kind: FrameKind,
    pub states: bool,
    pub steps: usize,
    pub envs: usize,
    seeds: Option<&'a [u8]>,
    mask: Option<&'a [u8]>,
    actions: &'a [u8],
}

fn array<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let mut out = [0; N];
    out.copy_from_slice(&bytes[at..at + N]);
    out
}

/// The id of a message that is otherwise beyond reading.
pub(crate) fn id_of(bytes: &[u8]) -> Option<u64> {
    (bytes.len() >= 8).then(|| u64::from_le_bytes(array(bytes, 0))).filter(|id| *id <= MAX_ID)
}

impl<'a> BinaryRequest<'a> {
    /// Parses a message of a session whose environments have so many drones.
    ///
    /// # Errors
    /// `bad_frame` for a header that makes no sense, `wrong_length` for a payload that does not fit it.
    pub(crate) fn parse(bytes: &'a [u8], drones: usize) -> Result<Self, ProtocolError> {
        let bad = |message: String| ProtocolError::new(Code::BadFrame, message);
        ProtocolError::unless(bytes.len() >= REQUEST_HEADER, Code::BadFrame, || {
            format!("a message of {} bytes, expected a header of {REQUEST_HEADER}", bytes.len())
        })?;
        let (header, payload) = bytes.split_at(REQUEST_HEADER);
        let id = id_of(header).ok_or_else(|| bad(format!("the id is above {MAX_ID}")))?;
        let (kind, known) = match header[8] {
            1 => (FrameKind::Reset, STATES | SEEDS | MASK),
            2 => (FrameKind::Step, STATES),
            3 => (FrameKind::State, 0),
            other => return Err(bad(format!("kind {other}, expected 1 (reset), 2 (step) or 3 (state)"))),
        };
        let flags = header[9];
        ProtocolError::unless(flags & !known == 0, Code::BadFrame, || {
            format!("flags {flags:#04x}, expected only {known:#04x} with kind {}", header[8])
        })?;
        let steps = usize::from(u16::from_le_bytes(array(header, 10)));
        ProtocolError::unless((kind == FrameKind::Step) == (steps > 0), Code::BadFrame, || {
            format!("{steps} steps, expected at least 1 in a step and 0 elsewhere")
        })?;
        let envs = u32::from_le_bytes(array(header, 12)) as usize;
        let [seeds, mask, actions] = lengths(kind, flags, steps, [envs, drones]);
        let want = seeds + mask + actions;
        ProtocolError::unless(want == payload.len() as u128, Code::WrongLength, || {
            format!("{} bytes after the header, expected {want}", payload.len())
        })?;
        // they add up to the payload's length, so they fit
        let (seeds, rest) = payload.split_at(seeds as usize);
        let (mask, actions) = rest.split_at(mask as usize);
        let if_flagged = |flag, bytes| (flags & flag != 0).then_some(bytes);
        Ok(BinaryRequest {
            id,
            kind,
            states: flags & STATES != 0,
            steps,
            envs,
            seeds: if_flagged(SEEDS, seeds),
            mask: if_flagged(MASK, mask),
            actions,
        })
    }

    pub(crate) fn seeds(&self) -> Option<Vec<u64>> {
        Some(self.seeds?.as_chunks().0.iter().map(|seed| u64::from_le_bytes(*seed)).collect())
    }

    /// # Errors
    /// `bad_frame` for bytes other than 0 and 1.
    pub(crate) fn mask(&self) -> Result<Option<Vec<bool>>, ProtocolError> {
        let Some(mask) = self.mask else { return Ok(None) };
        if let Some(at) = mask.iter().position(|byte| *byte > 1) {
            let problem = format!("mask[{at}] is {}, expected 0 or 1", mask[at]);
            return Err(ProtocolError::new(Code::BadFrame, problem));
        }
        Ok(Some(mask.iter().map(|byte| *byte == 1).collect()))
    }

    /// Into a buffer that is aligned, which a frame is not.
    pub(crate) fn actions(&self, into: &mut Vec<f32>) {
        into.clear();
        into.extend(self.actions.as_chunks().0.iter().map(|number| f32::from_le_bytes(*number)));
    }
}

/// Bytes of seeds, mask and actions; 128 bits, because the header may claim anything.
fn lengths(kind: FrameKind, flags: u8, steps: usize, size: [usize; 2]) -> [u128; 3] {
    let [envs, drones] = size.map(|count| count as u128);
    let seeds = if flags & SEEDS != 0 { 8 * envs } else { 0 };
    let mask = if flags & MASK != 0 { envs } else { 0 };
    [
        seeds,
        mask,
        if kind == FrameKind::Step { steps as u128 * envs * drones * 4 * ACTION as u128 } else { 0 },
    ]
}

/// A reply in the form in which it is sent.
#[derive(Debug, Default)]
pub struct ReplyFrame {
    words: Vec<f32>,
    bytes: usize,
}

impl ReplyFrame {
    /// In the memory of `words`, with so many numbers after the header; what they were before may still be
    /// there.
    pub(crate) fn new(words: Vec<f32>, numbers: usize) -> Self {
        let mut frame = ReplyFrame { words, bytes: 0 };
        frame.words.resize(REPLY_WORDS + numbers, 0.0);
        frame.bytes = 4 * frame.words.len();
        frame
    }

    pub(crate) fn numbers(&self) -> &[f32] {
        &self.words[REPLY_WORDS..]
    }

    pub(crate) fn numbers_mut(&mut self) -> &mut [f32] {
        &mut self.words[REPLY_WORDS..]
    }

    pub(crate) fn push(&mut self, row: &[f32]) {
        self.words.extend_from_slice(row);
        self.bytes = 4 * self.words.len();
    }

    /// Ends the frame with truth values, a byte each.
    pub(crate) fn flags(&mut self, flags: &[&[bool]]) {
        let (from, count) = (self.bytes, flags.iter().map(|flags| flags.len()).sum::<usize>());
        self.words.resize((from + count).div_ceil(4), 0.0);
        self.bytes = from + count;
        let bytes: &mut [u8] = cast_slice_mut(&mut self.words);
        for (byte, flag) in bytes[from..].iter_mut().zip(flags.iter().copied().flatten()) {
            *byte = u8::from(*flag);
        }
    }

    /// Writes the header: the request's, whether the last episode of a batch has ended, the number of last rows of
    /// episodes, and the steps so far.
    pub(crate) fn head(&mut self, request: &BinaryRequest<'_>, over: bool, finals: usize, ticks: u64) {
        let bytes: &mut [u8] = cast_slice_mut(&mut self.words[..REPLY_WORDS]);
        bytes.fill(0);
        bytes[..8].copy_from_slice(&request.id.to_le_bytes());
        bytes[8] = request.kind as u8 | REPLY;
        bytes[9] = if request.states { STATES } else { 0 } | if over { OVER } else { 0 };
        bytes[10..12].copy_from_slice(&(request.steps as u16).to_le_bytes());
        bytes[12..16].copy_from_slice(&(request.envs as u32).to_le_bytes());
        bytes[16..20].copy_from_slice(&(finals as u32).to_le_bytes());
        bytes[24..32].copy_from_slice(&ticks.to_le_bytes());
    }

    pub(crate) fn into_words(self) -> Vec<f32> {
        self.words
    }
}

impl AsRef<[u8]> for ReplyFrame {
    fn as_ref(&self) -> &[u8] {
        &cast_slice(&self.words)[..self.bytes]
    }
}

/// A frame that is sent and kept at once.
struct SharedFrame(Arc<ReplyFrame>);

impl AsRef<[u8]> for SharedFrame {
    fn as_ref(&self) -> &[u8] {
        (*self.0).as_ref()
    }
}

/// The bytes of a frame, to send it and keep it.
pub(crate) fn bytes(frame: &Arc<ReplyFrame>) -> Bytes {
    Bytes::from_owner(SharedFrame(frame.clone()))
}
