//! Records of scored cases, as JSON keeps them.

use std::fmt;

use crazyflie_identify::explain::verdict::{Explanation, Finding};
use serde::{Deserialize, Serialize};

use crate::case_file::CaseFile;
use crate::oracle::OracleComparison;
use crate::truth::{Group, HiddenEffect, Truth};

/// The oracle's error may be exceeded by this factor.
const WORST_RATIO: f64 = 1.1;

/// A scored case.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct CaseRecord {
    pub case: String,
    pub folder: String,
    /// Reason that there is no explanation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failed: Option<String>,
    pub verdict: String,
    pub effects: Vec<NamedEffect>,
    /// Names of effects that lower the error beside structure which nothing explains.
    pub partial: Vec<String>,
    pub score: Score,
    pub seconds: Option<f64>,
}

/// An effect as named by an explanation.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct NamedEffect {
    pub name: String,
    pub params: Vec<ParameterEstimate>,
    pub confusable_with: Vec<String>,
    /// Log-likelihood lost without it, on the flights of the fit and on the test flights.
    pub worth_fit: Option<f64>,
    pub worth_test: Option<f64>,
    /// Effects that belong to it.
    pub with: Vec<NamedEffect>,
}

/// A parameter's estimate; JSON has no numbers that are none, so these are absent.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ParameterEstimate {
    pub name: String,
    pub value: Option<f64>,
    pub stderr: Option<f64>,
    pub unit: String,
}

/// The truth of a case and the marks that it gives.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Score {
    pub group: Group,
    pub tier: String,
    pub excitation: String,
    pub noise: String,
    pub seed: Option<u64>,
    pub truth: Vec<HiddenEffect>,
    pub benign: Vec<String>,
    pub criteria: Criteria,
    /// Answer to each hidden effect, in the order of `truth`.
    pub answers: Vec<Answer>,
    /// Effects that are named and are not there.
    pub extra: Vec<String>,
    /// Parameters of effects that were named by their own name.
    pub values: Vec<ValueError>,
    /// Largest error on the held-out flight over the oracle's.
    pub told_ratio: Option<f64>,
}

/// One mark per criterion; `None` where it does not apply.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct Criteria {
    /// Named the hidden effects and nothing else, or answered rightly that nothing can be named.
    pub named: bool,
    /// The same where the flights show what is hidden: a fit that is given the answer finds each effect four
    /// standard errors from "off".
    #[serde(rename = "named where shown")]
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
pub enum Answer {
    ByName,
    /// In a group of at most three, under a rival's name.
    InGroup(String),
    Missed,
}

/// A parameter's estimate against its true value.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ValueError {
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
    /// Returns the effect and those that belong to it.
    pub fn all(&self) -> impl Iterator<Item = &NamedEffect> {
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
    /// A case with its explanation, or with the reason that there is none: a miss, whatever is hidden.
    pub fn new(
        file: &CaseFile,
        found: Result<&Explanation, String>,
        truth: Truth,
        oracle: Option<OracleComparison>,
    ) -> Self {
        let explained = found.as_ref().ok();
        let verdict = explained.map_or("failed", |found| found.verdict.name()).to_owned();
        let effects: Vec<NamedEffect> =
            explained.iter().flat_map(|found| &found.effects).map(NamedEffect::from).collect();
        let partial = explained.iter().flat_map(|found| &found.partial).flat_map(Finding::all);
        CaseRecord {
            case: file.id.clone(),
            folder: file.folder.clone(),
            partial: partial.map(|named| named.name.to_owned()).collect(),
            seconds: explained.map(|found| found.seconds),
            score: Score::new(truth, explained.map(|_| (&verdict[..], &effects[..])), oracle),
            failed: found.err(),
            verdict,
            effects,
        }
    }

    /// Returns all effects that are named, those that belong to others too.
    pub fn named_effects(&self) -> impl Iterator<Item = &NamedEffect> {
        self.effects.iter().flat_map(NamedEffect::all)
    }
}

/// A case in a line, while the others are still being explained.
impl fmt::Display for CaseRecord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(problem) = &self.failed {
            return write!(f, "{}: {problem}", self.case);
        }
        let score = &self.score;
        let named: Vec<&str> = self.named_effects().map(|effect| effect.name.as_str()).collect();
        write!(f, "{}: {}, names {}", self.case, self.verdict, named.join(", "))?;
        let hidden: Vec<&str> = score.truth.iter().map(|effect| effect.name.as_str()).collect();
        let verdict = if score.criteria.named { "right" } else { "WRONG" };
        write!(f, "; hidden {}: {verdict}", hidden.join(", "))?;
        for (criterion, mark) in [("15 %", score.criteria.near), ("3 stderr", score.criteria.within)] {
            let mark = mark.map_or("n/a", |ok| if ok { "ok" } else { "MISS" });
            write!(f, ", {criterion} {mark}")?;
        }
        write!(f, ", {:.1} s", self.seconds.unwrap_or(f64::NAN))
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

#[cfg(test)]
pub mod tests {
    use serde_json::json;

    use super::*;

    /// A case that hides these effects, all of which are named by their own name, or all missed.
    pub fn record(group: &str, hidden: &[&str], named: bool) -> CaseRecord {
        let answer = if named { "by_name" } else { "missed" };
        let truth: Vec<_> = hidden.iter().map(|name| json!({"name": name, "params": {}})).collect();
        let criteria = json!({"named": named, "named where shown": null, "15 %": null, "3 stderr": null,
            "held-out error": null});
        let score = json!({"group": group, "tier": "linear", "excitation": "mix", "noise": "mid", "seed": 5,
            "truth": truth, "benign": [], "criteria": criteria, "answers": vec![answer; hidden.len()], "extra": [],
            "values": [], "told_ratio": null});
        serde_json::from_value(json!({"case": "d0", "folder": "x", "verdict": "explained", "effects": [],
            "partial": [], "score": score, "seconds": 2.0}))
        .unwrap()
    }

    #[test]
    fn a_line_says_what_is_hidden_and_what_is_named() {
        let mut wrong = record("single", &["wind"], false);
        let gust = json!({"name": "gust", "params": [], "confusable_with": [], "worth_fit": 20.0,
            "worth_test": 20.0, "with": []});
        wrong.effects = vec![serde_json::from_value(gust).unwrap()];
        assert_eq!(
            wrong.to_string(),
            "d0: explained, names gust; hidden wind: WRONG, 15 % n/a, 3 stderr n/a, 2.0 s"
        );
        wrong.failed = Some("no log".into());
        assert_eq!(wrong.to_string(), "d0: no log");
    }
}
