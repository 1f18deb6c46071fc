//! A WebSocket that waits for one reply at a time.

use std::io::ErrorKind;
use std::time::{Duration, Instant};

use bytes::Bytes;
use crazyflie_server::connect::{ByteStream, ServerConnection, connect};
use pyo3::Python;
use tungstenite::protocol::CloseFrame;
use tungstenite::protocol::frame::coding::CloseCode;
use tungstenite::{Error, Message, WebSocket};

use super::client_error::ClientError;

/// Interval at which signals are checked while a reply is awaited.
const SIGNAL_POLL: Duration = Duration::from_millis(250);
/// Time to wait for a server that takes no bytes.
const WRITE_TIMEOUT: Duration = Duration::from_secs(20);
/// No answer to pings; a server closes with this.
const SILENT: u16 = 4002;

pub struct Socket {
    ws: WebSocket<Box<dyn ByteStream>>,
    url: String,
}

impl Socket {
    /// `reply_bytes` is the size of the usual reply and sizes the read buffer.
    ///
    /// # Errors
    /// [`ClientError::Lost`] if nobody answers, or not in this protocol.
    pub fn connect(url: &str, reply_bytes: usize) -> Result<Socket, ClientError> {
        let lost_error = |why: String| ClientError::Lost { url: url.into(), why };
        let ServerConnection { ws, tcp } =
            connect(url, reply_bytes).map_err(|e| lost_error(e.to_string()))?;
        tcp.set_read_timeout(Some(SIGNAL_POLL)).map_err(|e| lost_error(e.to_string()))?;
        tcp.set_write_timeout(Some(WRITE_TIMEOUT)).map_err(|e| lost_error(e.to_string()))?;
        Ok(Socket { ws, url: url.into() })
    }

    /// Sends a request.
    ///
    /// # Errors
    /// [`ClientError::Lost`].
    pub fn send(&mut self, message: Message) -> Result<(), ClientError> {
        let Err(error) = self.ws.send(message) else { return Ok(()) };
        // what the server said last explains it better than a broken pipe
        match self.ws.read() {
            Ok(Message::Close(frame)) => Err(self.close_error(frame)),
            _ => Err(self.lost_error(error.to_string())),
        }
    }

    /// The next text or binary message.
    ///
    /// # Errors
    /// [`ClientError::Lost`] also if none comes within `timeout`, [`ClientError::Ended`], and what Python's
    /// signal handlers raise.
    pub fn receive(&mut self, timeout: Duration) -> Result<Message, ClientError> {
        let began = Instant::now();
        loop {
            match self.ws.read() {
                Ok(message @ (Message::Text(_) | Message::Binary(_))) => return Ok(message),
                Ok(Message::Close(frame)) => return Err(self.close_error(frame)),
                Ok(_) => {}
                Err(Error::Io(error))
                    if matches!(
                        error.kind(),
                        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
                    ) =>
                {
                    Python::attach(|py| py.check_signals())?;
                    if began.elapsed() > timeout {
                        return Err(self.lost_error(format!("no reply within {} s", timeout.as_secs())));
                    }
                }
                Err(error) => return Err(self.lost_error(error.to_string())),
            }
        }
    }

    /// Lets the server know that we are there; it answers nothing.
    pub fn beat(&mut self) {
        // who is not there any more is found out by the next request
        let _ = self.ws.send(Message::Pong(Bytes::new()));
    }

    /// Says goodbye; the server ends the session.
    pub fn close(&mut self) {
        let frame = CloseFrame { code: CloseCode::Normal, reason: "".into() };
        // there is nobody to tell of a goodbye that fails
        let _ = self.ws.close(Some(frame)).and_then(|()| self.ws.flush());
    }

    fn lost_error(&self, why: String) -> ClientError {
        ClientError::Lost { url: self.url.clone(), why }
    }

    fn close_error(&self, frame: Option<CloseFrame>) -> ClientError {
        let Some(frame) = frame else { return self.lost_error("the server closed it".into()) };
        let (url, code) = (self.url.clone(), u16::from(frame.code));
        let why = format!("{} (close code {code})", frame.reason);
        // the session waits, though the server lost patience with the connection
        if code == SILENT { ClientError::Lost { url, why } } else { ClientError::Ended { url, why } }
    }
}
