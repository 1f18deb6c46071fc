//! One WebSocket: messages in and out within the limits, each in its turn, pings, and closing so that the peer hears
//! why.

use std::future::poll_fn;
use std::io::ErrorKind;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures_util::{FutureExt, SinkExt, StreamExt};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::task::yield_now;
use tokio::time::{MissedTickBehavior, interval, timeout};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;
use tokio_tungstenite::tungstenite::protocol::{CloseFrame, Role, WebSocketConfig};
use tokio_tungstenite::tungstenite::{Error, Message, Utf8Bytes, error::ProtocolError};
use tokio_util::sync::CancellationToken;

use super::budget::{Buffer, Resource};
use super::moment::{self, Moment};
use super::server::Peer;
use super::stream::Stream;

/// Size of the read buffer of each connection. It is allocated at once, so it is the cost of an idle
/// connection.
const READ_BYTES: usize = 8 << 10;
/// Small replies are sent together up to this size.
const WRITE_BYTES: usize = 16 << 10;
/// Time that a peer has to answer a close frame, and the bytes that it may still send.
const LINGER: Duration = Duration::from_secs(1);
const LINGER_BYTES: usize = 4 << 20;
/// Bytes of a control frame of a client besides its payload: two, and the mask.
const CONTROL_HEADER: usize = 6;

#[derive(Debug)]
pub(crate) enum Incoming {
    Text(Utf8Bytes),
    Binary(Bytes),
}

/// Reason that a connection ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Disconnect {
    /// The peer closed it, with this code.
    Closed(Option<u16>),
    /// The connection is lost.
    Lost(String),
    /// The peer broke a rule: close code and which.
    Broke(u16, &'static str),
    /// The peer takes no replies.
    Stalled,
    /// The peer does not answer pings.
    Silent,
    /// The server ended it: it stops, or the session was resumed elsewhere.
    Left,
}

pub(crate) struct Socket {
    ws: WebSocketStream<Stream>,
    peer: Arc<Peer>,
    leave: CancellationToken,
    /// Memory of what is sent, which stays as large as the largest message.
    replies: Buffer,
    largest_reply: usize,
    /// A message that waits for its turn.
    received: Option<Received>,
    heard: Moment,
    pinged: bool,
    beat: tokio::time::Interval,
}

/// The next message of the peer, or the end of the connection.
type Received = Option<Result<Message, Error>>;

impl Socket {
    /// Over a stream whose handshake is done and of which `read` was read too far.
    pub(crate) async fn new(
        mut stream: Stream,
        read: Bytes,
        peer: Arc<Peer>,
        leave: CancellationToken,
    ) -> Self {
        let limits = peer.limits();
        let buffer = |resource| peer.server.budgets.buffer(resource, peer.payer(), limits.free_bytes);
        stream.count_requests(buffer(Resource::RequestBytes));
        let replies = buffer(Resource::ReplyBytes);
        let config = WebSocketConfig::default()
            .read_buffer_size(READ_BYTES)
            .write_buffer_size(WRITE_BYTES)
            .max_write_buffer_size(WRITE_BYTES + limits.batch_bytes + (1 << 10))
            .max_message_size(Some(limits.batch_bytes))
            .max_frame_size(Some(limits.batch_bytes));
        let ws = WebSocketStream::from_partially_read(stream, read.into(), Role::Server, Some(config)).await;
        let mut beat = interval(limits.ping_after.min(limits.idle_timeout).min(limits.message_timeout) / 2);
        beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (largest_reply, received, heard, pinged) = (0, None, Moment::now(), false);
        Socket { ws, peer, leave, replies, largest_reply, received, heard, pinged, beat }
    }

    /// The next message, in its turn; replies that wait are sent when none is there yet. No message is lost if the
    /// call is given up.
    ///
    /// # Errors
    /// The way in which the connection ends.
    pub(crate) async fn next(&mut self) -> Result<Incoming, Disconnect> {
        loop {
            if self.leave.is_cancelled() {
                return Err(Disconnect::Left);
            }
            if self.received.is_none() {
                self.receive().await?;
            }
            drop(self.peer.queue.turn(false).await);
            match self.received.take().flatten() {
                Some(Ok(Message::Text(text))) if text.len() > self.peer.limits().control_bytes => {
                    return Err(Disconnect::Broke(1009, "the text message is too long"));
                }
                Some(Ok(Message::Text(text))) => return Ok(Incoming::Text(text)),
                Some(Ok(Message::Binary(bytes))) => return Ok(Incoming::Binary(bytes)),
                // the library has the answer ready: if the peer takes none, nothing more is read
                Some(Ok(Message::Ping(_))) => self.flush().await?,
                Some(Ok(Message::Pong(_) | Message::Frame(_))) => self.check_message()?,
                Some(Ok(Message::Close(frame))) => {
                    return Err(Disconnect::Closed(frame.map(|frame| frame.code.into())));
                }
                Some(Err(error)) => return Err(error.into()),
                None => return Err(Disconnect::Lost("closed".into())),
            }
        }
    }

    /// Receives the next message. A client that has sent many at once lets others go on after each.
    async fn receive(&mut self) -> Result<(), Disconnect> {
        let at_once = self.ws.next().now_or_never();
        let pipelined = at_once.is_some();
        let received = match at_once {
            Some(received) => received,
            None => {
                self.flush().await?;
                self.wait().await?
            }
        };
        (self.heard, self.pinged) = (Moment::now(), false);
        let stream = self.ws.get_mut();
        match &received {
            Some(Ok(Message::Ping(payload) | Message::Pong(payload))) => {
                stream.end_control_frame(CONTROL_HEADER + payload.len());
            }
            Some(Ok(message)) => stream.end_message(message.len()),
            Some(Err(_)) | None => {}
        }
        self.received = Some(received);
        if pipelined {
            yield_now().await;
        }
        Ok(())
    }

