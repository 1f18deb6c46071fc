//! Records: all that a page needs of a scored case, as JSON keeps it between runs.

use crazyflie_identify::explain::verdict::{Explanation, Finding};
use serde::{Deserialize, Serialize};

use super::oracle::OracleComparison;
use super::truth::{Group, HiddenEffect, Truth};
use crate::explanation::verdict_name;

/// The oracle's error may be exceeded by this factor.
pub(crate) const WORST_RATIO: f64 = 1.1;

/// A scored case.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct CaseRecord {
    pub case: String,
    #[serde(default)]
    pub folder: String,
    /// Reason that there is no explanation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failed: Option<String>,
    #[serde(default)]
    pub verdict: String,
    #[serde(default)]
    pub effects: Vec<NamedEffect>,
    /// Names of effects that lower the error beside structure which nothing explains.
    #[serde(default)]
    pub partial: Vec<String>,
    pub score: Score,
    #[serde(default)]
    pub seconds: Option<f64>,
}

/// An effect as named by an explanation.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct NamedEffect {
    pub name: String,
    pub params: Vec<ParameterEstimate>,
    pub confusable_with: Vec<String>,
    /// Log-likelihood lost without it, on the flights of the fit and on the test flights.
    pub worth_fit: Option<f64>,
    pub worth_test: Option<f64>,
    /// Effects that come with it.
    pub with: Vec<NamedEffect>,
}

/// A parameter's estimate; JSON has no numbers that are none, so these are absent.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct ParameterEstimate {
    pub name: String,
    pub value: Option<f64>,
    pub stderr: Option<f64>,
    pub unit: String,
}

/// The truth of a case and the marks that it gives.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Score {
    pub group: Group,
    pub tier: String,
    #[serde(default)]
    pub excitation: String,
    #[serde(default)]
    pub noise: String,
    #[serde(default)]
    pub seed: Option<u64>,
    pub truth: Vec<HiddenEffect>,
    #[serde(default)]
    pub benign: Vec<String>,
    pub criteria: Criteria,
    /// Answer to each hidden effect, in the order of `truth`.
    #[serde(default)]
    pub answers: Vec<Answer>,
    /// Effects that are named and are not there.
    #[serde(default)]
    pub extra: Vec<String>,
    /// Parameters of effects that were named by their own name.
    #[serde(default)]
    pub values: Vec<ValueError>,
    /// Largest error on the held-out flight over the oracle's.
    #[serde(default)]
    pub told_ratio: Option<f64>,
}

/// One mark per criterion; `None` where it does not apply.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct Criteria {
    /// Named what is hidden and nothing else, or said rightly that nothing can be named.
    pub named: bool,
    /// The same where the flights show what is hidden: a fit that is given the answer finds each effect four
    /// standard errors from "off".
    #[serde(default, rename = "named where shown")]
    pub named_where_shown: Option<bool>,
    /// Every comparable parameter within 15 %.
    #[serde(rename = "15 %")]
    pub near: Option<bool>,
    /// Every comparable parameter within three standard errors.
    #[serde(rename = "3 stderr")]
    pub within: Option<bool>,
    #[serde(rename = "held-out error")]
    pub held_out: Option<bool>,
}

/// Answer to a hidden effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Answer {
    ByName,
    /// In a group of at most three, under a rival's name.
    InGroup(String),
    Missed,
}

/// A parameter's estimate against its true value.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct ValueError {
    pub effect: String,
    pub parameter: String,
    pub truth: f64,
    /// Absent where the parameter stayed idle.
    pub estimate: Option<f64>,
    /// Error as a share of what the parameter changes.
    pub share: Option<f64>,
    /// Error in standard errors; absent where there is none.
    pub z: Option<f64>,
}

impl NamedEffect {
    /// The effect and those that come with it.
    pub(crate) fn all(&self) -> impl Iterator<Item = &NamedEffect> {
        std::iter::once(self).chain(&self.with)
    }
}

impl From<&Finding> for NamedEffect {
    fn from(named: &Finding) -> Self {
        let params = named.params.iter().map(|p| ParameterEstimate {
            name: p.name.to_owned(),
            value: finite(p.value),
            stderr: finite(p.stderr),
            unit: p.unit.to_owned(),
        });
        NamedEffect {
            name: named.name.to_owned(),
            params: params.collect(),
            confusable_with: named.confusable_with.iter().map(|&name| name.to_owned()).collect(),
            worth_fit: finite(named.worth_fit),
            worth_test: finite(named.worth_test),
            with: named.with.iter().map(NamedEffect::from).collect(),
        }
    }
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

impl CaseRecord {
    /// A case that could be explained.
    pub(super) fn from_explanation(
        case: String,
        folder: String,
        found: &Explanation,
        truth: Truth,
        oracle: Option<OracleComparison>,
    ) -> Self {
        let verdict = verdict_name(found.verdict).to_owned();
        let effects: Vec<NamedEffect> = found.effects.iter().map(NamedEffect::from).collect();
        let score = Score::new(truth, Some((verdict.as_str(), &effects[..])), oracle);
        let partial =
            found.partial.iter().flat_map(Finding::all).map(|named| named.name.to_owned()).collect();
        CaseRecord {
            case,
            folder,
            failed: None,
            verdict,
            effects,
            partial,
            score,
            seconds: Some(found.seconds),
        }
    }

    /// A case that could not: a miss, whatever is hidden.
    pub(super) fn from_failure(case: String, folder: String, problem: String, truth: Truth) -> Self {
        let (verdict, score) = ("failed".to_owned(), Score::new(truth, None, None));
        CaseRecord {
            case,
            folder,
            failed: Some(problem),
            verdict,
            effects: Vec::new(),
            partial: Vec::new(),
            score,
            seconds: None,
        }
    }
}

impl Score {
    fn new(truth: Truth, found: Option<(&str, &[NamedEffect])>, oracle: Option<OracleComparison>) -> Self {
        let effects = found.map_or(&[][..], |(_, effects)| effects);
        let (answers, extra) = truth.answers(effects);
        let values = truth.value_errors(effects);
        let all_values =
            |good: fn(&ValueError) -> bool| (!values.is_empty()).then(|| values.iter().all(good));
        let told_ratio = oracle.as_ref().map(|oracle| oracle.ratio);
        let named = found.is_some_and(|(verdict, _)| truth.is_answered(verdict, &answers, &extra));
        let criteria = Criteria {
            named,
            named_where_shown: oracle.filter(|oracle| oracle.shown).map(|_| named),
            near: all_values(ValueError::is_near),
            within: all_values(ValueError::is_within),
            held_out: told_ratio.map(|ratio| ratio <= WORST_RATIO),
        };
        let benign = truth.benign().into_iter().map(str::to_owned).collect();
        let Truth { group, tier, excitation, noise, seed, effects: hidden, .. } = truth;
        let excitation = excitation.first().cloned().unwrap_or_default();
        Score {
            group,
            tier,
            excitation,
            noise,
            seed,
            truth: hidden,
            benign,
            criteria,
            answers,
            extra,
            values,
            told_ratio,
        }
    }
}
