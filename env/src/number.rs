//! A number as a user gives it: fixed, with its provenance, or drawn anew for every episode.

use rand::RngExt;
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, out_of_range};

/// A number, or a distribution from which one is drawn at the start of every episode (domain randomisation).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Number {
    /// The same value for every drone and episode, in the unit of the parameter.
    Fixed(f64),
    /// One draw per drone and episode.
    Distribution(Distribution),
    /// A value as written in a model file.
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
    /// Returns the value of every drone and episode, if it is not drawn.
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
            Err(out_of_range(name.clone(), value, format!("{low} to {high}{unit}")))
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
            Number::Distribution(Distribution::LogUniform([a, _])) if *a <= 0.0 => {
                Err(out_of_range(name.clone(), *a, "a positive lower bound for log_uniform"))
            }
            Number::Distribution(Distribution::Uniform([a, b]) | Distribution::LogUniform([a, b])) => {
                within(*a).and_then(|()| within(*b))
            }
            Number::Distribution(Distribution::Normal([mean, sd])) => {
                if !(*sd >= 0.0 && sd.is_finite()) {
                    return Err(out_of_range(name.clone(), *sd, "a standard deviation of at least 0"));
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
