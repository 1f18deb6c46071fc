//! What can be chosen about worlds of several drones.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::known::Knowledge;
use crate::config::{EffectParams, EffectTable, Number, Options, check_effects, effect_table};
use crate::error::{Error, Result};
use crate::task::within;

/// Most drones in a world.
pub const MOST_DRONES: usize = 64;

/// Lift that one Crazyflie loses a quarter of a metre below another (see the effect `downwash`): drones that share the air feel each other.
const DOWNWASH_N: f64 = 0.118;

/// What differs from drone to drone.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Each {
    /// In place of those that all have in common.
    #[serde(deserialize_with = "effect_table")]
    pub effects: EffectTable,
}

/// Everything about a batch of worlds besides the models.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Shared {
    /// In each world; 0 for as many as the mission likes.
    pub drones: usize,
    /// What they know of each other.
    pub neighbours: Knowledge,
    /// For each drone, or for none.
    pub each: Vec<Each>,
    /// Two drones nearer than twice this have collided.
    pub radius_m: f64,
}

impl Default for Shared {
    fn default() -> Self {
        // motor to motor across 92 mm, propellers of 46 mm (thesis 3.1): tips at 69 mm from the centre
        Shared { drones: 0, neighbours: Knowledge::Ideal, each: Vec::new(), radius_m: 0.069 }
    }
}

/// [`Options`], whose `task` is a mission, and [`Shared`], in one JSON object.
#[derive(Debug, Clone, PartialEq)]
pub struct SwarmOptions {
    pub env: Options,
    pub shared: Shared,
}

impl SwarmOptions {
    /// From JSON.
    ///
    /// # Errors
    /// [`Error::Config`], [`Error::Unknown`] and [`Error::Range`], as [`Options::parse`].
    pub fn parse(text: &str) -> Result<Self> {
        let bad = |e: serde_json::Error| Error::Config(e.to_string());
        let all: Map<String, Value> = serde_json::from_str(text).map_err(bad)?;
        let (own, mut rest): (Map<_, _>, Map<_, _>) =
            all.into_iter().partition(|(name, _)| ["drones", "neighbours", "each", "radius_m"].contains(&name.as_str()));
        rest.entry("task").or_insert_with(|| "formation".into());
        let shared: Shared = serde_json::from_value(own.into()).map_err(bad)?;
        let mut env: Options = serde_json::from_value(rest.into()).map_err(bad)?;
        env.effects.entry("downwash".into()).or_insert(EffectParams::First(Number::Fixed(DOWNWASH_N)));
        check_effects(&env.effects)?;
        shared.each.iter().try_for_each(|each| check_effects(&each.effects))?;
        within("radius_m", shared.radius_m, 0.0, 0.5)?;
        Ok(SwarmOptions { env, shared })
    }

    /// The effects of drone `drone`.
    pub(super) fn effects(&self, drone: usize) -> EffectTable {
        let mut table = self.env.effects.clone();
        let own = self.shared.each.get(drone).map(|each| &each.effects);
        table.extend(own.into_iter().flatten().map(|(name, given)| (name.clone(), given.clone())));
        table
    }

    /// # Errors
    /// [`Error::Range`] unless there are as many entries of `each` and `models` as drones (or one model).
    pub(super) fn check(&self, drones: usize, models: usize) -> Result<()> {
        let wrong = |name: &str, value: usize, want: String| Err(Error::Range { name: name.into(), value: value as f64, want });
        let each = self.shared.each.len();
        if each != 0 && each != drones {
            return wrong("the number of entries of each", each, format!("0 or {drones}, one for each drone"));
        }
        if models != 1 && models != drones {
            return wrong("the number of models", models, format!("1 or {drones}, one for each drone"));
        }
        Ok(())
    }
}
