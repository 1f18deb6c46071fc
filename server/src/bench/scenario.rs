//! Scenarios: data files under `server/scenarios`, embedded, checked, and known by the hash of all that they say.

use std::borrow::Cow;

use crazyflie_env::config::{Autoreset, EffectTable, Options, check_effects};
use crazyflie_env::control::pid::Mode;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::vector::VectorEnv;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::error::{Error, Result};
use super::mystery::{Hidden, Pool};
use super::score::Cost;
use super::secrets::{Secrets, canonical, sha256_hex};
use crate::flight::Phase;

macro_rules! files {
    ($($file:literal),* $(,)?) => {
        const FILES: &[(&str, &str)] = &[$(($file, include_str!(concat!("../../scenarios/", $file)))),*];
    };
}
files![
    "hover-aruco.toml",
    "fly-80cm.toml",
    "takeoff.toml",
    "steps.toml",
    "figure-eight.toml",
    "ground-landing.toml",
    "wind.toml",
    "battery-low.toml",
    "packet-loss.toml",
    "mystery.toml",
];

/// The fewest episodes from which an attempt may be judged.
const EPISODES_MIN: usize = 20;

/// A scenario file.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Plan {
    pub name: String,
    pub version: String,
    pub title: String,
    pub description: String,
    /// Section and figure of the thesis, or where else it comes from.
    pub source: String,
    pub episodes: usize,
    pub seconds: f64,
    pub vertical: VerticalInput,
    pub task: String,
    #[serde(default)]
    pub task_options: Value,
    #[serde(default)]
    pub effects: EffectTable,
    pub phases: Vec<PlannedPhase>,
    pub cost: Cost,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hidden: Option<Pool>,
}

/// A part of the flight with one set-point; `mode` is what the thesis's controller is told to do.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlannedPhase {
    pub name: String,
    pub from_s: f64,
    pub mode: String,
}

/// A scenario as this server runs it.
#[derive(Debug, Clone)]
pub(crate) struct Scenario {
    pub(super) plan: Plan,
    pub(super) phases: Vec<Phase>,
    hidden: Option<Hidden>,
    hash: String,
}

/// Every scenario, with what this server's secret decides.
pub(super) fn all(secrets: &Secrets) -> Result<Vec<Scenario>> {
    FILES.iter().map(|(file, text)| Scenario::read(file, text, secrets)).collect()
}

impl Scenario {
    fn read(file: &'static str, text: &str, secrets: &Secrets) -> Result<Scenario> {
        let bad = |problem: String| Error::ScenarioFile { file, problem };
        let plan: Plan = toml::from_str(text).map_err(|e| bad(e.to_string()))?;
        check(&plan).map_err(bad)?;
        let phase = |p: &PlannedPhase| {
            let mode = Mode::named(&p.mode).map_err(|e| bad(e.to_string()))?;
            Ok(Phase { name: Cow::Owned(p.name.clone()), from_s: p.from_s, setpoint_m: None, mode })
        };
        let phases = plan.phases.iter().map(phase).collect::<Result<Vec<_>>>()?;
        let public = content_hash(&plan, None)?;
        let hidden = plan.hidden.as_ref().map(|pool| pool.draw(secrets, &public)).transpose()?;
        let hash = content_hash(&plan, hidden.as_ref().map(|h| h.commitment.as_str()))?;
        let scenario = Scenario { plan, phases, hidden, hash };
        scenario.env(1).map_err(|e| bad(e.to_string()))?;
        Ok(scenario)
    }

    /// `name@version`.
    pub(crate) fn id(&self) -> String {
        format!("{}@{}", self.plan.name, self.plan.version)
    }

    pub(crate) fn hash(&self) -> &str {
        &self.hash
    }

    pub(crate) fn title(&self) -> &str {
        &self.plan.title
    }

    pub(crate) fn episodes(&self) -> usize {
        self.plan.episodes
    }

    pub(crate) fn seconds(&self) -> f64 {
        self.plan.seconds
    }

    /// The environments of an attempt. They reset on their own, because in lock-step those that have ended are stepped along; nothing after
    /// an end is shown or counted.
    pub(super) fn env(&self, envs: usize) -> Result<VectorEnv> {
        let mut effects = self.plan.effects.clone();
        effects.extend(self.hidden.iter().flat_map(|hidden| hidden.effects.clone()));
        let options = Options {
            task: self.plan.task.clone(),
            task_options: self.plan.task_options.clone(),
            vertical: Some(self.plan.vertical),
            effects,
            autoreset: Autoreset::NextStep,
            ..Options::default()
        };
        Ok(VectorEnv::new(&Model::thesis(), &options, envs)?)
    }

    pub(super) fn lands(&self) -> bool {
        self.phases.last().is_some_and(|phase| phase.mode == Mode::Landing)
    }

    /// One parameter of a declared effect, if it is the same in every episode.
    pub(super) fn declared(&self, effect: &str, param: &str) -> Option<f64> {
        let crazyflie_env::config::EffectParams::Named(params) = self.plan.effects.get(effect)? else { return None };
        params.get(param)?.fixed()
    }

    /// What anyone may know.
    pub(crate) fn public(&self) -> Value {
        let p = &self.plan;
        json!({
            "id": self.id(), "name": p.name, "version": p.version, "hash": self.hash, "title": p.title, "description": p.description,
            "source": p.source, "episodes": p.episodes, "seconds": p.seconds, "vertical": p.vertical, "task": p.task,
            "task_options": p.task_options, "effects": p.effects, "phases": p.phases, "cost": p.cost,
            "commitment": self.hidden.as_ref().map(|h| &h.commitment),
        })
    }
}

/// SHA-256 over the canonical JSON of the file's content, of the model's numbers, and of the commitment to what is hidden.
fn content_hash(plan: &Plan, commitment: Option<&str>) -> Result<String> {
    let model = sha256_hex(&canonical(&Model::thesis().parameters())?);
    Ok(sha256_hex(&canonical(&json!({"scenario": plan, "model": model, "commitment": commitment}))?))
}

fn check(plan: &Plan) -> std::result::Result<(), String> {
    if plan.episodes < EPISODES_MIN {
        return Err(format!("{} episodes, expected at least {EPISODES_MIN}", plan.episodes));
    }
    if !(1.0..=120.0).contains(&plan.seconds) {
        return Err(format!("{} seconds, expected 1 to 120", plan.seconds));
    }
    let in_order = plan.phases.is_sorted_by(|a, b| a.from_s < b.from_s);
    if plan.phases.first().is_none_or(|first| first.from_s != 0.0) || !in_order {
        return Err("the phases must begin at 0 s and come in order".into());
    }
    plan.cost.check()?;
    check_effects(&plan.effects).map_err(|e| e.to_string())
}