    async fn wait(&mut self) -> Result<Received, Disconnect> {
        loop {
            tokio::select! {
                biased;
                message = self.ws.next() => return Ok(message),
                () = self.leave.cancelled() => return Err(Disconnect::Left),
                _ = self.beat.tick() => self.check().await?,
            }
        }
    }

    /// Is the peer still there, and does it complete what it has begun?
    async fn check(&mut self) -> Result<(), Disconnect> {
        self.check_message()?;
        let quiet = self.heard.elapsed();
        if quiet >= self.peer.limits().idle_timeout {
            return Err(Disconnect::Silent);
        }
        if quiet >= self.peer.limits().ping_after && !self.pinged {
            self.pinged = true;
            self.send(Message::Ping(Bytes::new())).await?;
            self.flush().await?;
        }
        Ok(())
    }

    fn check_message(&self) -> Result<(), Disconnect> {
        match self.ws.get_ref().unfinished_for() {
            Some(time) if time >= self.peer.limits().message_timeout => {
                Err(Disconnect::Broke(1008, "the message took too long to become complete"))
            }
            _ => Ok(()),
        }
    }

    /// Takes a message to be sent; [`Socket::next`] and [`Socket::flush`] send it.
    ///
    /// # Errors
    /// The way in which the connection ends.
    pub(crate) async fn send(&mut self, message: Message) -> Result<(), Disconnect> {
        let largest = self.largest_reply.max(message.len());
        self.replies
            .fit(largest)
            .map_err(|_| Disconnect::Broke(1013, "too many bytes of replies: try later"))?;
        self.largest_reply = largest;
        // earlier messages may still be in the buffer
        match poll_fn(|cx| self.ws.poll_ready_unpin(cx)).now_or_never() {
            Some(ready) => ready?,
            None => self.flush().await?,
        }
        Ok(self.ws.start_send_unpin(message)?)
    }

    pub(crate) async fn flush(&mut self) -> Result<(), Disconnect> {
        if let Some(sent) = self.ws.flush().now_or_never() {
            return Ok(sent?);
        }
        let leave = async {
            self.leave.cancelled().await;
            tokio::time::sleep(LINGER).await;
        };
        tokio::select! {
            sent = self.ws.flush() => Ok(sent?),
            () = moment::sleep(self.peer.limits().write_timeout) => Err(Disconnect::Stalled),
            () = leave => Err(Disconnect::Left),
        }
    }

    /// Sends the close frame that fits, and reads on for a moment. Otherwise a TCP reset could destroy the
    /// frame.
    pub(crate) async fn goodbye(mut self, disconnect: &Disconnect) {
        let stopping = self.peer.server.stop.is_cancelled();
        if let Some(rule) = disconnect.rule() {
            self.peer.server.metrics.record_refusal(rule);
        }
        let (code, reason) = match disconnect {
            Disconnect::Closed(_) => (None, ""),
            Disconnect::Broke(code, reason) => (Some(*code), *reason),
            Disconnect::Left if stopping => (Some(1001), "the server stops"),
            Disconnect::Left => (Some(4001), "the session was resumed from elsewhere"),
            Disconnect::Silent => (Some(4002), "no answer to pings"),
            Disconnect::Lost(_) | Disconnect::Stalled => return,
        };
        let goodbye = async {
            match code {
                Some(code) => {
                    let frame = CloseFrame { code: CloseCode::from(code), reason: reason.into() };
                    self.ws.send(Message::Close(Some(frame))).await?
                }
                None => self.ws.flush().await?,
            }
            let stream = self.ws.get_mut();
            stream.shutdown().await?;
            let (mut rest, mut left) = ([0; 4096], LINGER_BYTES);
            while left > 0 {
                match stream.read(&mut rest).await? {
                    0 => break,
                    n => left = left.saturating_sub(n),
                }
            }
            Ok::<(), Error>(())
        };
        // there is nobody to tell of a goodbye that fails
        let _ = timeout(LINGER, goodbye).await;
    }
}

impl Disconnect {
    /// The limit that ended the connection, as the metrics name it.
    fn rule(&self) -> Option<&'static str> {
        match self {
            Disconnect::Broke(_, _) => Some("broke a rule"),
            Disconnect::Stalled => Some("stalled"),
            Disconnect::Silent => Some("silent"),
            Disconnect::Closed(_) | Disconnect::Lost(_) | Disconnect::Left => None,
        }
    }
}

impl From<Error> for Disconnect {
    fn from(error: Error) -> Self {
        match error {
            Error::Capacity(_) => Disconnect::Broke(1009, "the message is too long"),
            Error::Utf8(_) => Disconnect::Broke(1007, "the text is not UTF-8"),
            Error::Protocol(ProtocolError::ResetWithoutClosingHandshake) => Disconnect::Lost("cut".into()),
            Error::Protocol(_) => Disconnect::Broke(1002, "not a WebSocket frame as RFC 6455 has it"),
            Error::Io(error) if error.kind() == ErrorKind::QuotaExceeded => {
                Disconnect::Broke(1013, "too many bytes of unfinished messages: try later")
            }
            Error::Io(error) if error.kind() == ErrorKind::TimedOut => Disconnect::Stalled,
            other => Disconnect::Lost(other.to_string()),
        }
    }
}
