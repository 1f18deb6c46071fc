//! What a user can ask for, and the checks on it. Effects are looked up in the registry; nothing here knows
//! any of them.

use std::collections::BTreeMap;

use rand::RngExt;
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::action::ActionLevel;
use crate::coupling::Knowledge;
use crate::effects::{self, Entry, Param};
use crate::error::{Error, Result, check_range, unknown};
use crate::expression::{find_expression_field, parse_reward, parse_termination};
use crate::model::VerticalInput;
use crate::observation::ObservationChoice;
use crate::task;
use crate::wind_field::WindField;

/// Effects by name, each with its parameters by name.
pub type EffectTable = BTreeMap<String, EffectParams>;

/// Reads a table of effects; an error names the effect, which an untagged enum alone would not.
pub(crate) fn effect_table<'de, D: serde::Deserializer<'de>>(
    from: D,
) -> std::result::Result<EffectTable, D::Error> {
    let table = BTreeMap::<String, serde_json::Value>::deserialize(from)?;
    let read = |(name, value): (String, serde_json::Value)| match serde_json::from_value(value.clone()) {
        Ok(params) => Ok((name, params)),
        Err(_) => Err(serde::de::Error::custom(format!(
            "effect {name:?} is {value}, expected a number, a distribution such as {{\"uniform\": [0, 1]}}, or an object with such a value for each parameter"
        ))),
    };
    table.into_iter().map(read).collect()
}

/// The parameters of one effect: by name, or a bare number for the first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum EffectParams {
    /// Value of the first parameter; the others stay off.
    First(Number),
    /// Values by parameter name; absent ones stay off.
    Named(BTreeMap<String, Number>),
}

/// A number, or a distribution from which one is drawn at the start of every episode (domain randomisation).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Number {
    /// The same value for every drone and episode, in the unit of the parameter.
    Fixed(f64),
    /// One draw per drone and episode.
    Distribution(Distribution),
    /// As a model file says it.
    Sourced(SourcedValue),
}

/// A value with its provenance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SourcedValue {
    /// Amount in `unit`.
    pub value: f64,
    /// Symbol of the unit, which must be that of the parameter ("m/s^2"; "1" for a pure number).
    pub unit: String,
    /// Origin, in free text: an equation, a table, a measurement.
    #[serde(default)]
    pub source: String,
}

/// A distribution.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Distribution {
    /// Between two bounds.
    Uniform([f64; 2]),
    /// Uniform in the logarithm, between two positive bounds.
    LogUniform([f64; 2]),
    /// Mean and standard deviation; cut off at the parameter's range.
    Normal([f64; 2]),
    /// One of these.
    Choice(Vec<f64>),
}

impl Number {
    /// The value that holds for every drone and episode, if it is not drawn.
    pub fn fixed(&self) -> Option<f64> {
        match self {
            Number::Fixed(value) | Number::Sourced(SourcedValue { value, .. }) => Some(*value),
            Number::Distribution(_) => None,
        }
    }

    pub(crate) fn draw(&self, rng: &mut Pcg64Mcg) -> f64 {
        match self {
            Number::Fixed(value) | Number::Sourced(SourcedValue { value, .. }) => *value,
            Number::Distribution(Distribution::Uniform([a, b])) => a + (b - a) * rng.random::<f64>(),
            Number::Distribution(Distribution::LogUniform([a, b])) => {
                libm::exp(libm::log(*a) + (libm::log(*b) - libm::log(*a)) * rng.random::<f64>())
            }
            // the deviation was checked to be finite and not negative
            Number::Distribution(Distribution::Normal([mean, sd])) => {
                Normal::new(*mean, *sd).map_or(*mean, |n| n.sample(rng))
            }
            Number::Distribution(Distribution::Choice(of)) => of[rng.random_range(0..of.len())],
        }
    }

    /// The smallest and the largest value that is drawn within `low` and `high`; a normal distribution is cut
    /// off at four deviations, too.
    pub(crate) fn ends(&self, [low, high]: [f64; 2]) -> [f64; 2] {
        match self {
            Number::Fixed(value) | Number::Sourced(SourcedValue { value, .. }) => [*value; 2],
            Number::Distribution(Distribution::Uniform(ends) | Distribution::LogUniform(ends)) => *ends,
            Number::Distribution(Distribution::Normal([mean, sd])) => {
                [(mean - 4.0 * sd).max(low), (mean + 4.0 * sd).min(high)]
            }
            Number::Distribution(Distribution::Choice(of)) => {
                let extreme = |pick: fn(f64, f64) -> f64| of.iter().copied().reduce(pick).unwrap_or(low);
                [extreme(f64::min), extreme(f64::max)]
            }
        }
    }

