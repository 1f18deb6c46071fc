//! JSON messages: `docs/protocol.md` says what every field means.

use crazyflie_env::config::Autoreset;
use crazyflie_env::observation::{ACTION, OBSERVATION};
use serde::de::DeserializeOwned;
use serde::ser::SerializeSeq;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;

use super::fault::{Code, Fault};
use super::wire::MAX_ID;

/// What every message has. The rest is read when the type is known.
#[derive(Debug, Deserialize)]
pub(crate) struct Envelope {
    pub id: Option<Value>,
    #[serde(rename = "type")]
    pub kind: Option<Value>,
}

/// A message, apart from its id.
#[derive(Debug)]
pub(crate) enum Asked {
    Hello(Hello),
    Make(Box<Make>),
    Reset(Reset),
    Step(Step),
    State,
    Close,
    Resume(Resume),
    Benchmark(Benchmark),
    Finish,
}

/// Of a message without further fields.
#[derive(Debug, Deserialize)]
struct Empty {}

#[derive(Debug, Deserialize)]
pub(crate) struct Hello {
    /// Who is there, for the log.
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
    #[serde(default = "one")]
    pub num_envs: usize,
    /// The text of a model file.
    pub model: Option<String>,
}

fn one() -> usize {
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

/// A message's id, if it can be told, and the message or what is wrong with it.
pub(crate) fn parse(text: &str) -> (Option<u64>, Result<Asked, Fault>) {
    let envelope: Envelope = match serde_json::from_str(text) {
        Ok(envelope) => envelope,
        Err(e) if e.is_data() => return (None, Err(Fault::new(Code::BadMessage, format!("expected a JSON object: {e}")))),
        Err(e) => return (None, Err(Fault::new(Code::BadJson, e.to_string()))),
    };
    let Some(id) = envelope.id.as_ref().and_then(Value::as_u64).filter(|id| *id <= MAX_ID) else {
        let got = envelope.id.map_or("nothing".into(), |id| id.to_string());
        return (None, Err(Fault::new(Code::BadMessage, format!("id: expected an integer from 0 to {MAX_ID}, got {got}"))));
    };
    (Some(id), asked(envelope.kind, text))
}

fn asked(kind: Option<Value>, text: &str) -> Result<Asked, Fault> {
    let kind = match kind {
        Some(Value::String(kind)) => kind,
        other => {
            let got = other.map_or("nothing".into(), |kind| kind.to_string());
            return Err(Fault::new(Code::BadMessage, format!("type: expected a string, got {got}")));
        }
    };
    Ok(match &kind[..] {
        "hello" => Asked::Hello(fields(&kind, text)?),
        "make" => Asked::Make(fields(&kind, text)?),
        "reset" => Asked::Reset(fields(&kind, text)?),
        "step" => Asked::Step(fields(&kind, text)?),
        "state" => fields::<Empty>(&kind, text).map(|_| Asked::State)?,
        "close" => fields::<Empty>(&kind, text).map(|_| Asked::Close)?,
        "resume" => Asked::Resume(fields(&kind, text)?),
        "benchmark" => Asked::Benchmark(fields(&kind, text)?),
        "finish" => fields::<Empty>(&kind, text).map(|_| Asked::Finish)?,
        other => {
            let known = "hello, make, reset, step, state, close, resume, benchmark, finish";
            return Err(Fault::new(Code::UnknownType, format!("unknown type {other:?}; known: {known}")));
        }
    })
}

fn fields<T: DeserializeOwned>(kind: &str, text: &str) -> Result<T, Fault> {
    serde_json::from_str(text).map_err(|e| Fault::new(Code::BadMessage, format!("{kind}: {e}")))
}

/// Numbers of `f32` as rows; sent as the `f64` that they are, so that they come back bit for bit.
#[derive(Debug)]
pub(crate) struct Rows<'a> {
    pub numbers: &'a [f32],
    pub width: usize,
}

impl Serialize for Rows<'_> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let mut rows = to.serialize_seq(Some(self.numbers.len() / self.width))?;
        for row in self.numbers.chunks(self.width) {
            rows.serialize_element(&Numbers(row))?;
        }
        rows.end()
    }
}

#[derive(Debug)]
pub(crate) struct Numbers<'a>(pub &'a [f32]);

impl Serialize for Numbers<'_> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_seq(self.0.iter().map(|number| f64::from(*number)))
    }
}

