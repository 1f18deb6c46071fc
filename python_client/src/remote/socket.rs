//! A WebSocket that waits for one reply at a time.

use std::io::ErrorKind;
use std::time::{Duration, Instant};

use bytes::Bytes;
use crazyflie_server::dial::{Dialled, Stream, dial};
use pyo3::Python;
use tungstenite::protocol::CloseFrame;
use tungstenite::protocol::frame::coding::CloseCode;
use tungstenite::{Error, Message, WebSocket};

use super::trouble::Trouble;

/// How long an interrupt of the user's may go unnoticed.
const NOTICE: Duration = Duration::from_millis(250);
/// A server that takes nothing for so long is gone.
const WRITE_TIMEOUT: Duration = Duration::from_secs(20);
/// No answer to pings; a server closes with this.
const SILENT: u16 = 4002;

pub struct Socket {
    ws: WebSocket<Box<dyn Stream>>,
    url: String,
}

impl Socket {
    /// `reply_bytes` is the size of the usual reply: a buffer for it is filled anew by each read.
    ///
    /// # Errors
    /// [`Trouble::Lost`] if nobody answers, or not in this protocol.
    pub fn connect(url: &str, reply_bytes: usize) -> Result<Socket, Trouble> {
        let lost = |why: String| Trouble::Lost { url: url.into(), why };
        let Dialled { ws, tcp } = dial(url, reply_bytes).map_err(|e| lost(e.to_string()))?;
        tcp.set_read_timeout(Some(NOTICE)).map_err(|e| lost(e.to_string()))?;
        tcp.set_write_timeout(Some(WRITE_TIMEOUT)).map_err(|e| lost(e.to_string()))?;
        Ok(Socket { ws, url: url.into() })
    }

    /// Sends a request.
    ///
    /// # Errors
    /// [`Trouble::Lost`].
    pub fn send(&mut self, message: Message) -> Result<(), Trouble> {
        let Err(error) = self.ws.send(message) else { return Ok(()) };
        // what the server said last explains it better than a broken pipe
        match self.ws.read() {
            Ok(Message::Close(frame)) => Err(self.parted(frame)),
            _ => Err(self.lost(error.to_string())),
        }
    }

    /// The next text or binary message.
    ///
    /// # Errors
    /// [`Trouble::Lost`] also if none comes within `timeout`, [`Trouble::Ended`], and what Python's signal handlers raise.
    pub fn receive(&mut self, timeout: Duration) -> Result<Message, Trouble> {
        let began = Instant::now();
        loop {
            match self.ws.read() {
                Ok(message @ (Message::Text(_) | Message::Binary(_))) => return Ok(message),
                Ok(Message::Close(frame)) => return Err(self.parted(frame)),
                Ok(_) => {}
                Err(Error::Io(error)) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) => {
                    Python::attach(|py| py.check_signals())?;
                    if began.elapsed() > timeout {
                        return Err(self.lost(format!("no reply within {} s", timeout.as_secs())));
                    }
                }
                Err(error) => return Err(self.lost(error.to_string())),
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

    fn lost(&self, why: String) -> Trouble {
        Trouble::Lost { url: self.url.clone(), why }
    }

    fn parted(&self, frame: Option<CloseFrame>) -> Trouble {
        let Some(frame) = frame else { return self.lost("the server closed it".into()) };
        let (url, code) = (self.url.clone(), u16::from(frame.code));
        let why = format!("{} (close code {code})", frame.reason);
        // the session waits, though the server lost patience with the connection
        if code == SILENT { Trouble::Lost { url, why } } else { Trouble::Ended { url, why } }
    }
}
