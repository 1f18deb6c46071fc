//! The fields of a message: unknown ones are refused with a proposal, and errors are worded without names of Rust.

use std::borrow::Cow;
use std::fmt;

use crazyflie_env::error::unknown;
use serde::de::{DeserializeOwned, Deserializer, IgnoredAny, MapAccess, Visitor};
use serde::{Deserialize, forward_to_deserialize_any};
use serde_json::Value;

use super::error::{Code, ProtocolError};

/// Fields of every message, and the names of its other fields.
#[derive(Debug, Default)]
pub(super) struct Envelope<'a> {
    pub id: Option<Value>,
    pub kind: Option<Value>,
    pub others: Vec<Cow<'a, str>>,
}

impl<'de: 'a, 'a> Deserialize<'de> for Envelope<'a> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Reader;
        impl<'de> Visitor<'de> for Reader {
            type Value = Envelope<'de>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut envelope = Envelope::default();
                while let Some(Name(name)) = map.next_key()? {
                    match &*name {
                        "id" => envelope.id = Some(map.next_value()?),
                        "type" => envelope.kind = Some(map.next_value()?),
                        _ => {
                            map.next_value::<IgnoredAny>()?;
                            envelope.others.push(name);
                        }
                    }
                }
                Ok(envelope)
            }
        }
        from.deserialize_map(Reader)
    }
}

/// A name that is borrowed if the text has it without escapes.
#[derive(Deserialize)]
struct Name<'a>(#[serde(borrow)] Cow<'a, str>);

/// The fields of a message of a kind.
#[derive(Debug)]
pub struct Fields<'a> {
    pub(super) kind: String,
    pub(super) text: &'a str,
    pub(super) names: Vec<Cow<'a, str>>,
}

impl Fields<'_> {
    /// The `type` of the message.
    pub fn kind(&self) -> &str {
        &self.kind
    }

    /// Reads them all.
    ///
    /// # Errors
    /// `bad_message` for a field that `T` does not have, and for what its fields cannot be.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, ProtocolError> {
        self.check(&field_names::<T>())?;
        self.parse()
    }

    /// Fields of one or the other.
    ///
    /// # Errors
    /// The errors of [`Fields::read`].
    pub(super) fn read_both<T: DeserializeOwned, U: DeserializeOwned>(
        &self,
    ) -> Result<(T, U), ProtocolError> {
        self.check(&[field_names::<T>(), field_names::<U>()].concat())?;
        Ok((self.parse()?, self.parse()?))
    }

    fn check(&self, known: &[&'static str]) -> Result<(), ProtocolError> {
        let stray = self.names.iter().find(|name| !known.contains(&&***name));
        stray.map_or(Ok(()), |name| {
            let problem = if known.is_empty() {
                format!("unknown field {name:?}: it has none besides id and type")
            } else {
                unknown("field", name, known.iter().copied()).to_string()
            };
            Err(ProtocolError::new(Code::BadMessage, format!("{}: {problem}", self.kind)))
        })
    }

    fn parse<T: DeserializeOwned>(&self) -> Result<T, ProtocolError> {
        serde_json::from_str(self.text).map_err(|e| {
            ProtocolError::new(Code::BadMessage, format!("{}: {}", self.kind, plain_words(&e.to_string())))
        })
    }
}

/// Returns the names of the fields of a structure, as its `Deserialize` requests them.
fn field_names<T: DeserializeOwned>() -> Vec<&'static str> {
    let mut names = Vec::new();
    // a value is not made: only the names are wanted
    let _ = T::deserialize(NameReader(&mut names));
    names
}

struct NameReader<'a>(&'a mut Vec<&'static str>);

impl<'de> Deserializer<'de> for NameReader<'_> {
    type Error = serde::de::value::Error;

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        _: V,
    ) -> Result<V::Value, Self::Error> {
        self.0.extend(fields);
        Err(serde::de::Error::custom("only the names"))
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Self::Error> {
        Err(serde::de::Error::custom("no structure"))
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 u8 u16 u32 u64 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map enum identifier ignored_any
    }
}