/// The last row of an episode that ended in the step.
#[derive(Debug, Serialize)]
pub(crate) struct Final<'a> {
    pub env: usize,
    pub observation: Numbers<'a>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state: Option<Numbers<'a>>,
}

/// What is answered, apart from binary frames.
#[derive(Debug, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub(crate) enum Said<'a> {
    Welcome(Welcome),
    Made(Box<Made>),
    Observation {
        id: u64,
        observation: Rows<'a>,
        #[serde(skip_serializing_if = "Option::is_none")]
        state: Option<Rows<'a>>,
    },
    Result(Box<Outcome<'a>>),
    State {
        id: u64,
        state: Rows<'a>,
        ticks: u64,
    },
    Closed {
        id: u64,
    },
    Resumed {
        id: u64,
        session: String,
        /// The newest request that was carried out.
        last_id: Option<u64>,
        ticks: u64,
    },
    Begun(Box<Begun<'a>>),
    /// The stored row of an attempt.
    Finished {
        id: u64,
        attempt: Value,
    },
    Error {
        id: Option<u64>,
        code: Code,
        message: &'a str,
        #[serde(skip_serializing_if = "Option::is_none")]
        retry_after_s: Option<u64>,
    },
}

#[derive(Debug, Serialize)]
pub(crate) struct Outcome<'a> {
    pub id: u64,
    pub observation: Rows<'a>,
    pub reward: Numbers<'a>,
    pub terminated: &'a [bool],
    pub truncated: &'a [bool],
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state: Option<Rows<'a>>,
    /// With same-step resets.
    #[serde(rename = "final", skip_serializing_if = "Vec::is_empty")]
    pub finals: Vec<Final<'a>>,
    /// In an attempt: the last episode has ended.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub over: Option<bool>,
}

/// An attempt has begun.
#[derive(Debug, Serialize)]
pub(crate) struct Begun<'a> {
    pub id: u64,
    pub attempt: &'a str,
    pub scenario: String,
    pub scenario_hash: &'a str,
    /// Episodes, all in lock-step.
    pub num_envs: usize,
    pub tick_s: f64,
    pub interface: Command,
    pub observation: Rows<'a>,
}

#[derive(Debug, Serialize)]
pub(crate) struct Welcome {
    pub id: u64,
    pub protocol: &'static str,
    pub server: String,
    pub window: usize,
    pub window_bytes: usize,
    pub max_text_bytes: usize,
    pub max_binary_bytes: usize,
    pub max_envs: usize,
    pub resume_s: f64,
    pub ping_s: f64,
    pub idle_s: f64,
    pub envs: Vec<Known>,
}

/// An environment that can be made.
#[derive(Debug, Serialize)]
pub(crate) struct Known {
    pub env: &'static str,
    pub task: &'static str,
    pub max_episode_steps: u32,
}

#[derive(Debug, Serialize)]
pub(crate) struct Made {
    pub id: u64,
    pub session: String,
    /// Needed to resume; nobody else has it.
    pub token: String,
    pub env: String,
    pub task: String,
    pub num_envs: usize,
    pub observation: usize,
    pub action: usize,
    pub autoreset: Autoreset,
    pub max_episode_steps: u32,
    /// The most steps that one binary request may ask for.
    pub max_steps: usize,
    pub tick_s: f64,
    pub interface: Command,
}

/// What an action means.
#[derive(Debug, Serialize)]
pub(crate) struct Command {
    pub vertical: crazyflie_env::model::VerticalInput,
    pub tilt_max_rad: f64,
    pub yaw_rate_max_radps: f64,
    pub lift_max: f64,
    pub hover_lift: f64,
    pub yaw_sign: f64,
}

impl From<crazyflie_env::observation::Interface> for Command {
    fn from(i: crazyflie_env::observation::Interface) -> Self {
        let (tilt_max_rad, yaw_rate_max_radps) = (i.tilt_max_rad, i.yaw_rate_max_radps);
        Command {
            vertical: i.input,
            tilt_max_rad,
            yaw_rate_max_radps,
            lift_max: i.lift_max,
            hover_lift: i.hover_lift,
            yaw_sign: i.yaw_sign,
        }
    }
}

/// Observation rows.
pub(crate) fn observations(numbers: &[f32]) -> Rows<'_> {
    Rows { numbers, width: OBSERVATION }
}
