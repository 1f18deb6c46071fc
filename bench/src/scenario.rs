//! Scenarios: data files under `bench/scenarios`, embedded, checked, and known by the hash of their contents.

use std::borrow::Cow;

use crazyflie_control::Mode;
use crazyflie_env::config::{Autoreset, EffectTable, Options};
use crazyflie_env::coupling::{Knowledge, MOST_DRONES};
use crazyflie_env::effects::check_effects;
use crazyflie_env::model::{Model, VerticalInput};
use crazyflie_env::vector::VectorEnv;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::error::{Error, Result};
use super::levels::{AS_DECLARED, LEVELS, plan_at};
use super::mystery::{EffectPool, HiddenDraw};
use super::score::Cost;
use super::secrets::{Secrets, canonical, sha256_hex};
use crazyflie_server::flight::Phase;

/// Names and texts of all files in `bench/scenarios`; the build script lists them.
const FILES: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/scenarios.rs"));

/// The fewest episodes from which an attempt may be judged.
const EPISODES_MIN: usize = 20;

/// A scenario file.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ScenarioPlan {
    pub name: String,
    pub version: String,
    pub title: String,
    pub description: String,
    /// Section and figure of the thesis, or another source.
    pub source: String,
    pub episodes: usize,
    pub seconds: f64,
    pub vertical: VerticalInput,
    pub task: String,
    #[serde(default)]
    pub task_options: Value,
    /// Several drones that share the air; without it each flies alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub team: Option<MultiDronePlan>,
    #[serde(default)]
    pub effects: EffectTable,
    pub phases: Vec<PlannedPhase>,
    pub cost: Cost,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hidden: Option<EffectPool>,
}

/// Several drones in each episode.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MultiDronePlan {
    pub drones: usize,
    /// Knowledge that they have of each other.
    pub neighbours: Knowledge,
}

/// A part of the flight with one set-point; `mode` is the mode of the thesis's controller.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedPhase {
    pub(crate) name: String,
    pub(crate) from_s: f64,
    pub(crate) mode: String,
}

impl PlannedPhase {
    /// # Errors
    /// [`crazyflie_env::Error::Unknown`] for a mode that there is not.
    pub fn phase(&self) -> crazyflie_env::Result<Phase> {
        let (name, mode) = (Cow::Owned(self.name.clone()), Mode::named(&self.mode)?);
        Ok(Phase { name, from_s: self.from_s, setpoint_m: None, mode })
    }
}

/// A scenario as this server runs it.
#[derive(Debug, Clone)]
pub struct Scenario {
    pub(super) plan: ScenarioPlan,
    pub(super) phases: Vec<Phase>,
    pub(super) hidden: Option<HiddenDraw>,
    pub(super) hash: String,
    pub(super) level: usize,
    /// The same scenario at other levels.
    pub(super) levels: Vec<String>,
}

/// Number of files, each of which is a scenario as declared.
pub(super) fn files() -> usize {
    FILES.len()
}

