//! Requests.

#![allow(
    missing_docs,
    reason = "docs/protocol.md says what every field means, in one place for every language"
)]

use crazyflie_env::action::ACTION;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;

use super::MAX_ID;
use super::error::{Code, ProtocolError};
use super::fields::{Envelope, Fields, plain_words};
use super::numbers::Numbers;
use super::shared_world::{Fly, Join, WorldRequest};

/// A request, apart from its id.
#[derive(Debug, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum Request {
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

#[derive(Debug, Serialize, Deserialize)]
pub struct Hello {
    /// Name of the client, for the log.
    #[serde(default)]
    pub client: String,
    /// A team's token: its connections are counted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub token: Option<String>,
}

#[derive(Debug, Serialize, Deserialize)]
pub struct Make {
    /// A Gymnasium id; the task of the options, unless given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub env: Option<String>,
    /// As in Python: task, effects, autoreset and so on.
    #[serde(default)]
    pub options: serde_json::Map<String, Value>,
    #[serde(default = "default_num_envs")]
    pub num_envs: usize,
    /// The text of a model file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
}

fn default_num_envs() -> usize {
    1
}

#[derive(Debug, Serialize, Deserialize)]
pub struct Reset {
    /// Environment `i` begins with `seed + i`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seeds: Option<Vec<u64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mask: Option<Vec<bool>>,
    #[serde(default)]
    pub states: bool,
}

#[derive(Debug, Serialize, Deserialize)]
pub struct Step {
    pub action: Actions,
    #[serde(default)]
    pub states: bool,
}

/// A row per environment; a single environment may do without the outer list.
#[derive(Debug, Deserialize)]
#[serde(untagged, expecting = "a list of rows of 4 numbers, or one such row for a single environment")]
pub enum Actions {
    One([f32; ACTION]),
    Many(Vec<[f32; ACTION]>),
}

impl Serialize for Actions {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match self {
            Actions::One(row) => Numbers(row[..].into()).serialize(to),
            Actions::Many(rows) => to.collect_seq(rows.iter().map(|row| Numbers(row[..].into()))),
        }
    }
}

#[derive(Debug, Serialize, Deserialize)]
pub struct Resume {
    pub session: String,
    pub token: String,
}

/// An attempt at a scenario of the benchmark.
#[derive(Serialize, Deserialize)]
pub struct Benchmark {
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
    let envelope: Envelope<'_> = match serde_json::from_str(text) {
        Ok(envelope) => envelope,
        Err(e) if e.is_data() => {
            let problem = format!("expected a JSON object: {}", plain_words(&e.to_string()));
            return (None, Err(ProtocolError::new(Code::BadMessage, problem)));
        }
        Err(e) => return (None, Err(ProtocolError::new(Code::BadJson, e.to_string()))),
    };
    let Some(id) = envelope.id.as_ref().and_then(Value::as_u64).filter(|id| *id <= MAX_ID) else {
        let got = envelope.id.as_ref().map_or("nothing".into(), |id| id.to_string());
        return (
            None,
            Err(ProtocolError::new(
                Code::BadMessage,
                format!("id: expected an integer from 0 to {MAX_ID}, got {got}"),
            )),
        );
    };
    (Some(id), parse_request(&envelope, text))
}

fn parse_request(envelope: &Envelope<'_>, text: &str) -> Result<Request, ProtocolError> {
    let kind = match &envelope.kind {
        Some(Value::String(kind)) => kind,
        other => {
            let got = other.as_ref().map_or("nothing".into(), |kind| kind.to_string());
            return Err(ProtocolError::new(Code::BadMessage, format!("type: expected a string, got {got}")));
        }
    };
    let Some((_, read)) = REQUESTS.iter().find(|(known, _)| known == kind) else {
        let known = request_kinds().collect::<Vec<_>>().join(", ");
        return Err(ProtocolError::new(Code::UnknownType, format!("unknown type {kind:?}; known: {known}")));
    };
    read(&Fields::new(kind, text, envelope))
}

