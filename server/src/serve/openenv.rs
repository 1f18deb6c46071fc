//! The dialect of `openenv` on `/ws` without a subprotocol: `{"type": "reset" | "step" | "state" |
//! "close", "data"}`. One environment per connection; a step after the end of an episode is an error until
//! the next reset. Its clients and its validator also read `/health`, `/metadata` and `/schema`.

use std::convert::Infallible;
use std::sync::Arc;

use axum::Json;
use axum::response::{IntoResponse, Response};
use crazyflie_env::action::ACTION;
use crazyflie_env::observation::Field;
use crazyflie_env::vector::STATE;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use tokio_tungstenite::tungstenite::Message;
use tokio_util::sync::CancellationToken;

use super::answers::bad_request;
use super::create_session;
use super::metrics::SessionEnd;
use super::server::{Peer, Server};
use super::session::Session;
use super::socket::{Disconnect, Incoming, Socket};
use super::turns::Turn;
use crate::protocol::fields::plain_words;
use crate::protocol::{Code, Make, ProtocolError};

/// A message whose fields are not read yet.
#[derive(Debug, Deserialize)]
#[serde(rename = "Request")]
struct RawRequest {
    #[serde(rename = "type", default)]
    kind: Value,
    #[serde(default)]
    data: Value,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Reset {
    seed: Option<u64>,
    episode_id: Option<String>,
    /// A Gymnasium id; another environment from now on.
    env: Option<String>,
    /// Options as in `make`.
    options: Option<Map<String, Value>>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Step {
    action: [f32; ACTION],
}

/// OpenEnv's codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub(crate) enum OpenEnvCode {
    InvalidJson,
    UnknownType,
    ValidationError,
    ExecutionError,
    CapacityReached,
}

pub(crate) type OpenEnvError = (OpenEnvCode, String);

/// A request in the dialect of OpenEnv.
#[derive(Debug)]
pub(crate) enum OpenEnvRequest {
    Reset(Reset),
    Step(Step),
    State,
    Close,
}

/// # Errors
/// Text that is no message, with OpenEnv's code.
pub(crate) fn parse(text: &str) -> Result<OpenEnvRequest, OpenEnvError> {
    let request: RawRequest = serde_json::from_str(text).map_err(|e| match e.is_data() {
        true => {
            (OpenEnvCode::ValidationError, format!("expected an object: {}", plain_words(&e.to_string())))
        }
        false => (OpenEnvCode::InvalidJson, format!("Invalid JSON: {e}")),
    })?;
    match request.kind.as_str() {
        Some("reset") => fields("reset", request.data).map(OpenEnvRequest::Reset),
        Some("step") => fields("step", request.data).map(OpenEnvRequest::Step),
        Some("state") => Ok(OpenEnvRequest::State),
        Some("close") => Ok(OpenEnvRequest::Close),
        _ => Err((OpenEnvCode::UnknownType, format!("Unknown message type: {}", request.kind))),
    }
}

/// A connection in this dialect and the session that it drives.
struct OpenEnvSession {
    server: Arc<Server>,
    peer: Arc<Peer>,
    leave: CancellationToken,
    session: Option<Session>,
    /// Fields of an observation.
    fields: Vec<Field>,
    episode: String,
    steps: u64,
}

/// # Errors
/// The way in which the connection ends.
pub(crate) async fn serve_socket(
    peer: Arc<Peer>,
    socket: &mut Socket,
    leave: CancellationToken,
) -> Result<Infallible, Disconnect> {
    let (server, episode, steps, fields) = (peer.server.clone(), String::new(), 0, Vec::new());
    let mut connection =
        OpenEnvSession { server: server.clone(), peer, leave, session: None, fields, episode, steps };
    let ended = connection.answer_all(socket).await;
    if let Some(session) = connection.session.take() {
        session.finish(if server.stop.is_cancelled() { SessionEnd::Stopped } else { SessionEnd::Closed });
    }
    ended
}

impl OpenEnvSession {
    async fn answer_all(&mut self, socket: &mut Socket) -> Result<Infallible, Disconnect> {
        loop {
            let answer = match socket.next().await? {
                Incoming::Text(text) => self.answer(&text).await,
                Incoming::Binary(_) => {
                    Some(Err((OpenEnvCode::ValidationError, "expected text, got a binary message".into())))
                }
            };
            self.server.metrics.requests.inc();
            let answer = answer.ok_or(Disconnect::Closed(None))?;
            let text = answer.unwrap_or_else(|(code, message)| {
                self.server.metrics.faults.inc();
                json!({"type": "error", "data": {"message": message, "code": code}})
            });
            socket.send(Message::text(text.to_string())).await?;
        }
    }

    /// The answer to a message; `None` if it closes the session.
    async fn answer(&mut self, text: &str) -> Option<Result<Value, OpenEnvError>> {
        let peer = self.peer.clone();
        let mut turn = peer.queue.turn(false).await;
        match parse(text) {
            Ok(OpenEnvRequest::Reset(reset)) => Some(self.reset(reset)),
            Ok(OpenEnvRequest::Step(step)) => Some(self.step(&step, &mut turn).await),
            Ok(OpenEnvRequest::State) => Some(self.state()),
            Ok(OpenEnvRequest::Close) => None,
            Err(error) => Some(Err(error)),
        }
    }

