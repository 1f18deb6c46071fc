//! The options of a user, and the checks on them.

use serde::{Deserialize, Serialize};

use crate::action::ActionLevel;
use crate::coupling::Knowledge;
use crate::effect_table;
use crate::effects::{add_downwash, check_effects};
use crate::error::{Error, Result, check_range, json_problem, out_of_range};
use crate::expression::{
    LOAD_POS, PAIR_FIELDS, Program, find_expression_field, parse_cost, parse_reward, parse_termination,
};
use crate::model::{VEHICLE_RADIUS_M, VerticalInput};
use crate::observation::{Field, ObservationChoice, is_of_surroundings};
use crate::task;
use crate::tree::located;
use crate::wind_field::WindField;

pub use crate::effect_table::{EffectParams, EffectTable};
pub use crate::number::{Distribution, Number, SourcedValue};

/// Treatment of an environment whose episode has ended (Gymnasium's `AutoresetMode`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Autoreset {
    /// The next step resets it and ignores its action.
    #[default]
    NextStep,
    /// It is reset in the same step; the last observation is kept aside.
    SameStep,
    /// It stays ended until it is reset by name.
    Disabled,
}

/// Options that differ from drone to drone of a world.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Each {
    /// In place of those that all have in common.
    #[serde(deserialize_with = "effect_table::read")]
    pub effects: EffectTable,
}

/// Everything that can be chosen about a batch of environments, besides the models.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Name in [`crate::task::registry`]; "hover" by default.
    pub task: String,
    /// The task's own options.
    pub task_options: serde_json::Value,
    /// Which of the model's height inputs is commanded; the model's first unless given.
    pub vertical: Option<VerticalInput>,
    /// Effects that are on, by name; an entry replaces that of the model file.
    #[serde(deserialize_with = "effect_table::read")]
    pub effects: EffectTable,
    /// Physics steps per second; what the active effects need unless given. The linear model itself is exact
    /// at any rate.
    pub physics_hz: Option<u32>,
    /// Treatment of environments whose episode has ended.
    pub autoreset: Autoreset,
    /// Episodes are truncated after so many steps; 0 for never.
    pub max_episode_steps: u32,
    /// Threads that step the batch, the caller among them; the results are the same for any number.
    pub threads: usize,
    /// "baseline", "avx2" or "avx512"; the machine's best unless given. The results are the same.
    pub isa: Option<String>,
    /// Drones in each environment; 0 for as many as the task has by itself.
    pub drones: usize,
    /// Knowledge of the drones of an environment about each other.
    pub neighbours: Knowledge,
    /// For each drone, or for none.
    pub each: Vec<Each>,
    /// Two drones nearer than twice this have collided.
    pub radius_m: f64,
    /// Wind from place to place, for all drones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wind_field: Option<WindField>,
    /// Action level.
    #[serde(skip_serializing_if = "ActionLevel::is_default")]
    pub action: ActionLevel,
    /// Content of an observation.
    #[serde(skip_serializing_if = "ObservationChoice::is_default")]
    pub observation: ObservationChoice,
    /// Ticks of an observation, the newest last; 1 for now alone.
    #[serde(skip_serializing_if = "is_one")]
    pub history: usize,
    /// A reward of one's own in place of the task's: an expression over [`crate::expression::expression_fields`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reward: Option<String>,
    /// A condition that ends a drone's flight in place of the task's own end. Crashes, collisions and the
    /// walls end it anyway.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub termination: Option<String>,
    /// A cost beside the reward, for constrained learning: an expression over the same fields. It is kept for the
    /// caller like the fields of `watch`, behind them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cost: Option<String>,
    /// Fields whose numbers at the end of a step, before any reset, are kept for the caller.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub watch: Vec<String>,
}

/// Skips the default in serialised options, so that published configurations keep their hash.
fn is_one(number: &usize) -> bool {
    *number == 1
}

impl Default for Options {
    fn default() -> Self {
        Options {
            task: "hover".into(),
            task_options: serde_json::Value::Null,
            vertical: None,
            effects: EffectTable::new(),
            physics_hz: None,
            autoreset: Autoreset::NextStep,
            max_episode_steps: 0,
            threads: 1,
            isa: None,
            drones: 0,
            neighbours: Knowledge::Ideal,
            each: Vec::new(),
            // motor to motor across 92 mm, propellers of 46 mm (thesis 3.1): tips at 69 mm from the centre
            radius_m: VEHICLE_RADIUS_M,
            wind_field: None,
            action: ActionLevel::default(),
            observation: ObservationChoice::default(),
            history: 1,
            reward: None,
            termination: None,
            cost: None,
            watch: Vec::new(),
        }
    }
}

impl Options {
    /// Parses options from JSON. A task of several drones has the effect `downwash` unless the text turns it off.
    ///
    /// # Errors
    /// [`Error::Config`] for bad JSON or unknown fields, [`Error::Unknown`] for the task, [`Error::Range`];
    /// see also [`check_effects`].
    pub fn parse(text: &str) -> Result<Options> {
        let mut json = serde_json::Deserializer::from_str(text);
        let read = serde_path_to_error::deserialize(&mut json);
        let mut options: Options =
            read.map_err(|e| Error::Config(located(e.path(), json_problem(e.inner()))))?;
        json.end().map_err(|e| Error::Config(json_problem(&e)))?;
        if task::find(&options.task)?.drones > 1 {
            add_downwash(&mut options.effects);
        }
        check_effects(&options.effects)?;
        options.each.iter().try_for_each(|each| check_effects(&each.effects))?;
        check_range("radius_m", options.radius_m, 0.0, 0.5)?;
        options.programs()?;
        options.watch.iter().try_for_each(|name| find_expression_field(name).map(drop))?;
        Ok(options)
    }

