//! The dialect of `openenv-core` on `/ws` without a subprotocol: `{"type": "reset" | "step" | "state" | "close", "data"}`. One environment per
//! connection; a step after the end of an episode is an error until the next reset.

use std::sync::Arc;

use crazyflie_env::observation::{ACTION, FIELDS};
use crazyflie_env::vector::STATE;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use tokio_tungstenite::tungstenite::Message;
use tokio_util::sync::CancellationToken;

use super::fault::{Code, Fault};
use super::listed::End;
use super::make;
use super::message::Make;
use super::server::Server;
use super::session::Session;
use super::socket::{Incoming, Parting, Socket};

#[derive(Debug, Deserialize)]
struct Request {
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
    /// As in `make`.
    options: Option<Map<String, Value>>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Step {
    action: [f32; ACTION],
}

/// OpenEnv's codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub(crate) enum Failing {
    InvalidJson,
    UnknownType,
    ValidationError,
    ExecutionError,
    CapacityReached,
}

pub(crate) type Failed = (Failing, String);

/// A message.
#[derive(Debug)]
pub(crate) enum Asked {
    Reset(Reset),
    Step(Step),
    State,
    Close,
}

/// # Errors
/// What is not a message, with OpenEnv's code.
pub(crate) fn parse(text: &str) -> Result<Asked, Failed> {
    let request: Request = serde_json::from_str(text).map_err(|e| match e.is_data() {
        true => (Failing::ValidationError, format!("expected an object: {e}")),
        false => (Failing::InvalidJson, format!("Invalid JSON: {e}")),
    })?;
    match request.kind.as_str() {
        Some("reset") => fields("reset", request.data).map(Asked::Reset),
        Some("step") => fields("step", request.data).map(Asked::Step),
        Some("state") => Ok(Asked::State),
        Some("close") => Ok(Asked::Close),
        _ => Err((Failing::UnknownType, format!("Unknown message type: {}", request.kind))),
    }
}

struct Talk {
    server: Arc<Server>,
    leave: CancellationToken,
    session: Option<Session>,
    episode: String,
    steps: u64,
}

pub(crate) async fn talk(server: Arc<Server>, mut socket: Socket, leave: CancellationToken) {
    let (episode, steps) = (String::new(), 0);
    let mut talk = Talk { server: server.clone(), leave, session: None, episode, steps };
    let parting = loop {
        let answer = match socket.next().await {
            Ok(Incoming::Text(text)) => talk.answer(&text),
            Ok(Incoming::Binary(_)) => Some(Err((Failing::ValidationError, "expected text, got a binary message".into()))),
            Err(parting) => break parting,
        };
        server.metrics.requests.inc();
        let Some(answer) = answer else { break Parting::Closed(None) };
        let text = answer.unwrap_or_else(|(code, message)| {
            server.metrics.faults.inc();
            json!({"type": "error", "data": {"message": message, "code": code}})
        });
        if let Err(parting) = socket.send(Message::text(text.to_string())).await {
            break parting;
        }
    };
    if let Some(session) = talk.session.take() {
        session.finish(if server.stop.is_cancelled() { End::Stopped } else { End::Closed });
    }
    socket.goodbye(&parting, &server).await;
}

impl Talk {
    /// `None` for goodbye.
    fn answer(&mut self, text: &str) -> Option<Result<Value, Failed>> {
        match parse(text) {
            Ok(Asked::Reset(reset)) => Some(self.reset(reset)),
            Ok(Asked::Step(step)) => Some(self.step(&step)),
            Ok(Asked::State) => Some(self.state()),
            Ok(Asked::Close) => None,
            Err(failed) => Some(Err(failed)),
        }
    }

    fn reset(&mut self, reset: Reset) -> Result<Value, Failed> {
        if self.session.is_none() || reset.env.is_some() || reset.options.is_some() {
            let mut options = reset.options.unwrap_or_default();
            options.insert("autoreset".into(), "disabled".into());
            let make = Make { env: reset.env, options, num_envs: 1, model: None };
            let (session, made) = make::make(&self.server, 0, &make).map_err(failed)?;
            if made.metrics > 0 {
                let problem = format!("OpenEnv flies one drone, and the task {} has {}", made.task, made.drones);
                return Err((Failing::ValidationError, problem));
            }
            session.listed().hold(&self.leave);
            if let Some(before) = self.session.replace(session) {
                before.finish(End::Closed);
            }
        }
        let session = self.session.as_mut().ok_or_else(not_reset)?;
        let seeds = reset.seed.map(|seed| [seed]);
        let frame = session.begin(seeds.as_ref().map(<[u64; 1]>::as_slice), None, false).map_err(failed)?;
        self.episode = reset.episode_id.unwrap_or_else(|| format!("{}-{}", session.listed().name(), session.ticks()));
        self.steps = 0;
        Ok(observation(frame.numbers(), None, [false, false]))
    }

    fn step(&mut self, step: &Step) -> Result<Value, Failed> {
        let session = self.session.as_mut().ok_or_else(not_reset)?;
        let (frame, ends) = session.act(&step.action).map_err(failed)?;
        self.steps += 1;
        let (row, reward) = frame.numbers().split_at(FIELDS.iter().map(|field| field.length).sum());
        Ok(observation(row, reward.first().copied(), ends))
    }

    fn state(&mut self) -> Result<Value, Failed> {
        let mut state = [0.0; STATE];
        self.session.as_ref().ok_or_else(not_reset)?.states(&mut state).map_err(failed)?;
        let state = state.map(f64::from);
        Ok(json!({"type": "state", "data": {"episode_id": self.episode, "step_count": self.steps, "true_state": state}}))
    }
}

fn fields<T: serde::de::DeserializeOwned>(kind: &str, data: Value) -> Result<T, Failed> {
    // the stock client sends no data with some messages
    let data = if data.is_null() { json!({}) } else { data };
    serde_json::from_value(data).map_err(|e| (Failing::ValidationError, format!("{kind}: {e}")))
}

fn not_reset() -> Failed {
    (Failing::ExecutionError, "call reset before step and state".into())
}

fn failed(fault: Fault) -> Failed {
    let code = match fault.code {
        Code::TooMany => Failing::CapacityReached,
        Code::BadOptions | Code::BadModel | Code::BadAction => Failing::ValidationError,
        _ => Failing::ExecutionError,
    };
    (code, fault.message)
}

/// An observation by the names of its fields, with what else a step tells.
fn observation(row: &[f32], reward: Option<f32>, [terminated, truncated]: [bool; 2]) -> Value {
    let numbers = |first: usize, length: usize| row[first..first + length].iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
    let mut fields: Map<String, Value> =
        FIELDS.iter().map(|field| (field.name.to_owned(), numbers(field.first, field.length).into())).collect();
    fields.insert("terminated".into(), terminated.into());
    fields.insert("truncated".into(), truncated.into());
    let done = terminated | truncated;
    json!({"type": "observation", "data": {"observation": fields, "reward": reward.map(f64::from), "done": done}})
}