    fn reset(&mut self, reset: Reset) -> Result<Value, OpenEnvError> {
        if self.session.is_none() || reset.env.is_some() || reset.options.is_some() {
            let mut options = reset.options.unwrap_or_default();
            options.insert("autoreset".into(), "disabled".into());
            let make = Make { env: reset.env, options, num_envs: 1, model: None };
            let (session, info) = create_session::create_session(&self.server, self.peer.payer(), 0, &make)
                .map_err(openenv_error)?;
            let (options, _) = create_session::options(&make).map_err(openenv_error)?;
            self.fields = options.observation.fields().map_err(|e| openenv_error(e.into()))?;
            if info.metrics > 0 {
                let problem =
                    format!("OpenEnv flies one drone, and the task {} has {}", info.task, info.drones);
                return Err((OpenEnvCode::ValidationError, problem));
            }
            session.slot.entry.hold(&self.leave);
            if let Some(before) = self.session.replace(session) {
                before.finish(SessionEnd::Closed);
            }
        }
        let session = self.session.as_mut().ok_or_else(not_reset)?;
        let seeds = reset.seed.map(|seed| [seed]);
        let frame =
            session.begin(seeds.as_ref().map(<[u64; 1]>::as_slice), None, false).map_err(openenv_error)?;
        self.episode =
            reset.episode_id.unwrap_or_else(|| format!("{}-{}", session.slot.entry.name(), session.ticks()));
        self.steps = 0;
        Ok(observation(&self.fields, frame.numbers(), None, [false, false]))
    }

    async fn step(&mut self, step: &Step, turn: &mut Turn<'_>) -> Result<Value, OpenEnvError> {
        let session = self.session.as_mut().ok_or_else(not_reset)?;
        let (frame, ends) = session.act(&step.action, turn).await.map_err(openenv_error)?;
        self.steps += 1;
        let (row, reward) = frame.numbers().split_at(session.layout.width);
        Ok(observation(&self.fields, row, reward.first().copied(), ends))
    }

    fn state(&mut self) -> Result<Value, OpenEnvError> {
        let mut state = [0.0; STATE];
        self.session.as_ref().ok_or_else(not_reset)?.states(&mut state).map_err(openenv_error)?;
        let state = state.map(f64::from);
        Ok(
            json!({"type": "state", "data": {"episode_id": self.episode, "step_count": self.steps, "true_state": state}}),
        )
    }
}

fn fields<T: serde::de::DeserializeOwned>(kind: &str, data: Value) -> Result<T, OpenEnvError> {
    // the stock client sends no data with some messages
    let data = if data.is_null() { json!({}) } else { data };
    serde_json::from_value(data)
        .map_err(|e| (OpenEnvCode::ValidationError, format!("{kind}: {}", plain_words(&e.to_string()))))
}

fn not_reset() -> OpenEnvError {
    (OpenEnvCode::ExecutionError, "call reset before step and state".into())
}

fn openenv_error(error: ProtocolError) -> OpenEnvError {
    let code = match error.code {
        Code::TooMany => OpenEnvCode::CapacityReached,
        Code::BadOptions | Code::BadModel | Code::BadAction => OpenEnvCode::ValidationError,
        _ => OpenEnvCode::ExecutionError,
    };
    (code, error.message)
}

/// Ready: who starts a server in a container waits for this.
pub(crate) async fn health() -> Response {
    Json(json!({"status": "healthy"})).into_response()
}

/// The environment, in words.
pub(crate) async fn metadata() -> Response {
    let description = "A Crazyflie quadrotor, hovering over a marker unless `env` of reset says otherwise";
    let (name, version) = ("crazyflie", env!("CARGO_PKG_VERSION"));
    Json(json!({"name": name, "description": description, "version": version})).into_response()
}

/// JSON schemas of the environment without options.
pub(crate) async fn schema() -> Response {
    match default_fields() {
        Ok(fields) => Json(schemas(&fields)).into_response(),
        Err(error) => bad_request(&error.message),
    }
}

fn default_fields() -> Result<Vec<Field>, ProtocolError> {
    let make = Make { env: None, options: Map::new(), num_envs: 1, model: None };
    Ok(create_session::options(&make)?.0.observation.fields()?)
}

fn schemas(fields: &[Field]) -> Value {
    let numbers = |count: usize, item: Value| json!({"type": "array", "items": item, "minItems": count, "maxItems": count});
    let (number, flag) = (json!({"type": "number"}), json!({"type": "boolean"}));
    let object = |properties: Value| {
        let required: Vec<&String> = properties.as_object().into_iter().flat_map(Map::keys).collect();
        json!({"type": "object", "required": required, "properties": properties})
    };
    let mut observed =
        json!({"terminated": flag, "truncated": flag, "done": flag, "reward": {"type": ["number", "null"]}});
    for field in fields {
        observed[field.name] = numbers(field.length, number.clone());
    }
    let action = json!({"action": numbers(ACTION, json!({"type": "number", "minimum": -1, "maximum": 1}))});
    let state = json!({"episode_id": {"type": "string"}, "step_count": {"type": "integer", "minimum": 0},
        "true_state": numbers(STATE, number)});
    json!({"action": object(action), "observation": object(observed), "state": object(state)})
}

/// Returns an observation by the names of its fields, with reward and flags. With several ticks a field is a list of
/// them, the newest last.
fn observation(
    layout: &[Field],
    row: &[f32],
    reward: Option<f32>,
    [terminated, truncated]: [bool; 2],
) -> Value {
    let width: usize = layout.iter().map(|field| field.length).sum();
    let ticks = |field: &Field| {
        let tick = |row: &[f32]| row[field.range()].iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
        if row.len() == width {
            return tick(row).into();
        }
        row.chunks_exact(width).map(tick).collect::<Vec<_>>().into()
    };
    let mut fields: Map<String, Value> =
        layout.iter().map(|field| (field.name.to_owned(), ticks(field))).collect();
    fields.insert("terminated".into(), terminated.into());
    fields.insert("truncated".into(), truncated.into());
    let done = terminated | truncated;
    json!({"type": "observation", "data": {"observation": fields, "reward": reward.map(f64::from), "done": done}})
}
