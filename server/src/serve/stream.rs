//! The byte stream of a connection, whatever it speaks. An unfinished message counts against a budget, and a peer that
//! takes nothing for a while loses the connection.

use std::io::{Error, ErrorKind, IoSlice, Result};
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio_rustls::server::TlsStream;
use tokio_util::either::Either;

use super::budget::Buffer;
use super::moment::{Moment, sleep};

/// Bytes that are read before other connections have their turn, and the time that it takes to read a message.
const TURN_BYTES: usize = 16 << 10;
const TURN: Duration = Duration::from_micros(100);
/// Bytes of a turn at least, where a few are much work: a message of empty frames.
const LEAST_TURN_BYTES: usize = 256;

/// The bytes as the system or TLS has them.
pub(crate) type Transport = Either<TcpStream, Box<TlsStream<TcpStream>>>;

pub(crate) struct Stream {
    transport: Transport,
    /// Longest time in which the peer takes no byte.
    write_timeout: Duration,
    /// Runs while the peer takes no byte.
    stalled: Option<Pin<Box<dyn Future<Output = ()> + Send>>>,
    read_in_turn: usize,
    turn_bytes: usize,
    /// When the turn began, while a message is read.
    turn_began: Option<Instant>,
    requests: Option<Box<Requests>>,
}

/// Memory of the messages that a peer sends.
struct Requests {
    buffer: Buffer,
    /// The largest message so far: so much memory has the buffer from then on.
    largest: usize,
    /// Bytes of the message that is not complete yet.
    unfinished: usize,
    /// When its first byte arrived.
    since: Moment,
}

impl Stream {
    pub(crate) fn new(transport: Transport, write_timeout: Duration) -> Stream {
        let (stalled, turn_began, requests) = (None, None, None);
        let (read_in_turn, turn_bytes) = (0, TURN_BYTES);
        Stream { transport, write_timeout, stalled, read_in_turn, turn_bytes, turn_began, requests }
    }

    /// Counts incoming messages from now on.
    pub(crate) fn count_requests(&mut self, buffer: Buffer) {
        let (largest, unfinished, since) = (0, 0, Moment::now());
        self.requests = Some(Box::new(Requests { buffer, largest, unfinished, since }));
    }

    /// A message of so many bytes is complete.
    pub(crate) fn end_message(&mut self, bytes: usize) {
        // its answer takes a turn of its own
        self.turn_began = None;
        let Some(requests) = &mut self.requests else { return };
        (requests.largest, requests.unfinished) = (requests.largest.max(bytes), 0);
        // less than before, so it is not refused
        let _ = requests.buffer.fit(requests.largest);
    }

    /// So many bytes were a ping or a pong, and no part of a message.
    pub(crate) fn end_control_frame(&mut self, bytes: usize) {
        let Some(requests) = &mut self.requests else { return };
        requests.unfinished = requests.unfinished.saturating_sub(bytes);
    }

    /// Time since the first byte of a message that is not complete.
    pub(crate) fn unfinished_for(&self) -> Option<Duration> {
        self.requests.as_ref().filter(|requests| requests.unfinished > 0).map(|it| it.since.elapsed())
    }

    /// Bytes that may be read in this turn; none at its end. The next one is shorter if this one took too long.
    fn left_in_turn(&mut self) -> Option<usize> {
        let is_slow = self.turn_began.is_some_and(|began| began.elapsed() > TURN);
        let left = self.turn_bytes.checked_sub(self.read_in_turn).filter(|left| *left > 0 && !is_slow);
        if left.is_none() {
            self.turn_bytes = match is_slow {
                true => (self.turn_bytes / 2).max(LEAST_TURN_BYTES),
                false => (self.turn_bytes * 2).min(TURN_BYTES),
            };
            (self.read_in_turn, self.turn_began) = (0, None);
        }
        left
    }

    /// Limits the time for which the peer takes nothing.
    fn written<T>(&mut self, cx: &mut Context<'_>, written: Poll<Result<T>>) -> Poll<Result<T>> {
        if written.is_ready() {
            self.stalled = None;
            return written;
        }
        let limit = self.write_timeout;
        let stalled = self.stalled.get_or_insert_with(|| Box::pin(sleep(limit)));
        ready!(stalled.as_mut().poll(cx));
        Poll::Ready(Err(ErrorKind::TimedOut.into()))
    }
}

impl Requests {
    /// # Errors
    /// [`ErrorKind::QuotaExceeded`] if there is no room for so much of a message.
    fn add(&mut self, bytes: usize) -> Result<()> {
        if self.unfinished == 0 {
            self.since = Moment::now();
        }
        self.unfinished += bytes;
        // the frame as it arrives, and the parts before it
        let room = self.buffer.fit(self.largest.max(2 * self.unfinished));
        room.map_err(|_| ErrorKind::QuotaExceeded.into())
    }
}

impl AsyncRead for Stream {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<Result<()>> {
        let this = self.get_mut();
        let Some(left) = this.left_in_turn() else {
            cx.waker().wake_by_ref();
            return Poll::Pending;
        };
        let mut part = ReadBuf::new(buf.initialize_unfilled_to(left.min(buf.remaining())));
        let read = Pin::new(&mut this.transport).poll_read(cx, &mut part);
        let bytes = part.filled().len();
        if read.is_pending() {
            (this.read_in_turn, this.turn_began) = (0, None);
        }
        ready!(read)?;
        buf.advance(bytes);
        this.read_in_turn += bytes;
        if this.requests.is_some() {
            this.turn_began.get_or_insert_with(Instant::now);
        }
        Poll::Ready(this.requests.as_mut().map_or(Ok(()), |requests| requests.add(bytes)))
    }
}

impl AsyncWrite for Stream {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<Result<usize>> {
        let written = Pin::new(&mut self.transport).poll_write(cx, bytes);
        self.written(cx, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[IoSlice<'_>],
    ) -> Poll<Result<usize>> {
        let written = Pin::new(&mut self.transport).poll_write_vectored(cx, slices);
        self.written(cx, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.transport.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Result<()>> {
        let flushed = Pin::new(&mut self.transport).poll_flush(cx);
        self.written(cx, flushed)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.transport).poll_shutdown(cx)
    }
}

/// Returns whether the peer took no byte for too long.
pub(crate) fn is_stalled(error: &(dyn std::error::Error + 'static)) -> bool {
    std::iter::successors(Some(error), |error| error.source())
        .filter_map(|error| error.downcast_ref::<Error>())
        .any(|error| error.kind() == ErrorKind::TimedOut)
}
