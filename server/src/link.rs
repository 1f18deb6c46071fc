//! A client's end of the protocol: one request at a time, in JSON.

use std::time::Duration;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use tokio_tungstenite::tungstenite::{self, Message, WebSocket};

use crate::dial::{DialError, Dialled, Stream, dial};

/// A server that says nothing for so long is gone; scoring and storing takes a part of it, and so may a tick of a shared world.
const PATIENCE: Duration = Duration::from_secs(60);
/// A step's reply as JSON is some 12 kB.
const REPLY_BYTES: usize = 32 << 10;

#[derive(Debug, thiserror::Error)]
pub enum Error {
    // it is not repeated: a password may be in it
    #[error("the server's URL: expected ws://host:port or wss://host:port, without a user")]
    Url,
    #[error("{url}: {problem}")]
    Dial { url: String, problem: DialError },
    #[error("{url}: the connection was lost: {problem}")]
    Lost { url: String, problem: tungstenite::Error },
    #[error("{url}: the server closed the connection{why}")]
    Closed { url: String, why: String },
    /// In the server's words.
    #[error("{message}")]
    Refused { code: String, message: String },
    #[error("{url} answers in a way that the protocol does not know: {problem}")]
    Strange { url: String, problem: String },
    #[error(transparent)]
    Env(#[from] crazyflie_env::Error),
}

/// What every reply has, and errors.
#[derive(Debug, Deserialize)]
struct Head {
    id: Option<u64>,
    code: Option<String>,
    message: Option<String>,
}

/// A connection to a server.
pub struct Link {
    ws: WebSocket<Box<dyn Stream>>,
    url: String,
    id: u64,
}

impl Link {
    /// # Errors
    /// [`Error::Url`] and [`Error::Dial`].
    pub fn open(url: &str) -> Result<Link, Error> {
        let url = address(url)?;
        let Dialled { ws, tcp } = dial(&url, REPLY_BYTES).map_err(|problem| Error::Dial { url: url.clone(), problem })?;
        let limit = tcp.set_read_timeout(Some(PATIENCE)).and_then(|()| tcp.set_write_timeout(Some(PATIENCE)));
        limit.map_err(|e| Error::Dial { url: url.clone(), problem: e.into() })?;
        Ok(Link { ws, url, id: 0 })
    }

    /// Sends a request and waits for its reply.
    ///
    /// # Errors
    /// [`Error`] of most kinds.
    pub fn ask<T: DeserializeOwned>(&mut self, kind: &str, mut message: Value) -> Result<T, Error> {
        self.id += 1;
        message["id"] = self.id.into();
        message["type"] = kind.into();
        let sent = self.ws.send(Message::text(message.to_string()));
        // what the server said last explains it better than a broken pipe
        let reply = self.hear().map_err(|error| match (sent, error) {
            (Err(problem), Error::Lost { url, .. }) => Error::Lost { url, problem },
            (_, error) => error,
        })?;
        let Head { id, code, message } = serde_json::from_str(&reply).map_err(|e| self.strange(e))?;
        match (code, message) {
            (Some(code), Some(message)) => Err(Error::Refused { code, message }),
            _ if id == Some(self.id) => serde_json::from_str(&reply).map_err(|e| self.strange(e)),
            _ => Err(self.strange(format!("a reply with the id {id:?}, expected {}", self.id))),
        }
    }

    /// The next text message.
    fn hear(&mut self) -> Result<tungstenite::Utf8Bytes, Error> {
        loop {
            match self.ws.read() {
                Ok(Message::Text(text)) => return Ok(text),
                Ok(Message::Binary(_)) => return Err(self.strange("a binary message")),
                Ok(Message::Close(frame)) => {
                    let why = frame.map_or(String::new(), |frame| format!(": {} (close code {})", frame.reason, u16::from(frame.code)));
                    return Err(Error::Closed { url: self.url.clone(), why });
                }
                Ok(_) => {}
                Err(problem) => return Err(Error::Lost { url: self.url.clone(), problem }),
            }
        }
    }

    pub fn strange(&self, problem: impl ToString) -> Error {
        Error::Strange { url: self.url.clone(), problem: problem.to_string() }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        // there is nobody to tell of a goodbye that fails
        let _ = self.ws.close(None).and_then(|()| self.ws.flush());
    }
}

/// The URL with the path that servers listen on, unless it names one. A user in it would get into logs.
fn address(url: &str) -> Result<String, Error> {
    let uri: tungstenite::http::Uri = url.parse().map_err(|_| Error::Url)?;
    let authority = uri.authority().filter(|a| !a.as_str().contains('@')).ok_or(Error::Url)?;
    match (uri.scheme_str(), uri.path()) {
        (Some(scheme @ ("ws" | "wss")), "" | "/") => Ok(format!("{scheme}://{authority}/ws")),
        (Some("ws" | "wss"), _) => Ok(url.into()),
        _ => Err(Error::Url),
    }
}
