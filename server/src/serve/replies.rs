//! The last replies of a session: a repeated request is answered from here and not carried out again.

use std::collections::VecDeque;
use std::sync::Arc;

use serde::Serialize;
use tokio_tungstenite::tungstenite::{Message, Utf8Bytes};

use super::budget::{Buffer, Refusal};
use super::settings::Limits;
use super::wire::{self, ReplyFrame};
use crate::protocol::{Code, ProtocolError};

/// A reply in the form in which it is sent.
#[derive(Debug, Clone)]
pub enum Reply {
    /// JSON, also of errors.
    Text(Utf8Bytes),
    /// The results of a binary request.
    Binary(Arc<ReplyFrame>),
}

impl Reply {
    /// A message as JSON text.
    pub fn json(message: &impl Serialize) -> Reply {
        // the types of messages have neither maps with odd keys nor writers that fail
        let text = serde_json::to_string(message)
            .unwrap_or_else(|e| format!("{{\"type\":\"error\",\"id\":null,\"message\":\"{e}\"}}"));
        Reply::Text(text.into())
    }

    fn bytes(&self) -> usize {
        match self {
            Reply::Text(text) => text.len(),
            Reply::Binary(frame) => (**frame).as_ref().len(),
        }
    }
}

impl From<Reply> for Message {
    fn from(reply: Reply) -> Message {
        match reply {
            Reply::Text(text) => Message::Text(text),
            Reply::Binary(frame) => Message::Binary(wire::bytes(&frame)),
        }
    }
}

/// The last replies, up to a number and a size.
#[derive(Debug)]
pub(crate) struct ReplyCache {
    kept: VecDeque<(u64, Reply)>,
    bytes: usize,
    /// The newest request that was carried out.
    pub last: Option<u64>,
    window: usize,
    window_bytes: usize,
    /// The memory of a reply that is kept no longer.
    spare: Vec<f32>,
    /// The largest reply so far: so much memory has the socket's buffer, which the socket pays for.
    largest: usize,
    room: Buffer,
}

impl ReplyCache {
    pub(crate) fn new(limits: &Limits, room: Buffer) -> Self {
        let (window, window_bytes) = (limits.window, limits.window_bytes);
        let (kept, spare) = (VecDeque::new(), Vec::new());
        ReplyCache { kept, bytes: 0, last: None, window, window_bytes, spare, largest: 0, room }
    }

    /// Takes room for one more reply: the kept replies, this one, and what the socket's buffer grows by. Without so much
    /// room, all kept replies but the newest are dropped before the request is refused.
    ///
    /// # Errors
    /// [`Refusal`] if there is no room for the reply at all.
    pub(crate) fn make_room(&mut self, reply_bytes: usize) -> Result<(), Refusal> {
        let growth = reply_bytes + reply_bytes.saturating_sub(self.largest);
        let likely = self.bytes.min(self.window_bytes.saturating_sub(reply_bytes));
        if self.room.try_fit(likely + growth).is_ok() {
            return Ok(());
        }
        let newest = self.kept.back().map_or(0, |(_, reply)| reply.bytes());
        self.room.try_fit(newest + growth)?;
        while self.kept.len() > 1 {
            self.forget();
        }
        self.spare = Vec::new();
        Ok(())
    }

    /// The reply to a request that was carried out before; `None` for a new one.
    ///
    /// # Errors
    /// `stale_id` if it is too old to be known.
    pub(crate) fn recall(&self, id: u64) -> Result<Option<Reply>, ProtocolError> {
        let Some(last) = self.last.filter(|last| id <= *last) else { return Ok(None) };
        let reply = self.kept.iter().rev().find(|(kept, _)| *kept == id);
        reply.map(|(_, reply)| Some(reply.clone())).ok_or_else(|| {
            let problem =
                format!("the id {id} is not above {last}, the newest, and its reply is no longer kept");
            ProtocolError::new(Code::StaleId, problem)
        })
    }

    pub(crate) fn keep(&mut self, id: u64, reply: &Reply) {
        self.bytes += reply.bytes();
        self.largest = self.largest.max(reply.bytes());
        self.kept.push_back((id, reply.clone()));
        self.last = Some(id);
        while self.kept.len() > 1 && (self.kept.len() > self.window || self.bytes > self.window_bytes) {
            self.forget();
        }
        // a reply that was shorter than it might have been gives back; one that is longer is an error in words
        let _ = self.room.try_fit(self.bytes);
    }

    fn forget(&mut self) {
        let Some((_, reply)) = self.kept.pop_front() else { return };
        self.bytes -= reply.bytes();
        if let Reply::Binary(frame) = reply {
            // while it is still being sent, the memory is not ours
            if let Ok(frame) = Arc::try_unwrap(frame) {
                self.spare = frame.into_words();
            }
        }
    }

    /// Memory for the next reply.
    pub(crate) fn spare(&mut self) -> Vec<f32> {
        std::mem::take(&mut self.spare)
    }
}
