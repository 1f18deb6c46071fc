//! One WebSocket: messages in and out within the limits, pings, and closing so that the peer hears why.

use std::future::poll_fn;
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures_util::{FutureExt, SinkExt, StreamExt};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::{MissedTickBehavior, interval, timeout};
use tokio_rustls::server::TlsStream;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;
use tokio_tungstenite::tungstenite::protocol::{CloseFrame, Role, WebSocketConfig};
use tokio_tungstenite::tungstenite::{Error, Message, Utf8Bytes, error::ProtocolError};
use tokio_util::either::Either;
use tokio_util::sync::CancellationToken;

use super::metrics::Metrics;
use super::settings::Limits;

pub(crate) type Stream = Either<TcpStream, Box<TlsStream<TcpStream>>>;

/// Size of the read buffer of each connection. It is allocated at once, so it is the cost of an idle
/// connection.
const READ_BYTES: usize = 8 << 10;
/// Small replies are sent together up to this size.
const WRITE_BYTES: usize = 16 << 10;
/// Time that a peer has to answer a close frame, and the bytes that it may still send.
const LINGER: Duration = Duration::from_secs(1);
const LINGER_BYTES: usize = 4 << 20;

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
    leave: CancellationToken,
    control_bytes: usize,
    ping_after: Duration,
    idle_timeout: Duration,
    write_timeout: Duration,
    heard: Instant,
    pinged: bool,
    beat: tokio::time::Interval,
}

impl Socket {
    /// Over a stream whose handshake is done and of which `read` was read too far.
    pub(crate) async fn new(stream: Stream, read: Bytes, limits: &Limits, leave: CancellationToken) -> Self {
        let config = WebSocketConfig::default()
            .read_buffer_size(READ_BYTES)
            .write_buffer_size(WRITE_BYTES)
            .max_write_buffer_size(WRITE_BYTES + limits.batch_bytes + (1 << 10))
            .max_message_size(Some(limits.batch_bytes))
            .max_frame_size(Some(limits.batch_bytes));
        let ws = WebSocketStream::from_partially_read(stream, read.into(), Role::Server, Some(config)).await;
        let Limits { control_bytes, ping_after, idle_timeout, write_timeout, .. } = *limits;
        let mut beat = interval(ping_after.min(idle_timeout) / 2);
        beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (heard, pinged) = (Instant::now(), false);
        Socket { ws, leave, control_bytes, ping_after, idle_timeout, write_timeout, heard, pinged, beat }
    }

    /// The next message; replies that wait are sent when none is there yet.
    ///
    /// # Errors
    /// The way in which the connection ends.
    pub(crate) async fn next(&mut self) -> Result<Incoming, Disconnect> {
        loop {
            if self.leave.is_cancelled() {
                return Err(Disconnect::Left);
            }
            let message = match self.ws.next().now_or_never() {
                Some(message) => message,
                None => {
                    self.flush().await?;
                    self.wait().await?
                }
            };
            (self.heard, self.pinged) = (Instant::now(), false);
            match message {
                Some(Ok(Message::Text(text))) if text.len() > self.control_bytes => {
                    return Err(Disconnect::Broke(1009, "the text message is too long"));
                }
                Some(Ok(Message::Text(text))) => return Ok(Incoming::Text(text)),
                Some(Ok(Message::Binary(bytes))) => return Ok(Incoming::Binary(bytes)),
                // pings are answered by the library, with the next thing that is written or read
                Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => {}
                Some(Ok(Message::Close(frame))) => {
                    return Err(Disconnect::Closed(frame.map(|frame| frame.code.into())));
                }
                Some(Err(error)) => return Err(error.into()),
                None => return Err(Disconnect::Lost("closed".into())),
            }
        }
    }

    async fn wait(&mut self) -> Result<Option<Result<Message, Error>>, Disconnect> {
        loop {
            tokio::select! {
                biased;
                message = self.ws.next() => return Ok(message),
                () = self.leave.cancelled() => return Err(Disconnect::Left),
                _ = self.beat.tick() => self.check().await?,
            }
        }
    }

    /// Is the peer still there?
    async fn check(&mut self) -> Result<(), Disconnect> {
        let quiet = self.heard.elapsed();
        if quiet >= self.idle_timeout {
            return Err(Disconnect::Silent);
        }
        if quiet >= self.ping_after && !self.pinged {
            self.pinged = true;
            self.send(Message::Ping(Bytes::new())).await?;
            self.flush().await?;
        }
        Ok(())
    }

    /// Takes a message to be sent; [`Socket::next`] and [`Socket::flush`] send it.
    ///
    /// # Errors
    /// The way in which the connection ends.
    pub(crate) async fn send(&mut self, message: Message) -> Result<(), Disconnect> {
        // what was written before may still be on its way
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
            sent = timeout(self.write_timeout, self.ws.flush()) => Ok(sent.map_err(|_| Disconnect::Stalled)??),
            () = leave => Err(Disconnect::Left),
        }
    }

    /// Sends the close frame that fits, and reads on for a moment. Otherwise a TCP reset could destroy the
    /// frame.
    pub(crate) async fn goodbye(
        mut self,
        disconnect: &Disconnect,
        stop: &CancellationToken,
        metrics: &Metrics,
    ) {
        let stopping = stop.is_cancelled();
        if let Some(rule) = disconnect.rule() {
            metrics.record_refusal(rule);
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
                    self.ws
                        .send(Message::Close(Some(CloseFrame {
                            code: CloseCode::from(code),
                            reason: reason.into(),
                        })))
                        .await?
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
            other => Disconnect::Lost(other.to_string()),
        }
    }
}