    pub(crate) fn check(&self, bounds: &Bounds<'_>) -> Result<()> {
        let Bounds { name, unit, low, high } = bounds;
        let within = |value: f64| {
            if (*low..=*high).contains(&value) {
                return Ok(());
            }
            let unit = if *unit == "1" { String::new() } else { format!(" {unit}") };
            Err(Error::Range { name: name.clone(), value, want: format!("{low} to {high}{unit}") })
        };
        match self {
            Number::Fixed(value) => within(*value),
            Number::Sourced(q) if q.unit != *unit => {
                Err(Error::Config(format!("{} has the unit {:?}, expected {:?}", name, q.unit, unit)))
            }
            Number::Sourced(q) => within(q.value),
            Number::Distribution(Distribution::Uniform([a, b]) | Distribution::LogUniform([a, b]))
                if a > b =>
            {
                Err(Error::Config(format!("{}: the lower bound {a} is above the upper bound {b}", name)))
            }
            Number::Distribution(Distribution::LogUniform([a, _])) if *a <= 0.0 => Err(Error::Range {
                name: name.clone(),
                value: *a,
                want: "a positive lower bound for log_uniform".into(),
            }),
            Number::Distribution(Distribution::Uniform([a, b]) | Distribution::LogUniform([a, b])) => {
                within(*a).and_then(|()| within(*b))
            }
            Number::Distribution(Distribution::Normal([mean, sd])) => {
                if !(*sd >= 0.0 && sd.is_finite()) {
                    return Err(Error::Range {
                        name: name.clone(),
                        value: *sd,
                        want: "a standard deviation of at least 0".into(),
                    });
                }
                within(*mean)
            }
            Number::Distribution(Distribution::Choice(of)) => {
                if of.is_empty() {
                    return Err(Error::Config(format!("{}: choice needs at least one value", name)));
                }
                of.iter().try_for_each(|v| within(*v))
            }
        }
    }
}

/// The values that a number may have.
pub(crate) struct Bounds<'a> {
    /// Name of what has the number, for errors.
    pub name: String,
    pub unit: &'a str,
    pub low: f64,
    pub high: f64,
}

/// A number with the parameter that it is for.
#[derive(Debug, Clone)]
pub(crate) struct BoundedNumber {
    pub number: Number,
    pub param: &'static Param,
}

impl BoundedNumber {
    /// A value for one episode, within the parameter's range.
    pub fn draw(&self, rng: &mut Pcg64Mcg) -> f64 {
        self.number.draw(rng).clamp(self.param.low, self.param.high)
    }
}

/// The parameters of an effect in the order of its registry entry, defaults filled in.
pub fn numbers(entry: &Entry, given: &EffectParams) -> Vec<Number> {
    entry
        .params
        .iter()
        .enumerate()
        .map(|(i, p)| match given {
            EffectParams::First(number) if i == 0 => number.clone(),
            EffectParams::First(_) => Number::Fixed(p.off),
            EffectParams::Named(map) => map.get(p.name).cloned().unwrap_or(Number::Fixed(p.off)),
        })
        .collect()
}

/// Check names, units and ranges against the registry.
///
/// # Errors
/// [`Error::Unknown`] with a proposal, [`Error::Range`], [`Error::Config`].
pub fn check_effects(table: &EffectTable) -> Result<()> {
    for (name, given) in table {
        let (_, entry) = effects::find(name)?;
        if let EffectParams::Named(map) = given {
            for param in map.keys() {
                if !entry.params.iter().any(|p| p.name == param) {
                    let known: Vec<String> =
                        entry.params.iter().map(|p| format!("{name}.{}", p.name)).collect();
                    return Err(unknown(
                        "parameter of this effect",
                        &format!("{name}.{param}"),
                        known.iter().map(String::as_str),
                    ));
                }
            }
        }
        for (number, param) in numbers(entry, given).iter().zip(entry.params) {
            let (name, unit) = (format!("{name}.{}", param.name), param.unit);
            number.check(&Bounds { name, unit, low: param.low, high: param.high })?;
        }
    }
    Ok(())
}

