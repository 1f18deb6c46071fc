//! Built-in controllers in attempts on a server elsewhere: a client like anyone's own, which knows what `docs/protocol.md` tells it.

use std::time::Duration;

use crazyflie_env::control::Chosen;
use crazyflie_env::observation::{ACTION, Interface, OBSERVATION};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use tokio_tungstenite::tungstenite::{self, Message, WebSocket};

use crate::bench::baselines;
use crate::bench::{Document, PlannedPhase};
use crate::dial::{DialError, Dialled, Stream, dial};
use crate::flight::phase_at;

/// A server that says nothing for so long is gone; scoring and storing takes a part of it.
const PATIENCE: Duration = Duration::from_secs(60);
/// A step's reply as JSON is some 12 kB.
const REPLY_BYTES: usize = 32 << 10;

#[derive(Debug, thiserror::Error)]
pub(crate) enum Error {
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

/// A reply, as far as it is of use here.
#[derive(Debug, Deserialize)]
struct Reply {
    id: Option<u64>,
    #[serde(flatten)]
    said: Said,
}

#[derive(Debug, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum Said {
    Welcome { scenarios: Vec<String> },
    Begun(Begun),
    Result { observation: Vec<[f32; OBSERVATION]>, over: bool },
    Finished { attempt: Map<String, Value> },
    Error { code: String, message: String },
}

#[derive(Debug, Deserialize)]
struct Begun {
    tick_s: f64,
    interface: Interface,
    phases: Vec<PlannedPhase>,
    observation: Vec<[f32; OBSERVATION]>,
}

/// A connection to a server, for a team.
pub(crate) struct Afar {
    ws: WebSocket<Box<dyn Stream>>,
    url: String,
    token: String,
    id: u64,
    scenarios: Vec<String>,
}

impl Afar {
    /// # Errors
    /// [`Error`] of most kinds.
    pub(crate) fn open(url: &str, token: &str) -> Result<Afar, Error> {
        let url = address(url)?;
        let Dialled { ws, tcp } = dial(&url, REPLY_BYTES).map_err(|problem| Error::Dial { url: url.clone(), problem })?;
        let limit = tcp.set_read_timeout(Some(PATIENCE)).and_then(|()| tcp.set_write_timeout(Some(PATIENCE)));
        limit.map_err(|e| Error::Dial { url: url.clone(), problem: e.into() })?;
        let mut afar = Afar { ws, url, token: token.into(), id: 0, scenarios: Vec::new() };
        let client = concat!("crazyflie submit ", env!("CARGO_PKG_VERSION"));
        match afar.ask("hello", json!({"client": client, "token": token}))? {
            Said::Welcome { scenarios } => afar.scenarios = scenarios,
            other => return Err(afar.unexpected(&other)),
        }
        Ok(afar)
    }

    /// What there is to fly, by `name@version`.
    pub(crate) fn scenarios(&self) -> &[String] {
        &self.scenarios
    }

    /// One attempt from beginning to end, and the row that the server has signed and stored.
    ///
    /// # Errors
    /// [`Error`] of most kinds.
    pub(crate) fn submit(&mut self, scenario: &str, controller: &Chosen) -> Result<Document, Error> {
        let asked = json!({"scenario": scenario, "controller": baselines::name(controller), "token": self.token});
        match self.ask("benchmark", asked)? {
            Said::Begun(begun) => self.fly(begun, controller)?,
            other => return Err(self.unexpected(&other)),
        }
        let mut attempt = match self.ask("finish", json!({}))? {
            Said::Finished { attempt } => attempt,
            other => return Err(self.unexpected(&other)),
        };
        // what the server adds to what it signed
        attempt.remove("signature");
        attempt.remove("at");
        serde_json::from_value(attempt.into()).map_err(|e| self.strange(e))
    }

    fn fly(&mut self, begun: Begun, controller: &Chosen) -> Result<(), Error> {
        let Begun { tick_s, interface, phases, mut observation } = begun;
        let envs = observation.len();
        let phases = phases.iter().map(PlannedPhase::phase).collect::<Result<Vec<_>, _>>()?;
        if phases.is_empty() || envs == 0 {
            return Err(self.strange("an attempt without phases or episodes"));
        }
        let mode = |tick: u32| phase_at(&phases, f64::from(tick) * tick_s).mode;
        let mut pilot = baselines::pilot(controller, interface, tick_s, envs, mode(0))?;
        let mut actions = vec![0.0; envs * ACTION];
        for tick in 0.. {
            pilot.set_mode(mode(tick));
            pilot.act(observation.as_flattened(), &mut actions)?;
            // as the f64 that they are: they come back bit for bit
            let rows: Vec<[f64; ACTION]> = actions.as_chunks().0.iter().map(|row: &[f32; ACTION]| row.map(f64::from)).collect();
            match self.ask("step", json!({"action": rows}))? {
                Said::Result { observation: _, over: true } => break,
                Said::Result { observation: rows, over: false } if rows.len() == envs => observation = rows,
                other => return Err(self.unexpected(&other)),
            }
        }
        Ok(())
    }

    /// Sends a request and waits for its reply.
    fn ask(&mut self, kind: &str, mut message: Value) -> Result<Said, Error> {
        self.id += 1;
        message["id"] = self.id.into();
        message["type"] = kind.into();
        let sent = self.ws.send(Message::text(message.to_string()));
        // what the server said last explains it better than a broken pipe
        let reply = self.hear().map_err(|error| match (sent, error) {
            (Err(problem), Error::Lost { url, .. }) => Error::Lost { url, problem },
            (_, error) => error,
        })?;
        let Reply { id, said } = serde_json::from_str(&reply).map_err(|e| self.strange(e))?;
        match said {
            Said::Error { code, message } => Err(Error::Refused { code, message }),
            said if id == Some(self.id) => Ok(said),
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

    fn unexpected(&self, said: &Said) -> Error {
        let words: String = format!("{said:?}").chars().take(80).collect();
        self.strange(format!("an unexpected reply, {words}"))
    }

    fn strange(&self, problem: impl ToString) -> Error {
        Error::Strange { url: self.url.clone(), problem: problem.to_string() }
    }
}

impl Drop for Afar {
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
