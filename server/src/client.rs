//! A client of the protocol: one request at a time, in JSON.

use std::time::{Duration, Instant};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use tokio_tungstenite::tungstenite::{self, Message, WebSocket};

use crate::connect::{ByteStream, ConnectError, ServerConnection, connect};
use crate::protocol::{Code, Response};

/// Time to wait for a reply. A tick of a shared world takes a part of it.
const REPLY_TIMEOUT: Duration = Duration::from_secs(60);
/// Time for which a request is repeated that a server cannot carry out at the moment.
const UNAVAILABLE_FOR: Duration = Duration::from_secs(60);
/// Size of the read buffer. A step's reply as JSON takes about 12 kB.
const REPLY_BYTES: usize = 32 << 10;

/// Reason that a request got no answer, or a refusal.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "each variant's message says what went wrong")]
pub enum Error {
    // it is not repeated: a password may be in it
    #[error("the server's URL: expected ws://host:port or wss://host:port, without a user")]
    Url,
    #[error("{url}: {problem}")]
    Connect { url: String, problem: ConnectError },
    #[error("{url}: the connection was lost: {problem}")]
    Lost { url: String, problem: tungstenite::Error },
    #[error("{url}: the server closed the connection{why}")]
    Closed { url: String, why: String },
    /// An error reply, in the server's words.
    #[error("{message}")]
    Refused { code: Code, message: String, retry_after_s: Option<u64> },
    #[error("{url} answers in a way that the protocol does not know: {problem}")]
    Unexpected { url: String, problem: String },
    #[error(transparent)]
    Env(#[from] crazyflie_env::Error),
}

/// A request with its id.
#[derive(Debug, Serialize)]
struct Envelope<'a, R> {
    id: u64,
    #[serde(flatten)]
    request: &'a R,
}

/// The fields that every reply has.
#[derive(Debug, Deserialize)]
struct ReplyHead<'a> {
    id: Option<u64>,
    #[serde(rename = "type")]
    kind: &'a str,
}

/// A connection to a server.
pub struct Client {
    ws: WebSocket<Box<dyn ByteStream>>,
    url: String,
    id: u64,
}

impl Client {
    /// # Errors
    /// [`Error::Url`] and [`Error::Connect`].
    pub fn open(url: &str) -> Result<Client, Error> {
        let url = server_url(url)?;
        let ServerConnection { ws, tcp } =
            connect(&url, REPLY_BYTES).map_err(|problem| Error::Connect { url: url.clone(), problem })?;
        let limit = tcp
            .set_read_timeout(Some(REPLY_TIMEOUT))
            .and_then(|()| tcp.set_write_timeout(Some(REPLY_TIMEOUT)));
        limit.map_err(|e| Error::Connect { url: url.clone(), problem: e.into() })?;
        Ok(Client { ws, url, id: 0 })
    }

    /// Sends a request, of the server or its extension, and waits for its reply. A server that is unavailable for a
    /// time, such as one whose database is away, gets the request again for a minute.
    ///
    /// # Errors
    /// [`Error`] of most kinds.
    pub fn request<A: DeserializeOwned>(&mut self, request: &impl Serialize) -> Result<A, Error> {
        let until = Instant::now() + UNAVAILABLE_FOR;
        loop {
            match self.request_once(request) {
                Err(Error::Refused { code: Code::Unavailable, retry_after_s: Some(wait_s), .. })
                    if Instant::now() < until =>
                {
                    std::thread::sleep(Duration::from_secs(wait_s));
                }
                answer => return answer,
            }
        }
    }

    fn request_once<A: DeserializeOwned>(&mut self, request: &impl Serialize) -> Result<A, Error> {
        self.id += 1;
        let message = serde_json::to_string(&Envelope { id: self.id, request });
        let sent = self.ws.send(Message::text(message.map_err(|e| self.unexpected(e))?));
        // the last reply of the server explains it better than a broken pipe
        let reply = self.read_text().map_err(|error| match (sent, error) {
            (Err(problem), Error::Lost { url, .. }) => Error::Lost { url, problem },
            (_, error) => error,
        })?;
        let ReplyHead { id, kind } = serde_json::from_str(&reply).map_err(|e| self.unexpected(e))?;
        if kind == "error"
            && let Response::Error { code, message, retry_after_s, .. } =
                serde_json::from_str(&reply).map_err(|e| self.unexpected(e))?
        {
            return Err(Error::Refused { code, message: message.into_owned(), retry_after_s });
        }
        if id != Some(self.id) {
            return Err(self.unexpected(format!("a reply with the id {id:?}, expected {}", self.id)));
        }
        serde_json::from_str(&reply).map_err(|e| self.unexpected(e))
    }

    /// The next text message.
    fn read_text(&mut self) -> Result<tungstenite::Utf8Bytes, Error> {
        loop {
            match self.ws.read() {
                Ok(Message::Text(text)) => return Ok(text),
                Ok(Message::Binary(_)) => return Err(self.unexpected("a binary message")),
                Ok(Message::Close(frame)) => {
                    let why = frame.map_or(String::new(), |frame| {
                        format!(": {} (close code {})", frame.reason, u16::from(frame.code))
                    });
                    return Err(Error::Closed { url: self.url.clone(), why });
                }
                Ok(_) => {}
                Err(problem) => return Err(Error::Lost { url: self.url.clone(), problem }),
            }
        }
    }

    /// An error for a reply that does not fit the protocol.
    pub fn unexpected(&self, problem: impl ToString) -> Error {
        Error::Unexpected { url: self.url.clone(), problem: problem.to_string() }
    }

    /// An error for a reply to another request than the one that was sent.
    pub fn unexpected_response(&self, response: &impl std::fmt::Debug) -> Error {
        let words: String = format!("{response:?}").chars().take(80).collect();
        self.unexpected(format!("an unexpected reply, {words}"))
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        // there is nobody to tell of a goodbye that fails
        let _ = self.ws.close(None).and_then(|()| self.ws.flush());
    }
}

/// The URL, with the default path if it names none. URLs with a user are refused: they would get into logs.
fn server_url(url: &str) -> Result<String, Error> {
    let uri: tungstenite::http::Uri = url.parse().map_err(|_| Error::Url)?;
    let authority = uri.authority().filter(|a| !a.as_str().contains('@')).ok_or(Error::Url)?;
    match (uri.scheme_str(), uri.path()) {
        (Some(scheme @ ("ws" | "wss")), "" | "/") => Ok(format!("{scheme}://{authority}/ws")),
        (Some("ws" | "wss"), _) => Ok(url.into()),
        _ => Err(Error::Url),
    }
}
