//! Units of the parts of an expression, so that metres are not added to metres per second by mistake.

use std::collections::BTreeMap;
use std::fmt;

/// A product of powers of base units. Angles are pure numbers, as in the SI.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Unit(BTreeMap<&'static str, i32>);

impl Unit {
    /// From a symbol such as "m/s^2"; "1" and "rad" are pure numbers.
    pub(super) fn parse(symbol: &'static str) -> Unit {
        let mut powers = BTreeMap::new();
        for (i, part) in symbol.split('/').enumerate() {
            let (base, power) = part.split_once('^').unwrap_or((part, "1"));
            let power = power.parse().unwrap_or(1);
            if !matches!(base, "1" | "rad") {
                *powers.entry(base).or_insert(0) += if i == 0 { power } else { -power };
            }
        }
        Unit(powers)
    }

    pub(super) fn is_pure(&self) -> bool {
        self.0.is_empty()
    }

    /// This times `other` to the power `sign`.
    pub(super) fn times(&self, other: &Unit, sign: i32) -> Unit {
        let mut powers = self.0.clone();
        for (base, power) in &other.0 {
            *powers.entry(base).or_insert(0) += sign * power;
        }
        powers.retain(|_, power| *power != 0);
        Unit(powers)
    }

    /// This to a whole power.
    pub(super) fn power(&self, exponent: i32) -> Unit {
        let mut powers = self.0.clone();
        powers.values_mut().for_each(|power| *power = power.saturating_mul(exponent));
        powers.retain(|_, power| *power != 0);
        Unit(powers)
    }

    /// The square root, where it has whole powers.
    pub(super) fn root(&self) -> Option<Unit> {
        let mut powers = self.0.clone();
        for power in powers.values_mut() {
            if *power % 2 != 0 {
                return None;
            }
            *power /= 2;
        }
        Some(Unit(powers))
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let write = |sign: i32| {
            let factors = self.0.iter().filter(|(_, power)| **power * sign > 0);
            let text = factors.map(|(base, power)| match power * sign {
                1 => (*base).to_owned(),
                n => format!("{base}^{n}"),
            });
            text.collect::<Vec<_>>().join(" ")
        };
        let (over, under) = (write(1), write(-1));
        f.write_str(if over.is_empty() { "1" } else { &over })?;
        if under.is_empty() { Ok(()) } else { write!(f, "/{under}") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symbols_are_read_and_written() {
        for symbol in ["m", "m/s", "m/s^2", "V", "1", "1/s"] {
            assert_eq!(Unit::parse(symbol).to_string(), symbol);
        }
        assert_eq!(Unit::parse("rad/s").to_string(), "1/s");
        assert_eq!(Unit::parse("rad^2/s^2").power(-1).to_string(), "s^2");
        assert_eq!(Unit::parse("m").times(&Unit::parse("m/s"), -1).to_string(), "s");
        assert_eq!(Unit::parse("m").power(2).root(), Some(Unit::parse("m")));
        assert_eq!(Unit::parse("m").root(), None);
    }
}
