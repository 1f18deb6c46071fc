//! Parameters of a recorded environment that can be changed at run time.

use crate::number::Number;
use crate::world::RecordedEffect;

/// The parameters of an effect of a drone, or of all.
#[derive(Debug, Clone)]
pub struct ParameterGroup {
    /// The effect's name, after the drone's where drones have effects of their own.
    pub name: String,
    /// The effect's name.
    pub(super) effect: &'static str,
    /// Description.
    pub about: &'static str,
    /// In the order of its registry entry.
    pub parameters: Vec<Parameter>,
}

/// A parameter.
#[derive(Debug, Clone)]
pub struct Parameter {
    /// Key, with the unit as its suffix.
    pub name: &'static str,
    /// Symbol of the unit; "1" for a pure number.
    pub unit: &'static str,
    /// Meaning.
    pub about: &'static str,
    /// Smallest and largest value.
    pub range: [f64; 2],
    /// The value, or what it is drawn from.
    pub number: Number,
    /// It counts something, and is written into the program as it is.
    pub counts: bool,
}

impl Parameter {
    /// Its value, or the middle of what it is drawn from.
    pub fn value(&self) -> f64 {
        let [low, high] = self.number.ends(self.range);
        0.5 * (low + high)
    }
}

impl ParameterGroup {
    pub(super) fn from_effect(effect: &RecordedEffect, prefix: &str) -> Self {
        let parameters = effect.numbers.iter().map(|bounded| Parameter {
            name: bounded.param.name,
            unit: bounded.param.unit,
            about: bounded.param.about,
            range: [bounded.param.low, bounded.param.high],
            number: bounded.number.clone(),
            counts: bounded.param.counts,
        });
        ParameterGroup {
            name: format!("{prefix}{}", effect.entry.name),
            effect: effect.entry.name,
            about: effect.entry.about,
            parameters: parameters.collect(),
        }
    }
}
