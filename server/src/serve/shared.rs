//! JSON messages about shared worlds: `docs/protocol.md` says what every field means.

use crazyflie_env::observation::{ACTION, Interface};
use serde::{Deserialize, Serialize};

use super::fault::{Code, Fault};
use super::server_message::Numbers;
use crate::worlds::Plan;

/// A world is to be founded.
#[derive(Debug, Deserialize)]
pub(crate) struct Founding {
    pub name: String,
    #[serde(flatten)]
    pub plan: Plan,
    /// So long after it began, a tick is flown without those who are late.
    #[serde(default = "second")]
    pub deadline_s: f64,
    /// So many must have joined before the first tick.
    #[serde(default = "one")]
    pub pilots: usize,
}

fn second() -> f64 {
    1.0
}

fn one() -> usize {
    1
}

impl Founding {
    /// # Errors
    /// `bad_name` and `bad_options`.
    pub(crate) fn check(&self) -> Result<(), Fault> {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if !(1..=64).contains(&self.name.len()) || !self.name.chars().all(plain) || self.name.starts_with('.') {
            let want = "1 to 64 letters, digits, and -, _ or . but not at the beginning";
            return Err(Fault::new(Code::BadName, format!("the name of a world is {want}, not {:?}", self.name)));
        }
        if !(0.001..=10.0).contains(&self.deadline_s) {
            return Err(Fault::new(Code::BadOptions, format!("deadline_s is {}, expected 0.001 to 10", self.deadline_s)));
        }
        Ok(())
    }
}

#[derive(Deserialize)]
pub(crate) struct Join {
    pub name: String,
    /// The first that is free, unless given.
    pub drone: Option<usize>,
    /// Of the seat that is taken over.
    pub token: Option<String>,
}

impl std::fmt::Debug for Join {
    // the token is not for logs
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Join({:?}, {:?})", self.name, self.drone)
    }
}

#[derive(Debug, Deserialize)]
pub(crate) struct Fly {
    action: Vec<f32>,
}

impl Fly {
    /// # Errors
    /// `wrong_length` and `bad_action`.
    pub(crate) fn action(&self) -> Result<[f32; ACTION], Fault> {
        let wrong = || Fault::new(Code::WrongLength, format!("action: expected {ACTION} numbers, got {}", self.action.len()));
        let action = self.action.as_slice().try_into().map_err(|_| wrong())?;
        match self.action.iter().enumerate().find(|(_, number)| !(-1.0..=1.0).contains(*number)) {
            Some((axis, number)) => Err(Fault::new(Code::BadAction, format!("action[{axis}] is {number}, expected a number from -1 to 1"))),
            None => Ok(action),
        }
    }
}

/// A world was founded.
#[derive(Debug, Serialize)]
pub(crate) struct Founded {
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

#[derive(Debug, Serialize)]
pub(crate) struct Joined<'a> {
    pub id: u64,
    pub world: &'a str,
    pub drone: usize,
    pub drones: usize,
    /// Takes the seat over from another connection.
    pub token: String,
    pub tick: u64,
    pub tick_s: f64,
    pub deadline_s: f64,
    pub interface: Interface,
    pub observation: Numbers<'a>,
}
