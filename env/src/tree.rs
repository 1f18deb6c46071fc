//! Texts that people write, TOML or JSON, read as trees. Types are read from trees alone: each kind of reader would
//! compile every type once more.

use serde::de::DeserializeOwned;
use serde_json::Value;

fn is_json(text: &str) -> bool {
    text.trim_start().starts_with('{')
}

/// Parses TOML or JSON, distinguished by the first character; a problem names line and column. JSON has no NaN: it
/// would become `null`, so that a number would be as if it were not given.
pub(crate) fn parse_tree(text: &str) -> Result<Value, String> {
    if is_json(text) {
        return serde_json::from_str(text).map_err(|error| error.to_string());
    }
    let table = toml::from_str(text).map_err(|error: toml::de::Error| error.to_string())?;
    check_finite(&table, "the file")?;
    serde_json::to_value(table).map_err(|error| error.to_string())
}

/// # Errors
/// The key of a number that is NaN or infinite; of a list its key.
fn check_finite(tree: &toml::Value, key: &str) -> Result<(), String> {
    match tree {
        toml::Value::Float(number) if !number.is_finite() => {
            Err(format!("{key} is {number}, expected a finite number"))
        }
        toml::Value::Table(table) => table.iter().try_for_each(|(key, value)| check_finite(value, key)),
        toml::Value::Array(values) => values.iter().try_for_each(|value| check_finite(value, key)),
        _ => Ok(()),
    }
}

/// Parses a text like [`parse_tree`], into a tree in which NaN stays NaN. A JSON `null` is as if it were not there.
pub(crate) fn parse_table(text: &str) -> Result<toml::Value, String> {
    if !is_json(text) {
        return toml::from_str(text).map_err(|error| error.to_string());
    }
    let mut tree = parse_tree(text)?;
    drop_nulls(&mut tree);
    toml::Value::try_from(tree).map_err(|error| error.to_string())
}

fn drop_nulls(tree: &mut Value) {
    if let Value::Object(entries) = tree {
        entries.retain(|_, value| !value.is_null());
        entries.values_mut().for_each(drop_nulls);
    }
}

/// For numbers and choices that are written only where they are not the usual ones.
pub(crate) fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Reads a type from a tree; a problem names the path of the wrong value.
pub(crate) fn read_tree<T: DeserializeOwned>(tree: toml::Value) -> Result<T, String> {
    serde_path_to_error::deserialize(tree).map_err(|error: serde_path_to_error::Error<toml::de::Error>| {
        located(error.path(), error.inner().message().to_owned())
    })
}

/// A problem with the path of the wrong value.
pub(crate) fn located(path: &serde_path_to_error::Path, problem: String) -> String {
    match path.to_string() {
        path if path == "." => problem,
        path => format!("{path}: {problem}"),
    }
}
