//! Messages about shared worlds.

#![allow(missing_docs, reason = "docs/protocol.md says what every field means")]

use std::borrow::Cow;

use crazyflie_env::action::{ACTION, Interface};
use serde::{Deserialize, Serialize};

use super::error::{Code, ProtocolError};
use super::fields::Fields;
use super::numbers::Numbers;
use crate::worlds::WorldPlan;

/// Request for a new shared world.
#[derive(Debug, Clone, Serialize)]
pub struct WorldRequest {
    pub name: String,
    #[serde(flatten)]
    pub plan: WorldPlan,
    /// Time after which a tick is flown without the pilots that are late.
    #[serde(default = "default_deadline_s")]
    pub deadline_s: f64,
    /// Number of pilots that must have joined before the first tick.
    #[serde(default = "default_pilots")]
    pub pilots: usize,
    /// A word that whoever joins must know; everybody may join without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub invitation: Option<String>,
}

/// The fields of [`WorldRequest`] that are not of the plan.
#[derive(Deserialize)]
struct WorldTerms {
    name: String,
    #[serde(default = "default_deadline_s")]
    deadline_s: f64,
    #[serde(default = "default_pilots")]
    pilots: usize,
    #[serde(default)]
    invitation: Option<String>,
}

fn default_deadline_s() -> f64 {
    1.0
}

fn default_pilots() -> usize {
    1
}

impl WorldRequest {
    /// A world with the deadline and the one pilot that are usual.
    pub fn new(name: &str, plan: WorldPlan) -> Self {
        let (deadline_s, pilots) = (default_deadline_s(), default_pilots());
        WorldRequest { name: name.into(), plan, deadline_s, pilots, invitation: None }
    }

    /// Reads the fields of a message.
    ///
    /// # Errors
    /// `bad_message`, also for fields that it does not have.
    pub(super) fn read(fields: &Fields<'_>) -> Result<WorldRequest, ProtocolError> {
        let (terms, plan) = fields.read_both::<WorldTerms, WorldPlan>()?;
        let WorldTerms { name, deadline_s, pilots, invitation } = terms;
        Ok(WorldRequest { name, plan, deadline_s, pilots, invitation })
    }

    /// # Errors
    /// `bad_name` and `bad_options`.
    pub(crate) fn check(&self) -> Result<(), ProtocolError> {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        let name = &self.name;
        let is_plain = name.chars().all(plain) && !name.starts_with('.');
        ProtocolError::unless((1..=64).contains(&name.len()) && is_plain, Code::BadName, || {
            let want = "1 to 64 letters, digits, and -, _ or . but not at the beginning";
            format!("the name of a world is {want}, not {name:?}")
        })?;
        let is_word = |word: &String| (8..=64).contains(&word.chars().count());
        ProtocolError::unless(self.invitation.as_ref().is_none_or(is_word), Code::BadOptions, || {
            "invitation: expected 8 to 64 characters".into()
        })?;
        ProtocolError::unless((0.001..=10.0).contains(&self.deadline_s), Code::BadOptions, || {
            format!("deadline_s is {}, expected 0.001 to 10", self.deadline_s)
        })
    }
}

#[derive(Serialize, Deserialize)]
pub struct Join {
    pub name: String,
    /// The first that is free, unless given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drone: Option<usize>,
    /// Token of the slot that is taken over.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub token: Option<String>,
    /// The world's word, if it has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub invitation: Option<String>,
}

impl std::fmt::Debug for Join {
    // the token is not for logs
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Join({:?}, {:?})", self.name, self.drone)
    }
}

#[derive(Debug, Serialize, Deserialize)]
pub struct Fly {
    pub action: Numbers<'static>,
}

impl Fly {
    /// # Errors
    /// `wrong_length` and `bad_action`.
    pub(crate) fn action(&self) -> Result<[f32; ACTION], ProtocolError> {
        let wrong = |length| format!("action: expected {ACTION} numbers, got {length}");
        let action: [f32; ACTION] = (&*self.action.0)
            .try_into()
            .map_err(|_| ProtocolError::new(Code::WrongLength, wrong(self.action.0.len())))?;
        let bad = action.iter().position(|number| !(-1.0..=1.0).contains(number));
        bad.map_or(Ok(action), |axis| {
            let problem = format!("action[{axis}] is {}, expected a number from -1 to 1", action[axis]);
            Err(ProtocolError::new(Code::BadAction, problem))
        })
    }
}

/// Reply to `world`: the new shared world.
#[derive(Debug, Serialize, Deserialize)]
pub struct WorldInfo {
    pub id: u64,
    pub world: String,
    pub session: String,
    pub mission: String,
    pub drones: usize,
    /// Numbers in a drone's observation.
    pub width: usize,
    pub tick_s: f64,
    pub deadline_s: f64,
    pub pilots: usize,
    pub max_episode_steps: u32,
}

/// Reply to `join`: the drone and its first observation.
#[derive(Debug, Serialize, Deserialize)]
pub struct SlotInfo<'a> {
    pub id: u64,
    pub world: Cow<'a, str>,
    pub drone: usize,
    pub drones: usize,
    /// Lets another connection take the slot over.
    pub token: String,
    pub tick: u64,
    pub tick_s: f64,
    pub deadline_s: f64,
    pub interface: Interface,
    pub observation: Numbers<'a>,
}

/// Reply to `fly`, when the tick is over.
#[derive(Debug, Serialize, Deserialize)]
pub struct TickResult<'a> {
    /// Ticks so far.
    pub tick: u64,
    pub observation: Numbers<'a>,
    pub reward: f64,
    pub terminated: bool,
    pub truncated: bool,
    pub flying: bool,
    /// Number of ticks that were flown without this pilot's action.
    pub late: u64,
}
