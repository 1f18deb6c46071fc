//! Requests in JSON: `docs/protocol.md` says what every field means.

use crazyflie_env::observation::ACTION;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::protocol_error::{Code, ProtocolError};
use super::wire::MAX_ID;
use super::world_messages::{Fly, Join, WorldRequest};

/// Fields that every message has. The others are read when the type is known.
#[derive(Debug, Deserialize)]
pub(crate) struct Envelope {
    pub id: Option<Value>,
    #[serde(rename = "type")]
    pub kind: Option<Value>,
}

/// A request, apart from its id.
#[derive(Debug)]
pub(crate) enum Request {
    Hello(Hello),
    Make(Box<Make>),
    Reset(Reset),
    Step(Step),
    State,
    Close,
    Resume(Resume),
    Benchmark(Benchmark),
    Finish,
    World(Box<WorldRequest>),
    Join(Join),
    Fly(Fly),
    Leave,
}

/// Of a message without further fields.
#[derive(Debug, Deserialize)]
struct Empty {}

#[derive(Debug, Deserialize)]
pub(crate) struct Hello {
    /// Name of the client, for the log.
    #[serde(default)]
    pub client: String,
    /// A team's token: its connections are counted.
    pub token: Option<String>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Make {
    /// A Gymnasium id; the task of the options, unless given.
    pub env: Option<String>,
    /// As in Python: task, effects, autoreset and so on.
    #[serde(default)]
    pub options: serde_json::Map<String, Value>,
    #[serde(default = "default_num_envs")]
    pub num_envs: usize,
    /// The text of a model file.
    pub model: Option<String>,
}

fn default_num_envs() -> usize {
    1
}

#[derive(Debug, Deserialize)]
pub(crate) struct Reset {
    /// Environment `i` begins with `seed + i`.
    pub seed: Option<u64>,
    pub seeds: Option<Vec<u64>>,
    pub mask: Option<Vec<bool>>,
    #[serde(default)]
    pub states: bool,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Step {
    pub action: Actions,
    #[serde(default)]
    pub states: bool,
}

/// A row per environment; a single environment may do without the outer list.
#[derive(Debug, Deserialize)]
#[serde(untagged, expecting = "a list of rows of 4 numbers, or one such row for a single environment")]
pub(crate) enum Actions {
    One([f32; ACTION]),
    Many(Vec<[f32; ACTION]>),
}

#[derive(Debug, Deserialize)]
pub(crate) struct Resume {
    pub session: String,
    pub token: String,
}

/// An attempt at a scenario of the benchmark.
#[derive(Deserialize)]
pub(crate) struct Benchmark {
    /// `name@version`, or a name alone.
    pub scenario: String,
    pub controller: String,
    /// A team's.
    pub token: String,
}

impl std::fmt::Debug for Benchmark {
    // the token is not for logs
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Benchmark({:?}, {:?})", self.scenario, self.controller)
    }
}

/// The id of a message, if it has one, and its request or error.
pub(crate) fn parse(text: &str) -> (Option<u64>, Result<Request, ProtocolError>) {
    let envelope: Envelope = match serde_json::from_str(text) {
        Ok(envelope) => envelope,
        Err(e) if e.is_data() => {
            return (None, Err(ProtocolError::new(Code::BadMessage, format!("expected a JSON object: {e}"))));
        }
        Err(e) => return (None, Err(ProtocolError::new(Code::BadJson, e.to_string()))),
    };
    let Some(id) = envelope.id.as_ref().and_then(Value::as_u64).filter(|id| *id <= MAX_ID) else {
        let got = envelope.id.map_or("nothing".into(), |id| id.to_string());
        return (
            None,
            Err(ProtocolError::new(
                Code::BadMessage,
                format!("id: expected an integer from 0 to {MAX_ID}, got {got}"),
            )),
        );
    };
    (Some(id), parse_request(envelope.kind, text))
}

fn parse_request(kind: Option<Value>, text: &str) -> Result<Request, ProtocolError> {
    let kind = match kind {
        Some(Value::String(kind)) => kind,
        other => {
            let got = other.map_or("nothing".into(), |kind| kind.to_string());
            return Err(ProtocolError::new(Code::BadMessage, format!("type: expected a string, got {got}")));
        }
    };
    let Some((_, read)) = REQUESTS.iter().find(|(known, _)| *known == kind) else {
        let known = request_kinds().collect::<Vec<_>>().join(", ");
        return Err(ProtocolError::new(Code::UnknownType, format!("unknown type {kind:?}; known: {known}")));
    };
    read(&kind, text)
}

/// Reads the fields of a request.
type ReadFields = fn(&str, &str) -> Result<Request, ProtocolError>;

/// Every request by its type. A test compares them with the table of docs/protocol.md, and another sends
/// every one of them to a server.
pub(crate) const REQUESTS: &[(&str, ReadFields)] = &[
    ("hello", |kind, text| fields(kind, text).map(Request::Hello)),
    ("make", |kind, text| fields(kind, text).map(Request::Make)),
    ("reset", |kind, text| fields(kind, text).map(Request::Reset)),
    ("step", |kind, text| fields(kind, text).map(Request::Step)),
    ("state", |kind, text| fields::<Empty>(kind, text).map(|_| Request::State)),
    ("close", |kind, text| fields::<Empty>(kind, text).map(|_| Request::Close)),
    ("resume", |kind, text| fields(kind, text).map(Request::Resume)),
    ("benchmark", |kind, text| fields(kind, text).map(Request::Benchmark)),
    ("finish", |kind, text| fields::<Empty>(kind, text).map(|_| Request::Finish)),
    ("world", |kind, text| fields(kind, text).map(Request::World)),
    ("join", |kind, text| fields(kind, text).map(Request::Join)),
    ("fly", |kind, text| fields(kind, text).map(Request::Fly)),
    ("leave", |kind, text| fields::<Empty>(kind, text).map(|_| Request::Leave)),
];

/// The types of all requests in JSON, as a server names them.
pub fn request_kinds() -> impl Iterator<Item = &'static str> {
    REQUESTS.iter().map(|(kind, _)| *kind)
}

fn fields<T: DeserializeOwned>(kind: &str, text: &str) -> Result<T, ProtocolError> {
    serde_json::from_str(text).map_err(|e| ProtocolError::new(Code::BadMessage, format!("{kind}: {e}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_of_the_protocol_has_every_request_and_no_other() {
        let page = include_str!("../../../docs/protocol.md");
        let table = page.split_once("| request | fields").expect("a table of requests").1;
        let rows = table.lines().skip(2).take_while(|line| line.starts_with('|'));
        let documented: Vec<&str> = rows.filter_map(|row| row.split('`').nth(1)).collect();
        assert_eq!(documented, request_kinds().collect::<Vec<_>>());
    }
}