    /// Returns whether an observation contains anything but the measurements of now.
    pub(crate) fn observes(&self) -> bool {
        !self.observation.is_default() || self.history != 1
    }

    /// Fields of an observation; `surrounded`: the task has gates or obstacles.
    ///
    /// # Errors
    /// [`Error::Config`] for fields of such where there are none, and for unknown fields.
    pub(crate) fn observed_fields(&self, surrounded: bool) -> Result<Vec<Field>> {
        let fields = self.observation.sources()?;
        match fields.iter().find(|field| !surrounded && is_of_surroundings(field)) {
            None => Ok(fields),
            Some(field) => Err(Error::Config(format!(
                "observation: the task {} has no gates and no obstacles, hence no field {:?}",
                self.task, field.name
            ))),
        }
    }

    /// The expressions of a user's own.
    fn programs(&self) -> Result<[Option<Program>; 3]> {
        Ok([
            self.reward.as_deref().map(parse_reward).transpose()?,
            self.termination.as_deref().map(parse_termination).transpose()?,
            self.cost.as_deref().map(parse_cost).transpose()?,
        ])
    }

    /// Returns whether expressions or watched numbers contain fields of a drone among others.
    ///
    /// # Errors
    /// [`Error::Config`] for those that a world of so many `drones`, `loaded` or not, does not have.
    pub(crate) fn reads_pairs(&self, drones: usize, loaded: bool) -> Result<bool> {
        let programs = self.programs()?;
        let read = |field: &&Field| {
            programs.iter().flatten().any(|program| program.reads(field))
                || self.watch.iter().any(|name| name == field.name)
        };
        let mut fields = PAIR_FIELDS.iter().filter(read).peekable();
        let reads = fields.peek().is_some();
        let missing = fields.find(|field| if **field == LOAD_POS { !loaded } else { drones == 1 });
        missing.map_or(Ok(reads), |field| {
            let why =
                if *field == LOAD_POS { "a load, and none hangs" } else { "other drones, and one flies" };
            Err(Error::Config(format!("the field {} needs {why} in this task {}", field.name, self.task)))
        })
    }

    /// The effects of drone `drone` of an environment.
    pub(crate) fn drone_effects(&self, drone: usize) -> EffectTable {
        let mut table = self.effects.clone();
        let own = self.each.get(drone).map(|each| &each.effects);
        table.extend(own.into_iter().flatten().map(|(name, given)| (name.clone(), given.clone())));
        table
    }

    /// # Errors
    /// [`Error::Range`] unless there are as many entries of `each` and `models` as drones (or one model).
    pub(crate) fn check_drones(&self, drones: usize, models: usize) -> Result<()> {
        for (name, given, none) in
            [("the number of entries of each", self.each.len(), 0), ("the number of models", models, 1)]
        {
            if given != none && given != drones {
                let want = format!("{none} or {drones}, one for each drone");
                return Err(out_of_range(name, given as f64, want));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn effects(json: &str) -> Result<Options> {
        Options::parse(&format!("{{\"effects\": {json}}}"))
    }

    #[test]
    fn numbers_distributions_and_bare_numbers_are_read() {
        effects(r#"{"drag_linear": 0.3, "wind": {"x_mps2": {"uniform": [-1, 1]}, "y_mps2": 0.1}, "gust": {"sigma_mps2": {"log_uniform": [0.1, 1]}},
            "mass_change": {"normal": [0.001, 0.001]}, "thrust_scale": {"scale": {"choice": [0.9, 1.1]}}}"#).unwrap();
    }

    #[test]
    fn mistakes_are_named_with_a_proposal() {
        for (json, words) in [
            (r#"{"drag_lineer": 0.3}"#, vec!["drag_lineer", "did you mean \"drag_linear\""]),
            (r#"{"wind": {"x_mps": 0.3}}"#, vec!["wind.x_mps", "did you mean \"wind.x_mps2\""]),
            (r#"{"wind": {"x_mps2": 30}}"#, vec!["wind.x_mps2 is 30", "-5 to 5 m/s^2"]),
            (r#"{"wind": {"x_mps2": {"uniform": [1, -1]}}}"#, vec!["lower bound"]),
            (r#"{"wind": {"x_mps2": {"value": 1, "unit": "m/s"}}}"#, vec!["unit", "m/s^2"]),
            (r#"{"thrust_scale": {"choice": []}}"#, vec!["at least one"]),
            (r#"{"wind": "strong"}"#, vec!["wind", "strong", "expected a number"]),
            (r#"{"wind": {"x_mps2": "a"}}"#, vec!["an object with such a value for each parameter"]),
            (r#"{"wind": {"x_mps2": {"normal": 1}}}"#, vec!["wind", "expected"]),
        ] {
            let error = effects(json).unwrap_err().to_string();
            assert!(words.iter().all(|w| error.contains(w)), "{json} gave: {error}");
            // a dictionary of Python has no lines and columns
            assert!(!error.contains("at line"), "{json} gave: {error}");
        }
    }
}