/// Every scenario, with what the secret decides: those of the files in their order, then their other levels.
pub(super) fn read_all(secrets: &Secrets) -> Result<Vec<Scenario>> {
    let read = |(file, text): &(&'static str, &str)| Scenario::read(file, text, secrets);
    let mut all = FILES.iter().map(read).collect::<Result<Vec<_>>>()?;
    let pool = all.iter().find_map(|scenario| scenario.plan.hidden.clone());
    let pool = pool.ok_or_else(|| Error::Internal("no scenario has a pool of hidden effects".into()))?;
    for ((file, _), at) in FILES.iter().zip(0..) {
        for level in &LEVELS {
            if let Some(plan) = plan_at(level, &all[at].plan, &pool) {
                let scenario = Scenario::with_plan(file, plan, level.number, secrets)?;
                all[at].levels.push(scenario.id());
                all.push(scenario);
            }
        }
    }
    Ok(all)
}

impl Scenario {
    pub(super) fn read(file: &'static str, text: &str, secrets: &Secrets) -> Result<Scenario> {
        let bad = |problem: String| Error::ScenarioFile { file, problem };
        let plan: ScenarioPlan = toml::from_str(text).map_err(|e| bad(e.to_string()))?;
        let level = if plan.hidden.is_some() { 3 } else { AS_DECLARED };
        let scenario = Scenario::with_plan(file, plan, level, secrets)?;
        scenario.env(1).map_err(|e| bad(e.to_string()))?;
        Ok(scenario)
    }

    /// Without flying it: a test does that with every level of every file, and a program that starts need not.
    fn with_plan(
        file: &'static str,
        plan: ScenarioPlan,
        level: usize,
        secrets: &Secrets,
    ) -> Result<Scenario> {
        let bad = |problem: String| Error::ScenarioFile { file, problem };
        check(&plan).map_err(bad)?;
        let phases = plan
            .phases
            .iter()
            .map(|p| p.phase().map_err(|e| bad(e.to_string())))
            .collect::<Result<Vec<_>>>()?;
        let public = content_hash(&plan, None)?;
        let hidden = plan
            .hidden
            .as_ref()
            .map(|pool| pool.draw(secrets, &public).map_err(|e| bad(e.to_string())))
            .transpose()?;
        let hash = content_hash(&plan, hidden.as_ref().map(|h| h.commitment.as_str()))?;
        Ok(Scenario { plan, phases, hidden, hash, level, levels: Vec::new() })
    }

    /// A declared scenario with more effects, to fly for oneself: it is on no leaderboard.
    ///
    /// # Errors
    /// [`Error::Scenario`] for a name that is unknown or hides something; those of a bad table of effects.
    pub fn with_effects(name: &str, more: EffectTable) -> Result<Scenario> {
        let plans = FILES
            .iter()
            .map(|(file, text)| toml::from_str::<ScenarioPlan>(text).map(|plan| (*file, *text, plan)));
        let plans =
            plans.collect::<std::result::Result<Vec<_>, _>>().map_err(|e| Error::Internal(e.to_string()))?;
        let open = |plan: &ScenarioPlan| plan.hidden.is_none();
        let named = plans.iter().find(|(.., plan)| {
            open(plan) && (plan.name == name || format!("{}@{}", plan.name, plan.version) == name)
        });
        let Some((file, text, _)) = named else {
            let known: Vec<&str> = plans
                .iter()
                .map(|(.., plan)| plan)
                .filter(|plan| open(plan))
                .map(|plan| plan.name.as_str())
                .collect();
            return Err(Error::Scenario { name: name.into(), known: known.join(", ") });
        };
        // nothing is hidden in it: no secret is asked
        let mut scenario = Scenario::read(file, text, &Secrets::new(&[0; 32], [0; 32]))?;
        scenario.plan.effects.extend(more);
        scenario.env(1)?;
        Ok(scenario)
    }

    /// `name@version`.
    pub fn id(&self) -> String {
        format!("{}@{}", self.plan.name, self.plan.version)
    }

    /// The ids of the same scenario at these levels, as far as there are such.
    pub fn ids_at(&self, levels: &[usize]) -> Vec<String> {
        let of_level = |level: &usize| {
            let suffix = format!("{}.{level}@", self.plan.name);
            if *level == self.level {
                return Some(self.id());
            }
            self.levels.iter().find(|id| id.starts_with(&suffix)).cloned()
        };
        levels.iter().filter_map(of_level).collect()
    }

    /// Number of its level, see [`LEVELS`].
    pub fn level(&self) -> usize {
        self.level
    }

    /// Returns the SHA-256 of its contents, in hex.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// Returns a short description for users.
    pub fn title(&self) -> &str {
        &self.plan.title
    }

    /// Returns the number of flights of an attempt.
    pub fn episodes(&self) -> usize {
        self.plan.episodes
    }

    /// In each episode.
    pub(super) fn drones(&self) -> usize {
        self.plan.team.as_ref().map_or(1, |team| team.drones)
    }

    pub(crate) fn planned_phases(&self) -> &[PlannedPhase] {
        &self.plan.phases
    }

    /// Returns the length of an episode.
    pub fn seconds(&self) -> f64 {
        self.plan.seconds
    }

    /// The environments of an attempt. They reset on their own, because in lock-step those that have ended
    /// are stepped along; nothing after an end is shown or counted.
    pub(super) fn env(&self, episodes: usize) -> Result<VectorEnv> {
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
        let options = match &self.plan.team {
            None => options,
            Some(MultiDronePlan { drones, neighbours }) => {
                Options { drones: *drones, neighbours: *neighbours, ..options }
            }
        };
        Ok(VectorEnv::new(&[Model::thesis()], &options, episodes)?)
    }

    pub(super) fn lands(&self) -> bool {
        self.phases.last().is_some_and(|phase| phase.mode == Mode::Landing)
    }

    /// The public part of the scenario.
    pub fn public(&self) -> Value {
        let p = &self.plan;
        json!({
            "id": self.id(), "name": p.name, "version": p.version, "hash": self.hash, "title": p.title, "description": p.description,
            "source": p.source, "episodes": p.episodes, "seconds": p.seconds, "vertical": p.vertical, "task": p.task,
            "task_options": p.task_options, "team": p.team, "effects": p.effects, "phases": p.phases, "cost": p.cost,
            "level": self.level, "levels": self.levels, "commitment": self.hidden.as_ref().map(|h| &h.commitment),
        })
    }
}

/// SHA-256 over the canonical JSON of the file's content, of the model's numbers, and of the commitment to
/// what is hidden.
pub(super) fn content_hash(plan: &ScenarioPlan, commitment: Option<&str>) -> Result<String> {
    // the motor-level form is younger than the first scenarios: one that does not fly it does not depend on it
    let flown = |path: &str| plan.vertical == VerticalInput::Motors || !path.starts_with("vertical.motors.");
    let parameters: Vec<_> =
        Model::thesis().parameters().into_iter().filter(|(path, ..)| flown(path)).collect();
    let model = sha256_hex(&canonical(&parameters)?);
    Ok(sha256_hex(&canonical(&json!({"scenario": plan, "model": model, "commitment": commitment}))?))
}

fn check(plan: &ScenarioPlan) -> std::result::Result<(), String> {
    if plan.episodes < EPISODES_MIN {
        return Err(format!("{} episodes, expected at least {EPISODES_MIN}", plan.episodes));
    }
    if !(1.0..=120.0).contains(&plan.seconds) {
        return Err(format!("{} seconds, expected 1 to 120", plan.seconds));
    }
    if let Some(team) = plan.team.as_ref().filter(|team| !(2..=MOST_DRONES).contains(&team.drones)) {
        return Err(format!("a team of {} drones, expected 2 to {MOST_DRONES}", team.drones));
    }
    let in_order = plan.phases.is_sorted_by(|a, b| a.from_s < b.from_s);
    if plan.phases.first().is_none_or(|first| first.from_s != 0.0) || !in_order {
        return Err("the phases must begin at 0 s and be in order".into());
    }
    plan.cost.check()?;
    check_effects(&plan.effects).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first line of each file has the hash of its public part. A scenario that has been published does not
    /// change: give it a new version, and keep the old file.
    #[test]
    fn no_scenario_changes_without_a_new_version() {
        assert!(FILES.len() >= 15, "{FILES:?}");
        for (file, text) in FILES {
            let plan = toml::from_str::<ScenarioPlan>(text).unwrap();
            let expected = format!("# sha256 {}", content_hash(&plan, None).unwrap());
            assert_eq!(text.lines().next(), Some(expected.as_str()), "first line of {file}");
        }
    }

    #[test]
    fn a_hash_covers_every_line_of_a_scenario() {
        let plan = |text: &str| toml::from_str::<ScenarioPlan>(text).unwrap();
        for (file, text) in FILES {
            // the first line holds the hash itself
            let text = text.split_once('\n').unwrap().1;
            let hash = content_hash(&plan(text), None).unwrap();
            let mut changed = 0;
            for (at, digit) in text.match_indices(|c: char| c.is_ascii_digit()) {
                // another digit in its place, where what comes of it can be read
                let other = if digit == "5" { "6" } else { "5" };
                let Ok(new) =
                    toml::from_str::<ScenarioPlan>(&format!("{}{other}{}", &text[..at], &text[at + 1..]))
                else {
                    continue;
                };
                assert_ne!(content_hash(&new, None).unwrap(), hash, "{file} at byte {at}");
                changed += 1;
            }
            assert!(changed > 20, "{file}: {changed}");
            let commitment = content_hash(&plan(text), Some("0")).unwrap();
            assert_ne!(commitment, hash);
        }
    }

    #[test]
    fn mistakes_in_a_file_are_named() {
        let secrets = Secrets::new(&[1; 32], [2; 32]);
        let (file, text) = *FILES.iter().find(|(file, _)| *file == "hover-aruco.toml").unwrap();
        let read = |from: &str, to: &str| {
            assert!(text.contains(from));
            Scenario::read(file, &text.replace(from, to), &secrets).map(|_| ()).unwrap_err().to_string()
        };
        for (from, to, word) in [
            ("episodes = 24", "episodes = 19", "at least 20"),
            ("seconds = 15.0", "seconds = nan", "expected 1 to 120"),
            ("from_s = 0.0", "from_s = 1.0", "begin at 0 s"),
            ("mode = \"automatic\"", "mode = \"auto\"", "controller mode"),
            ("rmse_m = 0.15", "rmse_m = -1.0", "positive"),
            ("camera_noise", "camera_nois", "did you mean \"camera_noise\""),
            ("start_radius_m = 0.3", "start_radius_m = 30.0", "start_radius_m is 30"),
            ("title", "titel", "titel"),
        ] {
            let error = read(from, to);
            assert!(error.contains(file) && error.contains(word), "{error}");
        }
    }
}
