//! Responses. A client's own the data that a server's borrow.

#![allow(missing_docs, reason = "docs/protocol.md says what every field means")]

use std::borrow::Cow;

use crazyflie_env::action::Interface;
use crazyflie_env::config::Autoreset;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::error::Code;
use super::numbers::{Numbers, Rows};
use super::shared_world::{SlotInfo, TickResult, WorldInfo};

/// The last row of an episode that ended in the step.
#[derive(Debug, Serialize, Deserialize)]
pub struct FinalRow<'a> {
    pub env: usize,
    pub observation: Numbers<'a>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state: Option<Numbers<'a>>,
}

/// A response, apart from binary frames.
#[derive(Debug, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum Response<'a> {
    Welcome(ServerInfo),
    Made(Box<SessionInfo>),
    Observation {
        id: u64,
        observation: Rows<'a>,
        #[serde(skip_serializing_if = "Option::is_none")]
        state: Option<Rows<'a>>,
    },
    Result(Box<StepResult<'a>>),
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
    /// A new shared world.
    World(WorldInfo),
    Joined(Box<SlotInfo<'a>>),
    /// A tick of a shared world is over.
    Flown {
        id: u64,
        #[serde(flatten)]
        result: TickResult<'a>,
    },
    Left {
        id: u64,
    },
    Error {
        id: Option<u64>,
        code: Code,
        message: Cow<'a, str>,
        #[serde(skip_serializing_if = "Option::is_none")]
        retry_after_s: Option<u64>,
    },
}

/// Reply to `step`.
#[derive(Debug, Serialize, Deserialize)]
pub struct StepResult<'a> {
    pub id: u64,
    pub observation: Rows<'a>,
    pub reward: Numbers<'a>,
    pub terminated: Cow<'a, [bool]>,
    pub truncated: Cow<'a, [bool]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state: Option<Rows<'a>>,
    /// With same-step resets.
    #[serde(rename = "final", default, skip_serializing_if = "Vec::is_empty")]
    pub finals: Vec<FinalRow<'a>>,
    /// For tasks of several drones: the ones that fly on, and rows for each environment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flying: Option<Cow<'a, [bool]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metrics: Option<Rows<'a>>,
    /// True in an extension's answer after the last episode has ended.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub over: Option<bool>,
}

/// Reply to `hello`: the server's limits and offer.
#[derive(Debug, Serialize, Deserialize)]
pub struct ServerInfo {
    pub id: u64,
    pub protocol: Cow<'static, str>,
    pub server: String,
    pub window: usize,
    pub window_bytes: usize,
    pub max_text_bytes: usize,
    pub max_binary_bytes: usize,
    pub max_envs: usize,
    pub resume_s: f64,
    pub ping_s: f64,
    pub idle_s: f64,
    pub envs: Vec<EnvInfo>,
    /// Fields that an extension adds.
    #[serde(flatten)]
    pub extension: Map<String, Value>,
}

/// An environment that the server offers.
#[derive(Debug, Serialize, Deserialize)]
pub struct EnvInfo {
    pub env: Cow<'static, str>,
    pub task: Cow<'static, str>,
    pub max_episode_steps: u32,
    /// Default number.
    pub drones: usize,
}

/// Reply to `make`: the new session.
#[derive(Debug, Serialize, Deserialize)]
pub struct SessionInfo {
    pub id: u64,
    pub session: String,
    /// Needed to resume; nobody else has it.
    pub token: String,
    pub env: String,
    pub task: String,
    pub num_envs: usize,
    /// In each environment; rows are environment by environment, and within one drone by drone.
    pub drones: usize,
    pub observation: usize,
    pub action: usize,
    /// Numbers that each environment's metrics have; none for a task of one drone.
    pub metrics: usize,
    pub autoreset: Autoreset,
    pub max_episode_steps: u32,
    /// The most steps of one binary request.
    pub max_steps: usize,
    pub tick_s: f64,
    /// Command interface of the first drone; all have the same model.
    pub interface: Interface,
}
