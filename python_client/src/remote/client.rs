//! A client of a server: requests with growing ids, resumed over a new connection if one is lost.

use std::thread::sleep;
use std::time::{Duration, Instant};

use crazyflie_server::protocol::ServerInfo;
use pyo3::Python;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};
use tungstenite::Message;

use super::client_error::ClientError;
use super::socket::Socket;

/// Between two tries to connect again, at first and at most.
const RETRY_PAUSE: [Duration; 2] = [Duration::from_millis(50), Duration::from_secs(1)];

pub struct Client {
    socket: Socket,
    url: String,
    hello: Map<String, Value>,
    reply_bytes: usize,
    id: u64,
    /// Name and token of a session to come back to.
    pub session: Option<(String, String)>,
    pub limits: ServerLimits,
    /// Seconds for which a lost session is looked for.
    pub resume_s: f64,
    pub resumed: u64,
}

/// Limits of the server, as far as they are needed.
#[derive(Debug, Clone)]
pub struct ServerLimits {
    pub max_text_bytes: usize,
    pub ping_s: f64,
    pub idle_s: f64,
}

impl Client {
    /// # Errors
    /// [`ClientError`] of any kind.
    pub fn open(url: &str, token: Option<&str>, reply_bytes: usize) -> Result<Client, ClientError> {
        let mut hello =
            Map::from_iter([("client".into(), concat!("crazyflie_gym ", env!("CARGO_PKG_VERSION")).into())]);
        if let Some(token) = token {
            hello.insert("token".into(), token.into());
        }
        let socket = Socket::connect(url, reply_bytes)?;
        let limits = ServerLimits { max_text_bytes: usize::MAX, ping_s: 20.0, idle_s: 60.0 };
        let mut client = Client {
            socket,
            url: url.into(),
            hello,
            reply_bytes,
            id: 0,
            session: None,
            limits,
            resume_s: 0.0,
            resumed: 0,
        };
        let reply = client.request("hello", client.hello.clone())?;
        let ServerInfo { max_text_bytes, resume_s, ping_s, idle_s, .. } = client.read(reply)?;
        client.limits = ServerLimits { max_text_bytes, ping_s, idle_s };
        client.resume_s = resume_s;
        Ok(client)
    }

    /// Id of the next request. A repetition has the same id, so the server executes it once.
    pub fn next_id(&mut self) -> u64 {
        self.id += 1;
        self.id
    }

    /// The reply in its parts.
    ///
    /// # Errors
    /// [`ClientError::Unexpected`].
    pub fn read<T: DeserializeOwned>(&self, reply: Value) -> Result<T, ClientError> {
        serde_json::from_value(reply).map_err(|e| self.unexpected(e.to_string()))
    }

    pub fn unexpected(&self, why: String) -> ClientError {
        ClientError::Unexpected { url: self.url.clone(), why }
    }

    /// A request in JSON.
    ///
    /// # Errors
    /// [`ClientError`] of any kind.
    pub fn request(&mut self, kind: &str, mut fields: Map<String, Value>) -> Result<Value, ClientError> {
        let id = self.next_id();
        fields.insert("id".into(), id.into());
        fields.insert("type".into(), kind.into());
        let text = Value::Object(fields).to_string();
        let max = self.limits.max_text_bytes;
        if text.len() > max {
            let message = format!("{kind}: a message of {} bytes, the server takes {max}", text.len());
            return Err(ClientError::Refused { code: "too_large".into(), message });
        }
        match self.exchange(id, Message::text(text))? {
            Message::Text(text) => serde_json::from_str(&text).map_err(|e| self.unexpected(e.to_string())),
            _ => Err(self.unexpected(format!("a binary reply to {kind}"))),
        }
    }

    /// Sends a request and returns its reply; over a new connection if that is what it takes.
    ///
    /// # Errors
    /// [`ClientError`] of any kind; a second loss is not mended.
    pub fn exchange(&mut self, id: u64, request: Message) -> Result<Message, ClientError> {
        match self.attempt(id, request.clone()) {
            Err(lost @ ClientError::Lost { .. }) => {
                self.resume(lost)?;
                self.attempt(id, request)
            }
            other => other,
        }
    }

    fn attempt(&mut self, id: u64, request: Message) -> Result<Message, ClientError> {
        self.socket.send(request)?;
        let timeout = Duration::from_secs_f64(self.limits.idle_s);
        loop {
            let message = self.socket.receive(timeout)?;
            let got = match &message {
                Message::Binary(bytes) => bytes.first_chunk().map(|id| u64::from_le_bytes(*id)),
                Message::Text(text) => match self.error_of_reply(text)? {
                    (got, None) => got,
                    (got, Some(refused)) if got.is_none_or(|got| got == id) => return Err(refused),
                    (got, Some(_)) => got,
                },
                _ => continue,
            };
            match got {
                Some(got) if got == id => return Ok(message),
                // of a request whose caller was interrupted
                Some(got) if got < id => {}
                _ => return Err(self.unexpected(format!("a reply with the id {got:?}, expected {id}"))),
            }
        }
    }

    /// The id of a text message, and the error that it may be.
    fn error_of_reply(&self, text: &str) -> Result<(Option<u64>, Option<ClientError>), ClientError> {
        #[derive(Deserialize)]
        struct ReplyHeader {
            id: Option<u64>,
            #[serde(rename = "type")]
            kind: String,
            code: Option<String>,
            message: Option<String>,
        }
        let head: ReplyHeader = serde_json::from_str(text).map_err(|e| self.unexpected(e.to_string()))?;
        let refused = (head.kind == "error").then(|| ClientError::Refused {
            code: head.code.unwrap_or_default(),
            message: head.message.unwrap_or_default(),
        });
        Ok((head.id, refused))
    }

    /// Connects anew and takes the session up again.
    fn resume(&mut self, lost: ClientError) -> Result<(), ClientError> {
        let (began, mut pause) = (Instant::now(), RETRY_PAUSE[0]);
        let Some((name, token)) = self.session.clone() else { return Err(lost) };
        loop {
            match self.reconnect(&name, &token) {
                Ok(()) => {
                    self.resumed += 1;
                    return Ok(());
                }
                Err(ClientError::Lost { .. }) if began.elapsed().as_secs_f64() < self.resume_s => {}
                Err(ClientError::Refused { message, .. }) => {
                    return Err(ClientError::Ended {
                        url: self.url.clone(),
                        why: format!("{lost}; {message}"),
                    });
                }
                Err(ClientError::Lost { .. }) => return Err(lost),
                Err(other) => return Err(other),
            }
            // interrupts are not slept through: a pause is at most a second
            sleep(pause);
            pause = (2 * pause).min(RETRY_PAUSE[1]);
            Python::attach(|py| py.check_signals())?;
        }
    }

    fn reconnect(&mut self, name: &str, token: &str) -> Result<(), ClientError> {
        self.socket = Socket::connect(&self.url, self.reply_bytes)?;
        let ask = |id: u64, mut message: Value| {
            message["id"] = id.into();
            Message::text(message.to_string())
        };
        let mut hello = Value::Object(self.hello.clone());
        hello["type"] = "hello".into();
        // these two are the connection's, not the session's: their ids need not grow
        self.attempt(0, ask(0, hello))?;
        self.attempt(0, ask(0, json!({"type": "resume", "session": name, "token": token})))?;
        Ok(())
    }

    pub fn beat(&mut self) {
        self.socket.beat();
    }

    /// The server ends the session.
    pub fn close(&mut self) {
        self.session = None;
        self.socket.close();
    }
}
