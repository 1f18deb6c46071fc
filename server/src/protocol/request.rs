//! Requests.

#![allow(missing_docs, reason = "docs/protocol.md says what every field means")]

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
    World(Box<WorldRequest>),
    Join(Join),
    Fly(Fly),
    Leave,
}

/// The fields of a message that has none.
#[derive(Debug, Deserialize)]
struct Empty {}

#[derive(Debug, Serialize, Deserialize)]
pub struct Hello {
    /// Name of the client, for the log.
    #[serde(default)]
    pub client: String,
    /// Connections with the same token are counted together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub token: Option<String>,
}

#[derive(Debug, Serialize, Deserialize)]
pub struct Make {
    /// A Gymnasium id; the task of the options, unless given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub env: Option<String>,
    /// Options as in Python: task, effects, autoreset and so on.
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

impl Actions {
    /// Replaces the contents of `into` by all rows, one after the other.
    pub(crate) fn write(&self, into: &mut Vec<f32>) {
        into.clear();
        match self {
            Actions::One(row) => into.extend(row),
            Actions::Many(rows) => into.extend(rows.iter().flatten()),
        }
    }
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

/// A message to a server.
#[derive(Debug)]
pub(crate) enum Message<'a> {
    Request(Request),
    /// To an extension, which reads the fields.
    Extension(Fields<'a>),
}

/// The id of a message, if it has one, and its request or error. `more` are the types of an extension's
/// requests.
pub(crate) fn parse<'a>(
    text: &'a str,
    more: &[&'static str],
) -> (Option<u64>, Result<Message<'a>, ProtocolError>) {
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
    (Some(id), parse_request(envelope, text, more))
}

fn parse_request<'a>(
    envelope: Envelope<'a>,
    text: &'a str,
    more: &[&'static str],
) -> Result<Message<'a>, ProtocolError> {
    let kind = match envelope.kind {
        Some(Value::String(kind)) => kind,
        other => {
            let got = other.as_ref().map_or("nothing".into(), |kind| kind.to_string());
            return Err(ProtocolError::new(Code::BadMessage, format!("type: expected a string, got {got}")));
        }
    };
    let fields = Fields { kind, text, names: envelope.others };
    if let Some((_, read)) = REQUESTS.iter().find(|(known, _)| *known == fields.kind) {
        return read(&fields).map(Message::Request);
    }
    if more.contains(&fields.kind()) {
        return Ok(Message::Extension(fields));
    }
    let known = request_kinds().chain(more.iter().copied()).collect::<Vec<_>>().join(", ");
    Err(ProtocolError::new(Code::UnknownType, format!("unknown type {:?}; known: {known}", fields.kind)))
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
            let text = message.to_string();
            let (read_id, read) = parse(&text, &[]);
            assert_eq!(read_id, Some(id));
            let Ok(Message::Request(read)) = read else { panic!("{text} is read as {read:?}") };
            assert_eq!(serde_json::to_value(read).expect("an object"), sent);
        }
    }
}
