//! A conversation with a server: requests with growing ids, and the same conversation over a new connection if one is lost.

use std::thread::sleep;
use std::time::{Duration, Instant};

use pyo3::Python;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use tungstenite::Message;

use super::socket::Socket;
use super::trouble::Trouble;

/// Between two tries to connect again, at first and at most.
const PAUSE: [Duration; 2] = [Duration::from_millis(50), Duration::from_secs(1)];

pub struct Link {
    socket: Socket,
    url: String,
    hello: Map<String, Value>,
    reply_bytes: usize,
    id: u64,
    /// Name and token of a session to come back to.
    pub session: Option<(String, String)>,
    pub welcome: Welcome,
    /// For so long a lost session is looked for.
    pub resume_s: f64,
    pub resumed: u64,
}

/// What a server says of itself.
#[derive(Debug, Clone, Deserialize)]
pub struct Welcome {
    pub max_text_bytes: usize,
    pub resume_s: f64,
    pub ping_s: f64,
    pub idle_s: f64,
}

impl Link {
    /// # Errors
    /// [`Trouble`] of any kind.
    pub fn open(url: &str, token: Option<&str>, reply_bytes: usize) -> Result<Link, Trouble> {
        let mut hello = Map::from_iter([("client".into(), concat!("crazyflie_gym ", env!("CARGO_PKG_VERSION")).into())]);
        if let Some(token) = token {
            hello.insert("token".into(), token.into());
        }
        let socket = Socket::connect(url, reply_bytes)?;
        let welcome = Welcome { max_text_bytes: usize::MAX, resume_s: 0.0, ping_s: 20.0, idle_s: 60.0 };
        let mut link = Link { socket, url: url.into(), hello, reply_bytes, id: 0, session: None, welcome, resume_s: 0.0, resumed: 0 };
        let welcome = link.ask("hello", link.hello.clone())?;
        link.welcome = link.read(welcome)?;
        link.resume_s = link.welcome.resume_s;
        Ok(link)
    }

    /// Ids of an attempt at a request and of its repetition are the same: the server carries it out once.
    pub fn next_id(&mut self) -> u64 {
        self.id += 1;
        self.id
    }

    /// A reply as the type that is expected of it.
    ///
    /// # Errors
    /// [`Trouble::Strange`].
    pub fn read<T: serde::de::DeserializeOwned>(&self, reply: Value) -> Result<T, Trouble> {
        serde_json::from_value(reply).map_err(|e| self.strange(e.to_string()))
    }

    pub fn strange(&self, why: String) -> Trouble {
        Trouble::Strange { url: self.url.clone(), why }
    }

    /// A request in JSON.
    ///
    /// # Errors
    /// [`Trouble`] of any kind.
    pub fn ask(&mut self, kind: &str, mut fields: Map<String, Value>) -> Result<Value, Trouble> {
        let id = self.next_id();
        fields.insert("id".into(), id.into());
        fields.insert("type".into(), kind.into());
        let text = Value::Object(fields).to_string();
        let most = self.welcome.max_text_bytes;
        if text.len() > most {
            let message = format!("{kind}: a message of {} bytes, the server takes {most}", text.len());
            return Err(Trouble::Refused { code: "too_large".into(), message });
        }
        match self.exchange(id, Message::text(text))? {
            Message::Text(text) => serde_json::from_str(&text).map_err(|e| self.strange(e.to_string())),
            _ => Err(self.strange(format!("a binary reply to {kind}"))),
        }
    }

    /// Sends a request and returns its reply; over a new connection if that is what it takes.
    ///
    /// # Errors
    /// [`Trouble`] of any kind; a second loss is not mended.
    pub fn exchange(&mut self, id: u64, request: Message) -> Result<Message, Trouble> {
        match self.attempt(id, request.clone()) {
            Err(lost @ Trouble::Lost { .. }) => {
                self.resume(lost)?;
                self.attempt(id, request)
            }
            other => other,
        }
    }

    fn attempt(&mut self, id: u64, request: Message) -> Result<Message, Trouble> {
        self.socket.send(request)?;
        let timeout = Duration::from_secs_f64(self.welcome.idle_s);
        loop {
            let message = self.socket.receive(timeout)?;
            let got = match &message {
                Message::Binary(bytes) => bytes.first_chunk().map(|id| u64::from_le_bytes(*id)),
                Message::Text(text) => match self.refusal(text)? {
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
                _ => return Err(self.strange(format!("a reply with the id {got:?}, expected {id}"))),
            }
        }
    }

    /// The id of a text message, and the error that it may be.
    fn refusal(&self, text: &str) -> Result<(Option<u64>, Option<Trouble>), Trouble> {
        #[derive(Deserialize)]
        struct Head {
            id: Option<u64>,
            #[serde(rename = "type")]
            kind: String,
            code: Option<String>,
            message: Option<String>,
        }
        let head: Head = serde_json::from_str(text).map_err(|e| self.strange(e.to_string()))?;
        let refused = (head.kind == "error")
            .then(|| Trouble::Refused { code: head.code.unwrap_or_default(), message: head.message.unwrap_or_default() });
        Ok((head.id, refused))
    }

    /// Connects anew and takes the session up again.
    fn resume(&mut self, lost: Trouble) -> Result<(), Trouble> {
        let (began, mut pause) = (Instant::now(), PAUSE[0]);
        let Some((name, token)) = self.session.clone() else { return Err(lost) };
        loop {
            match self.back(&name, &token) {
                Ok(()) => {
                    self.resumed += 1;
                    return Ok(());
                }
                Err(Trouble::Lost { .. }) if began.elapsed().as_secs_f64() < self.resume_s => {}
                Err(Trouble::Refused { message, .. }) => {
                    return Err(Trouble::Ended { url: self.url.clone(), why: format!("{lost}; {message}") });
                }
                Err(Trouble::Lost { .. }) => return Err(lost),
                Err(other) => return Err(other),
            }
            // interrupts are not slept through: a pause is at most a second
            sleep(pause);
            pause = (2 * pause).min(PAUSE[1]);
            Python::attach(|py| py.check_signals())?;
        }
    }

    fn back(&mut self, name: &str, token: &str) -> Result<(), Trouble> {
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
