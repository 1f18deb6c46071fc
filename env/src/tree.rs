//! Texts that people write, TOML or JSON, read as trees. Types are read from trees alone: each kind of reader would
//! compile every type once more.

use serde::de::DeserializeOwned;
use serde_json::Value;

/// Parses TOML or JSON, told apart by the first character; a problem names line and column.
pub(crate) fn parse_tree(text: &str) -> Result<Value, String> {
    if text.trim_start().starts_with('{') {
        serde_json::from_str(text).map_err(|error| error.to_string())
    } else {
        toml::from_str(text).map_err(|error| error.to_string())
    }
}

/// Reads a type from a tree; a problem names the path of the wrong value.
pub(crate) fn read_tree<T: DeserializeOwned>(tree: Value) -> Result<T, String> {
    serde_path_to_error::deserialize(tree).map_err(|error| match error.path().to_string() {
        path if path == "." => error.inner().to_string(),
        path => format!("{path}: {}", error.inner()),
    })
}
