//! The thesis's experiments, flown again: its figure, ours, and how far apart they are.

mod flights;
mod picture;
mod steps;

use crazyflie_env::Error;
use crazyflie_env::model::Model;

pub(crate) use picture::pictures;

/// Figures that agree within this share are called the same: the thesis reads most of its own off plots, with
/// words like "almost".
const TOLERANCE: f64 = 0.25;

/// Claim of the thesis about a quantity.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Claim {
    /// A figure, and the words that it comes in.
    About(f64, String),
    AtMost(f64, &'static str),
    /// Nothing that a number of ours could be held against.
    Words(&'static str),
}

/// A figure of ours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Measurement {
    /// Infinite if it never came to pass.
    pub value: f64,
    pub unit: &'static str,
    pub decimals: usize,
}

/// One line of the scorecard.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ScorecardRow {
    /// Section and figure of the thesis.
    pub place: &'static str,
    pub experiment: &'static str,
    /// Old, new, or none in open loop.
    pub gains: &'static str,
    pub quantity: &'static str,
    pub claim: Claim,
    /// With the true position at every control tick.
    pub ideal: Option<Measurement>,
    /// Through the lab's camera, median over seeds.
    pub rig: Option<Measurement>,
    /// Reason that the two differ or cannot be compared.
    pub why: &'static str,
}

impl Claim {
    /// Deviation of a figure from the claim; `None` where that makes no sense.
    pub(crate) fn deviation(&self, figure: &Measurement) -> Option<f64> {
        match self {
            _ if !figure.value.is_finite() => None,
            Claim::About(value, _) => Some(figure.value - value),
            // beyond the limit
            Claim::AtMost(limit, _) => Some((figure.value - limit).max(0.0)),
            Claim::Words(_) => None,
        }
    }

    /// Whether a figure agrees with the claim.
    pub(crate) fn agrees(&self, figure: &Measurement) -> Option<bool> {
        match self {
            Claim::About(value, _) => Some((figure.value - value).abs() <= TOLERANCE * value.abs()),
            Claim::AtMost(value, _) => Some(figure.value <= *value),
            Claim::Words(_) => None,
        }
    }

    pub(crate) fn words(&self) -> &str {
        match self {
            Claim::About(_, words) => words,
            Claim::AtMost(_, words) | Claim::Words(words) => words,
        }
    }
}

impl ScorecardRow {
    /// Which of our figures agree with the thesis's.
    pub(crate) fn mark(&self) -> &'static str {
        let agrees = |figure: &Option<Measurement>| figure.as_ref().and_then(|f| self.claim.agrees(f));
        match (agrees(&self.ideal), agrees(&self.rig)) {
            (None, None) => "not comparable",
            (Some(true), Some(true)) | (Some(true), None) | (None, Some(true)) => "agrees",
            (Some(true), Some(false)) => "ideal agrees",
            (Some(false), Some(true)) => "rig agrees",
            (Some(false) | None, Some(false) | None) => "differs",
        }
    }
}

/// A figure of the thesis, in its words.
fn about(value: f64, words: impl Into<String>) -> Claim {
    Claim::About(value, words.into())
}

fn figure(value: f64, unit: &'static str, decimals: usize) -> Option<Measurement> {
    Some(Measurement { value, unit, decimals })
}

/// Every line, in the order of the thesis. `done` is called after each experiment.
pub(crate) fn lines(done: &dyn Fn()) -> Result<Vec<ScorecardRow>, Error> {
    let model = Model::thesis();
    let mut lines = Vec::new();
    for experiment in steps::EXPERIMENTS {
        lines.extend(experiment(&model)?);
        done();
    }
    for experiment in flights::EXPERIMENTS {
        lines.extend(experiment(&model)?);
        done();
    }
    Ok(lines)
}

/// Number of calls of `done` by [`lines`].
pub(crate) const COUNT: usize = steps::EXPERIMENTS.len() + flights::EXPERIMENTS.len();

/// The middle value; of two middle ones the upper.
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agreement() {
        let f = |value| Measurement { value, unit: "cm", decimals: 1 };
        assert_eq!(about(50.0, "").agrees(&f(60.0)), Some(true));
        assert_eq!(about(50.0, "").agrees(&f(70.0)), Some(false));
        assert_eq!(Claim::AtMost(10.0, "").agrees(&f(f64::INFINITY)), Some(false));
        assert_eq!(about(50.0, "").deviation(&f(f64::INFINITY)), None);
        assert_eq!(Claim::AtMost(10.0, "").deviation(&f(4.0)), Some(0.0));
        assert_eq!(Claim::Words("smooth").agrees(&f(1.0)), None);
    }
}