/// Reads the fields of a request.
type ReadFields = fn(&Fields<'_>) -> Result<Request, ProtocolError>;

/// Every request by its type. A test compares them with the table of docs/protocol.md, and another sends
/// every one of them to a server.
pub(crate) const REQUESTS: &[(&str, ReadFields)] = &[
    ("hello", |fields| fields.read().map(Request::Hello)),
    ("make", |fields| fields.read().map(Request::Make)),
    ("reset", |fields| fields.read().map(Request::Reset)),
    ("step", |fields| fields.read().map(Request::Step)),
    ("state", |fields| fields.read::<Empty>().map(|_| Request::State)),
    ("close", |fields| fields.read::<Empty>().map(|_| Request::Close)),
    ("resume", |fields| fields.read().map(Request::Resume)),
    ("benchmark", |fields| fields.read().map(Request::Benchmark)),
    ("finish", |fields| fields.read::<Empty>().map(|_| Request::Finish)),
    ("world", |fields| WorldRequest::read(fields).map(|request| Request::World(Box::new(request)))),
    ("join", |fields| fields.read().map(Request::Join)),
    ("fly", |fields| fields.read().map(Request::Fly)),
    ("leave", |fields| fields.read::<Empty>().map(|_| Request::Leave)),
];

/// The types of all requests in JSON, as a server names them.
pub fn request_kinds() -> impl Iterator<Item = &'static str> {
    REQUESTS.iter().map(|(kind, _)| *kind)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde_json::json;

    use super::*;
    use crate::worlds::WorldPlan;

    #[test]
    fn the_page_of_the_protocol_has_every_request_and_no_other() {
        let page = include_str!("../../../docs/protocol.md");
        let table = page.split_once("| request | fields").expect("a table of requests").1;
        let rows = table.lines().skip(2).take_while(|line| line.starts_with('|'));
        let documented: Vec<&str> = rows.filter_map(|row| row.split('`').nth(1)).collect();
        assert_eq!(documented, request_kinds().collect::<Vec<_>>());
    }

    /// A request of each kind that has fields, with every field that is optional.
    fn examples() -> Vec<Request> {
        let text = || Some("text".to_owned());
        let action = [0.1, -1.0, f32::MIN_POSITIVE, 1.0 / 3.0];
        let options = serde_json::Map::from_iter([("drones".to_owned(), 3.into())]);
        let plan = WorldPlan { options: options.clone(), model: text(), ..WorldPlan::new("swap") };
        vec![
            Request::Hello(Hello { client: "test".into(), token: text() }),
            Request::Make(Box::new(Make { env: text(), options, num_envs: 2, model: text() })),
            Request::Reset(Reset {
                seed: Some(1),
                seeds: Some(vec![2]),
                mask: Some(vec![true]),
                states: true,
            }),
            Request::Step(Step { action: Actions::Many(vec![action; 2]), states: true }),
            Request::Resume(Resume { session: "1".into(), token: "2".into() }),
            Request::Benchmark(Benchmark {
                scenario: "hover".into(),
                controller: "c".into(),
                token: "t".into(),
            }),
            Request::World(Box::new(WorldRequest::new("room", plan))),
            Request::Join(Join { name: "room".into(), drone: Some(1), token: text(), invitation: text() }),
            Request::Fly(Fly { action: Numbers(action.to_vec().into()) }),
        ]
    }

    #[test]
    fn a_server_reads_every_request_as_the_client_wrote_it() {
        let mut messages: BTreeMap<String, Value> =
            request_kinds().map(|kind| (kind.to_owned(), json!({"type": kind}))).collect();
        for request in examples() {
            let message = serde_json::to_value(&request).expect("a request is an object");
            let kind = message["type"].as_str().expect("a type").to_owned();
            assert!(messages.insert(kind, message).is_some(), "{request:?} is not in REQUESTS");
        }
        for (id, mut message) in (0..).zip(messages.into_values()) {
            let sent = message.clone();
            message["id"] = id.into();
            let (read_id, read) = parse(&message.to_string());
            assert_eq!(read_id, Some(id));
            assert_eq!(serde_json::to_value(read.expect("a request")).expect("an object"), sent);
        }
    }
}
