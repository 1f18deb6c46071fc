//! Worlds that several pilots share: the plan of a world, its flight, and the log that the flight can be
//! replayed from.

mod drone_figures;
mod flight;
mod log;
#[cfg(test)]
mod one_tick;

use crazyflie_env::config::{Autoreset, Options};
use crazyflie_env::error::{Error, Result};
use crazyflie_env::model::Model;
use crazyflie_env::task;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

pub(crate) use drone_figures::{DroneEnd, WorldFigures};
pub(crate) use flight::WorldFlight;
pub(crate) use log::ActionSource;
pub use log::{WorldLog, WorldReplay, WorldSummary, replay_log};

/// Plan of a world: all that its flight depends on, besides the actions of its pilots.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "docs/protocol.md says what every field means")]
pub struct WorldPlan {
    pub mission: String,
    /// See [`Options`].
    #[serde(default)]
    pub options: Map<String, Value>,
    #[serde(default)]
    pub seed: u64,
    /// A controller of the registry; it flies the drones that have no pilot, and keeps them apart.
    #[serde(default = "thesis_pid")]
    pub autopilot: String,
    /// The text of a model file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
}

fn thesis_pid() -> String {
    "thesis-pid".into()
}

impl WorldPlan {
    /// The mission as it is, with the thesis's controller for the drones without a pilot.
    pub fn new(mission: &str) -> Self {
        let options = Map::new();
        WorldPlan { mission: mission.into(), options, seed: 0, autopilot: thesis_pid(), model: None }
    }

    /// The options in full: one episode of the mission, on one thread.
    ///
    /// # Errors
    /// [`Error::Config`], [`Error::Unknown`] and [`Error::Range`].
    pub(crate) fn options(&self) -> Result<Options> {
        let (entry, mut map) = (task::find(&self.mission)?, self.options.clone());
        for fixed in ["task", "autoreset", "threads", "observation", "history"] {
            if map.contains_key(fixed) {
                return Err(Error::Config(format!("options: {fixed} is not to be chosen in a shared world")));
            }
        }
        map.insert("task".into(), entry.name.into());
        map.entry("max_episode_steps").or_insert_with(|| entry.max_episode_steps.into());
        let mut options = Options::parse(&Value::Object(map).to_string())?;
        if options.max_episode_steps == 0 {
            return Err(Error::Range {
                name: "max_episode_steps".into(),
                value: 0.0,
                want: "at least 1: a shared world has an end".into(),
            });
        }
        options.autoreset = Autoreset::Disabled;
        Ok(options)
    }

    fn model(&self) -> Result<Model> {
        self.model.as_deref().map_or_else(|| Ok(Model::thesis()), Model::parse)
    }
}
