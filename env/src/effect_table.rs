//! Effects as a model file or a configuration names them. Nothing here knows which there are.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::number::Number;

/// Effects by name, each with its parameters by name.
pub type EffectTable = BTreeMap<String, EffectParams>;

/// Reads a table of effects; an error names the effect, which an untagged enum alone would not.
pub(crate) fn read<'de, D: serde::Deserializer<'de>>(from: D) -> std::result::Result<EffectTable, D::Error> {
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