/// What happens to an environment whose episode has ended (Gymnasium's `AutoresetMode`).
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

/// Lift that one Crazyflie loses a quarter of a metre below another (see the effect `downwash`): drones that
/// share the air feel each other.
const DOWNWASH_N: f64 = 0.118;

/// Radius of the vehicle over the tips of its propellers: 46 mm to a motor, and a propeller of 23 mm (thesis 3.1).
pub const VEHICLE_RADIUS_M: f64 = 0.069;

/// Turns the effect `downwash` on as it was measured, unless the table says something about it.
pub fn add_downwash(effects: &mut EffectTable) {
    effects.entry("downwash".into()).or_insert(EffectParams::First(Number::Fixed(DOWNWASH_N)));
}

/// What differs from drone to drone of a world.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Each {
    /// In place of those that all have in common.
    #[serde(deserialize_with = "effect_table")]
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
    #[serde(deserialize_with = "effect_table")]
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
    /// What the drones of an environment know of each other.
    pub neighbours: Knowledge,
    /// For each drone, or for none.
    pub each: Vec<Each>,
    /// Two drones nearer than twice this have collided.
    pub radius_m: f64,
    /// Wind from place to place, for all drones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wind_field: Option<WindField>,
    /// What an action sets.
    #[serde(skip_serializing_if = "ActionLevel::is_default")]
    pub action: ActionLevel,
    /// What an observation holds.
    #[serde(skip_serializing_if = "ObservationChoice::is_default")]
    pub observation: ObservationChoice,
    /// Ticks that an observation holds, the newest last; 1 for now alone.
    #[serde(skip_serializing_if = "is_one")]
    pub history: usize,
    /// A reward of one's own in place of the task's: an expression over [`crate::expression::expression_fields`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reward: Option<String>,
    /// A condition that ends a drone's flight in place of the task's own end. Crashes, collisions and the
    /// walls end it anyway.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub termination: Option<String>,
    /// Fields whose numbers at the end of a step, before any reset, are kept for the caller.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub watch: Vec<String>,
}

/// What was not chosen is not written: so published configurations keep their hash.
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
            watch: Vec::new(),
        }
    }
}

impl Options {
    /// From JSON. Where a task has several drones, the effect `downwash` is on unless the text says
    /// otherwise.
    ///
    /// # Errors
    /// [`Error::Config`] for bad JSON or unknown fields, [`Error::Unknown`] for the task, [`Error::Range`];
    /// see also [`check_effects`].
    pub fn parse(text: &str) -> Result<Options> {
        let mut options: Options = serde_json::from_str(text).map_err(|e| Error::Config(e.to_string()))?;
        if task::find(&options.task)?.drones > 1 {
            add_downwash(&mut options.effects);
        }
        check_effects(&options.effects)?;
        options.each.iter().try_for_each(|each| check_effects(&each.effects))?;
        check_range("radius_m", options.radius_m, 0.0, 0.5)?;
        options.reward.as_deref().map(parse_reward).transpose()?;
        options.termination.as_deref().map(parse_termination).transpose()?;
        options.watch.iter().try_for_each(|name| find_expression_field(name).map(drop))?;
        Ok(options)
    }

    /// Whether an observation holds something else than what is measured now.
    pub(crate) fn observes(&self) -> bool {
        !self.observation.is_default() || self.history != 1
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
        let wrong = |name: &str, value: usize, want: String| {
            Err(Error::Range { name: name.into(), value: value as f64, want })
        };
        let each = self.each.len();
        if each != 0 && each != drones {
            return wrong(
                "the number of entries of each",
                each,
                format!("0 or {drones}, one for each drone"),
            );
        }
        if models != 1 && models != drones {
            return wrong("the number of models", models, format!("1 or {drones}, one for each drone"));
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
            (r#"{"wind": {"x_mps2": {"normal": 1}}}"#, vec!["wind", "expected"]),
        ] {
            let error = effects(json).unwrap_err().to_string();
            assert!(words.iter().all(|w| error.contains(w)), "{json} gave: {error}");
        }
    }
}