/// Serde's words for types, and words that readers of any language understand.
const WORDS: [(&str, &str); 22] = [
    ("expected usize", "expected a whole number from 0"),
    ("expected u64", "expected a whole number from 0"),
    ("expected u32", "expected a whole number from 0"),
    ("expected u16", "expected a whole number from 0 to 65535"),
    ("expected i64", "expected a whole number"),
    ("expected f32", "expected a number"),
    ("expected f64", "expected a number"),
    ("expected a boolean", "expected true or false"),
    ("expected bool", "expected true or false"),
    ("expected a sequence", "expected a list"),
    ("expected a map", "expected an object"),
    ("expected unit", "expected null"),
    ("expected option", "expected a value or null"),
    ("expected a borrowed string", "expected a string"),
    ("invalid type: map", "invalid type: an object"),
    ("invalid type: sequence", "invalid type: a list"),
    ("invalid type: unit", "invalid type: null"),
    ("invalid type: floating point", "invalid type: the number"),
    ("invalid type: integer", "invalid type: the number"),
    ("invalid type: boolean", "invalid type:"),
    ("invalid value: integer", "invalid value:"),
    ("invalid value: floating point", "invalid value:"),
];

/// The words of a parser's error without names of Rust's types.
pub(crate) fn plain_words(words: &str) -> String {
    let mut words = WORDS.iter().fold(words.to_owned(), |words, (from, to)| words.replace(from, to));
    for odd in ["expected struct ", "expected enum ", "expected tuple struct "] {
        while let Some(at) = words.find(odd) {
            let name_end =
                words[at + odd.len()..].find([' ', ',']).map_or(words.len(), |n| at + odd.len() + n);
            words.replace_range(at..name_end, "expected an object");
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Deserialize)]
    #[allow(dead_code, reason = "what is read matters, not who reads it")]
    struct Sample {
        num_envs: usize,
        #[serde(default)]
        rate_hz: f32,
        #[serde(rename = "on", default)]
        is_on: bool,
        #[serde(default)]
        list: Vec<u32>,
        #[serde(default)]
        inner: Option<Box<Sample>>,
    }

    fn read(text: &str) -> Result<Sample, String> {
        let envelope: Envelope<'_> = serde_json::from_str(text).unwrap();
        Fields { kind: "sample".into(), text, names: envelope.others }.read().map_err(|e| e.to_string())
    }

    #[test]
    fn a_field_that_it_does_not_have_is_refused_with_a_proposal() {
        let error = read(r#"{"id": 1, "type": "sample", "num_env": 64, "num_envs": 1}"#).unwrap_err();
        assert!(error.contains("\"num_env\"") && error.contains("did you mean \"num_envs\""), "{error}");
        let escaped = read(r#"{"id": 1, "num\u005fenvs": 2, "on": true}"#).unwrap();
        assert!(escaped.num_envs == 2 && escaped.is_on);
    }

    #[test]
    fn no_type_of_rust_is_in_an_error() {
        for value in [
            r#""num_envs": "x""#,
            r#""num_envs": -1"#,
            r#""num_envs": 1.5"#,
            r#""num_envs": null"#,
            r#""num_envs": 1, "rate_hz": []"#,
            r#""num_envs": 1, "rate_hz": "fast""#,
            r#""num_envs": 1, "on": 1"#,
            r#""num_envs": 1, "list": {}"#,
            r#""num_envs": 1, "list": [true]"#,
            r#""num_envs": 1, "list": [-1]"#,
            r#""num_envs": 1, "inner": 3"#,
            r#""num_envs": 1, "inner": "x""#,
        ] {
            let error = read(&format!("{{{value}}}")).unwrap_err();
            for rust in ["usize", "u32", "f32", "f64", "struct", "Sample", "sequence", "unit", "boolean"] {
                assert!(!error.contains(rust), "{value}: {error}");
            }
        }
    }
}
