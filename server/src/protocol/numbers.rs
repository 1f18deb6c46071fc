//! Numbers of `f32` in JSON: sent as the `f64` that they are, so that they are received bit for bit.

use std::borrow::Cow;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A list of numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Numbers<'a>(pub Cow<'a, [f32]>);

impl Serialize for Numbers<'_> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_seq(self.0.iter().map(|number| f64::from(*number)))
    }
}

impl<'de> Deserialize<'de> for Numbers<'_> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        Vec::deserialize(from).map(|numbers| Numbers(Cow::Owned(numbers)))
    }
}

/// Rows of `width` numbers each.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "the type says it")]
pub struct Rows<'a> {
    pub numbers: Cow<'a, [f32]>,
    pub width: usize,
}

impl Rows<'_> {
    /// Number of rows.
    pub fn count(&self) -> usize {
        self.numbers.len() / self.width
    }
}

impl Serialize for Rows<'_> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_seq(self.numbers.chunks(self.width).map(|row| Numbers(row.into())))
    }
}

impl<'de> Deserialize<'de> for Rows<'_> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let rows = Vec::<Vec<f32>>::deserialize(from)?;
        let width = rows.first().map_or(0, Vec::len);
        if width == 0 {
            return Err(D::Error::custom("expected rows of numbers"));
        }
        if let Some((i, row)) = rows.iter().enumerate().find(|(_, row)| row.len() != width) {
            return Err(D::Error::custom(format!("row {i} has {} numbers, expected {width}", row.len())));
        }
        Ok(Rows { numbers: rows.concat().into(), width })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back_bit_for_bit_and_ragged_rows_are_refused() {
        let numbers = [0.1, -0.0, 1.0 / 3.0, f32::MAX, f32::MIN_POSITIVE / 2.0, 16_777_217.0];
        let text = serde_json::to_string(&Rows { numbers: numbers[..].into(), width: 2 }).expect("rows");
        let rows: Rows<'_> = serde_json::from_str(&text).expect("rows");
        assert_eq!((rows.count(), rows.width), (3, 2));
        assert_eq!(rows.numbers.iter().map(|v| v.to_bits()).collect::<Vec<_>>(), numbers.map(f32::to_bits));
        for ragged in ["[[1, 2], [3]]", "[]", "[[]]", "[1]"] {
            serde_json::from_str::<Rows<'_>>(ragged).expect_err(ragged);
        }
    }
}
