//! The explanation: verdict, findings, what is left.

use crazyflie_env::effects::Param;
use serde::Serialize;

use super::errors::Errors;
use super::leftover::FINDING;
use super::signals::{Signal, SignalVerdict};
use crate::fit::filter::Disturbances;
use crate::fit::hypothesis::Hypothesis;

/// The verdict on the declared model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Named effects account for the residual.
    Explained,
    /// Named effects account for some signals, or for most of the error; structure is left that none accounts
    /// for.
    PartlyExplained,
    /// The declared model accounts for the flights.
    NothingMissing,
    /// There is structure that no effect of the library accounts for.
    Unexplained,
    /// There is structure, and too many effects would account for it on these flights.
    NotDecidable,
}

impl Verdict {
    /// Name in JSON.
    pub fn name(self) -> &'static str {
        let names = ["explained", "partly_explained", "nothing_missing", "unexplained", "not_decidable"];
        names[self as usize]
    }
}

/// A parameter as estimated.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EffectParameterEstimate {
    /// Parameter of the effect, as in the registry.
    pub name: &'static str,
    /// Estimated value.
    pub value: f64,
    /// Standard error of the value.
    pub stderr: f64,
    /// Unit of all three numbers.
    pub unit: &'static str,
    /// In the declared model; the value of "off" if it has no such effect.
    pub declared: f64,
}

impl EffectParameterEstimate {
    /// The estimate of a parameter whose declared value is that of "off".
    pub(super) fn new(param: &Param, value: f64, stderr: f64) -> Self {
        EffectParameterEstimate { name: param.name, value, stderr, unit: param.unit, declared: param.off }
    }
}

/// A number of the model, fitted anew beside the effects.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NumberEstimate {
    /// Path in the model, such as `vehicle.mass`.
    pub path: String,
    /// Value in the declared model.
    pub declared: f64,
    /// Fitted value.
    pub value: f64,
    /// Unit of both values.
    pub unit: String,
}

/// An effect that earned its place.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Registry name of the effect.
    pub name: &'static str,
    /// Estimates of its free parameters.
    pub params: Vec<EffectParameterEstimate>,
    /// Effects that these flights cannot distinguish from it.
    pub confusable_with: Vec<&'static str>,
    /// The manoeuvre that distinguishes them; empty if there is nothing to distinguish.
    pub manoeuvre: String,
    /// Log-likelihood lost without it, on the flights of the fit and on the test flights.
    pub worth_fit: f64,
    /// Log-likelihood lost without it on the test flights.
    pub worth_test: f64,
    /// The worth on the test flights by signal, in the order of [`Signal::ALL`].
    pub worth_by_signal: [f64; 4],
    /// Effects of the same kind that belong to it: the exact geometry of a tilted vehicle is one finding.
    pub with: Vec<Finding>,
}

impl Finding {
    /// Returns the effect and those that belong to it.
    pub fn all(&self) -> impl Iterator<Item = &Finding> {
        std::iter::once(self).chain(&self.with)
    }
}

/// Score of an effect when it was considered.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RankedCandidate {
    /// Registry name of the effect.
    pub name: &'static str,
    /// Expected gain of log-likelihood.
    pub gain: f64,
    /// Standard error of its free parameters on these flights.
    pub stderr: Vec<f64>,
}

/// One step of the search: the effects then in the hypothesis, and the log-likelihood gained by the last.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Step {
    /// Registry names of the effects in the hypothesis, after this step.
    pub effects: Vec<&'static str>,
    /// Gain of log-likelihood by the effect that this step added.
    pub gain: f64,
    /// The candidates of the next step.
    pub ranking: Vec<RankedCandidate>,
}

/// The kind of a structure that is left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Structure {
    /// Residuals depend on residuals or commands before: a filter of the measurement makes such too.
    Memory,
    /// A line of the spectrum.
    Line,
    /// A force depends on place, height, speed, time or voltage, or begins and ends at once.
    State,
    /// A disturbance that is larger than the small errors of a model.
    Disturbance,
}

/// One finding about structure that is left.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Leftover {
    /// Kind of the structure.
    pub kind: Structure,
    /// The part of the motion that it is about.
    pub part: Signal,
    /// "x", "roll", ... or a disturbance: "torque", "lift", "force in x".
    pub signal: String,
    /// In words: frequency, correlation.
    pub finding: String,
    /// Test statistic in standard deviations, or in units that make it one.
    pub size: f64,
}

impl Leftover {
    /// Builds a finding from its fields.
    pub fn new(kind: Structure, part: Signal, signal: &str, finding: String, size: f64) -> Self {
        Leftover { kind, part, signal: signal.to_owned(), finding, size }
    }

    /// Returns whether it is too strong to be chance.
    pub fn is_structure(&self) -> bool {
        self.size.abs() > FINDING.get()
    }
}

/// Everything that was found.
#[derive(Debug, Clone)]
pub struct Explanation {
    /// Verdict on the declared model as a whole.
    pub verdict: Verdict,
    /// Effects that are named, each with its estimates and its worth.
    pub effects: Vec<Finding>,
    /// Explained share of each part of the motion, and the rest.
    pub signals: Vec<SignalVerdict>,
    /// Beside structure that nothing explains: effects that lower the errors on the test flights but do not
    /// account for it.
    pub partial: Vec<Finding>,
    /// Effects so small that they make up for declared numbers that are not known better, and are no causes.
    pub corrections: Vec<Finding>,
    /// Effects of the declared model that it needs at the declared values. Only looked for on flights of real
    /// vehicles.
    pub confirmed: Vec<Finding>,
    /// Effects of the declared model that predictions do not miss: the completed model is without them.
    pub needless: Vec<&'static str>,
    /// Effects that lower the errors on flights of the fit and raise one on the test flights: the model stays
    /// as declared. Only on flights of real vehicles.
    pub withdrawn: Vec<&'static str>,
    /// Numbers of the model that were fitted with the effects. Only on flights of real vehicles.
    pub numbers: Vec<NumberEstimate>,
    /// New numbers alone predict so much better that the declared ones are another vehicle's.
    pub foreign: bool,
    /// The declared model with the effects at their values; what the simulator flies.
    pub completed: Hypothesis,
    /// The declared model as it was given.
    pub declared: Hypothesis,
    /// The completed model has a term learned from the residual, which describes the rest and names no cause.
    pub learned: bool,
    /// Disturbances under the declared and the completed model.
    pub disturbances: [Disturbances; 2],
    /// Steps of the forward search, in order.
    pub path: Vec<Step>,
    /// Findings about the residual that the named effects leave.
    pub leftover: Vec<Leftover>,
    /// Prediction errors on the test flights, under the declared and the completed model.
    pub errors: Errors,
    /// Effects that these flights could not have shown, with the standard error of the first parameter, in
    /// its unit.
    pub not_excited: Vec<(&'static str, f64)>,
    /// Wall-clock time that the explanation took.
    pub seconds: f64,
}
