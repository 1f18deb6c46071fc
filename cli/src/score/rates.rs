//! Rates over many cases: by group, effect, tier, excitation and noise, with intervals; what is taken for
//! what; honesty of errors.

use crazyflie_statistics::median;
use std::collections::BTreeMap;

use serde::Serialize;

use super::record::{Answer, CaseRecord, ValueError};
use super::truth::Group;

/// Quantile of the normal distribution that leaves 2.5 % on either side.
const Z_95: f64 = 1.959_964;

/// Rate at which something holds, with Wilson's 95 % interval (Wilson 1927): it stays within 0 and 1 and
/// holds for few cases too.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Rate {
    pub ok: usize,
    pub of: usize,
    pub low: f64,
    pub high: f64,
}

impl Rate {
    pub(crate) fn from_marks(marks: impl IntoIterator<Item = bool>) -> Self {
        let (mut ok, mut of) = (0, 0);
        for mark in marks {
            ok += usize::from(mark);
            of += 1;
        }
        let (n, z2) = (of as f64, Z_95 * Z_95);
        if of == 0 {
            return Rate { ok, of, low: 0.0, high: 1.0 };
        }
        let share = ok as f64 / n;
        let middle = (share + z2 / (2.0 * n)) / (1.0 + z2 / n);
        let half = Z_95 / (1.0 + z2 / n) * (share * (1.0 - share) / n + z2 / (4.0 * n * n)).sqrt();
        // at none and at all the bound is exact, not rounded
        let low = if ok == 0 { 0.0 } else { middle - half };
        Rate { ok, of, low, high: if ok == of { 1.0 } else { middle + half } }
    }
}

/// Errors of the parameters of effects that were named by their own name.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct ValueStatistics {
    /// Within 15 % of what the parameter changes.
    pub near: Rate,
    /// Within three standard errors.
    pub within: Rate,
    /// Mean and standard deviation of the errors in standard errors: 0 and 1 where these are honest.
    pub z_mean: Option<f64>,
    pub z_deviation: Option<f64>,
}

impl ValueStatistics {
    fn from_values<'a>(values: impl IntoIterator<Item = &'a ValueError>) -> Self {
        let values: Vec<&ValueError> = values.into_iter().collect();
        let z: Vec<f64> = values.iter().filter_map(|value| value.z).collect();
        let n = z.len() as f64;
        let mean = z.iter().sum::<f64>() / n;
        let variance = z.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / (n - 1.0);
        ValueStatistics {
            near: Rate::from_marks(values.iter().map(|value| value.is_near())),
            within: Rate::from_marks(values.iter().map(|value| value.is_within())),
            z_mean: (!z.is_empty()).then_some(mean),
            z_deviation: (z.len() > 1).then_some(variance.sqrt()),
        }
    }
}

/// Criteria of a group of cases, or of all (`group` is "all"), in the order of [`CRITERIA`], and how often
/// each verdict was given.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct GroupRow {
    pub group: &'static str,
    pub criteria: [Rate; CRITERIA.len()],
    pub verdicts: BTreeMap<String, usize>,
}

/// Names of the criteria, as the rows of JSON have them.
pub(crate) const CRITERIA: [&str; 5] = ["named", "named where shown", "15 %", "3 stderr", "held-out error"];

/// Rates of right answers of the cases that share a circumstance.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Stratum {
    /// Tier, excitation or noise.
    pub kind: &'static str,
    pub value: String,
    pub groups: BTreeMap<Group, Rate>,
    pub all: Rate,
}

/// A row of the confusion matrix: a hidden effect, or "nothing", and what was named.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct EffectRow {
    pub effect: String,
    pub cases: usize,
    /// Cases answered right as a whole.
    pub right: Rate,
    /// Named by its own name, or under a rival's whose group of at most three holds it.
    pub by_name: usize,
    pub in_group: BTreeMap<String, usize>,
    /// Named in cases that miss the effect; "-" for no wrong name.
    pub instead: BTreeMap<String, usize>,
    /// Named, and not there, beside the effect.
    pub besides: BTreeMap<String, usize>,
    /// Verdicts of the cases that are not right.
    pub wrong_verdicts: BTreeMap<String, usize>,
    pub values: ValueStatistics,
}

/// Everything that is counted.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Rates {
    pub cases: usize,
    pub groups: Vec<GroupRow>,
    pub strata: Vec<Stratum>,
    pub effects: Vec<EffectRow>,
    pub values: ValueStatistics,
    /// Time of a case, at the median and at worst.
    pub median_s: Option<f64>,
    pub worst_s: Option<f64>,
}

impl Rates {
    pub(crate) fn from_records(records: &[CaseRecord]) -> Self {
        let mut groups: Vec<Group> = records.iter().map(|r| r.score.group).collect();
        groups.sort();
        groups.dedup();
        let row =
            |group: &Group| GroupRow::new(group.name(), records.iter().filter(|r| r.score.group == *group));
        let mut rows: Vec<GroupRow> = groups.iter().map(row).collect();
        rows.push(GroupRow::new("all", records));
        let mut seconds: Vec<f64> = records.iter().filter_map(|r| r.seconds).collect();
        seconds.sort_by(f64::total_cmp);
        let value_errors = records.iter().flat_map(|r| &r.score.values);
        Rates {
            cases: records.len(),
            groups: rows,
            strata: strata(records),
            effects: effect_rows(records),
            values: ValueStatistics::from_values(value_errors),
            median_s: median(&seconds),
            worst_s: seconds.last().copied(),
        }
    }
}

impl GroupRow {
    fn new<'a>(group: &'static str, records: impl IntoIterator<Item = &'a CaseRecord>) -> Self {
        let records: Vec<&CaseRecord> = records.into_iter().collect();
        let marks = |r: &CaseRecord| {
            let c = r.score.criteria;
            [Some(c.named), c.named_where_shown, c.near, c.within, c.held_out]
        };
        let criteria =
            std::array::from_fn(|at| Rate::from_marks(records.iter().filter_map(|r| marks(r)[at])));
        GroupRow { group, criteria, verdicts: count(records.iter().map(|r| r.verdict.clone())) }
    }
}

fn count(names: impl IntoIterator<Item = String>) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for name in names {
        *counts.entry(name).or_default() += 1;
    }
    counts
}

fn right_rate<'a>(records: impl IntoIterator<Item = &'a &'a CaseRecord>) -> Rate {
    Rate::from_marks(records.into_iter().map(|r| r.score.criteria.named))
}

fn strata(records: &[CaseRecord]) -> Vec<Stratum> {
    type Circumstance = fn(&CaseRecord) -> &String;
    let kinds: [(&str, Circumstance); 3] =
        [("tier", |r| &r.score.tier), ("excitation", |r| &r.score.excitation), ("noise", |r| &r.score.noise)];
    let mut strata = Vec::new();
    for (kind, value_of) in kinds {
        let mut by_value: BTreeMap<&String, Vec<&CaseRecord>> = BTreeMap::new();
        for record in records.iter().filter(|r| !value_of(r).is_empty()) {
            by_value.entry(value_of(record)).or_default().push(record);
        }
        for (value, of_value) in by_value {
            let mut groups: BTreeMap<Group, Vec<&CaseRecord>> = BTreeMap::new();
            for &record in &of_value {
                groups.entry(record.score.group).or_default().push(record);
            }
            let groups = groups.iter().map(|(group, records)| (*group, right_rate(records))).collect();
            strata.push(Stratum { kind, value: value.clone(), groups, all: right_rate(&of_value) });
        }
    }
    strata
}

fn effect_rows(records: &[CaseRecord]) -> Vec<EffectRow> {
    let mut by_effect: BTreeMap<&str, Vec<(&CaseRecord, Option<&Answer>)>> = BTreeMap::new();
    for record in records {
        for (at, hidden) in record.score.truth.iter().enumerate() {
            by_effect.entry(&hidden.name).or_default().push((record, record.score.answers.get(at)));
        }
        if record.score.truth.is_empty() {
            by_effect.entry("nothing").or_default().push((record, None));
        }
    }
    by_effect.into_iter().map(|(effect, cases)| EffectRow::new(effect, &cases)).collect()
}

impl EffectRow {
    fn new(effect: &str, cases: &[(&CaseRecord, Option<&Answer>)]) -> Self {
        let (mut by_name, mut in_group, mut instead, mut besides) = (0, Vec::new(), Vec::new(), Vec::new());
        for (record, answer) in cases {
            let extra = record.score.extra.iter().cloned();
            match answer {
                Some(Answer::Missed) if record.score.extra.is_empty() => instead.push("-".to_owned()),
                Some(Answer::Missed) => instead.extend(extra),
                Some(Answer::ByName) => {
                    by_name += 1;
                    besides.extend(extra);
                }
                Some(Answer::InGroup(rival)) => {
                    in_group.push(rival.clone());
                    besides.extend(extra);
                }
                None => besides.extend(extra),
            }
        }
        let wrong = cases.iter().filter(|(record, _)| !record.score.criteria.named);
        let values =
            cases.iter().flat_map(|(record, _)| &record.score.values).filter(|value| value.effect == effect);
        EffectRow {
            effect: effect.to_owned(),
            cases: cases.len(),
            right: Rate::from_marks(cases.iter().map(|(record, _)| record.score.criteria.named)),
            by_name,
            in_group: count(in_group),
            instead: count(instead),
            besides: count(besides),
            wrong_verdicts: count(wrong.map(|(record, _)| record.verdict.clone())),
            values: ValueStatistics::from_values(values),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde_json::json;

    fn record(
        group: &str,
        truth: &[&str],
        answers: serde_json::Value,
        extra: &[&str],
        named: bool,
        z: &[f64],
    ) -> CaseRecord {
        let hidden: Vec<_> = truth.iter().map(|name| json!({"name": name, "params": {}})).collect();
        let value = |z: &f64| json!({"effect": truth[0], "parameter": "p", "truth": 1.0, "estimate": 1.1, "share": 0.1, "z": z});
        let values: Vec<_> = z.iter().map(value).collect();
        let score = json!({"group": group, "tier": "rigid", "excitation": "mix", "noise": "mid", "truth": hidden, "answers": answers,
            "criteria": {"named": named, "15 %": null, "3 stderr": null, "held-out error": null}, "extra": extra, "values": values});
        serde_json::from_value(json!({"case": "d0", "verdict": "explained", "score": score, "seconds": 2.0}))
            .unwrap()
    }

    #[test]
    fn intervals_are_those_of_the_literature() {
        // Newcombe 1998, table I: 81 of 263 and 0 of 20
        let rate = Rate::from_marks((0..263).map(|i| i < 81));
        assert!((rate.low - 0.2553).abs() < 5e-5 && (rate.high - 0.3662).abs() < 5e-5, "{rate:?}");
        let rate = Rate::from_marks([false; 20]);
        assert!(rate.low == 0.0 && (rate.high - 0.1611).abs() < 5e-5, "{rate:?}");
    }

    #[test]
    fn what_is_taken_for_what_is_counted() {
        let records = [
            record("single", &["wind"], json!(["by_name"]), &[], true, &[1.0, -1.0]),
            record("single", &["wind"], json!(["missed"]), &["gust", "flap"], false, &[]),
            record(
                "compound",
                &["wind", "flap"],
                json!([{"in_group": "imu_tilt"}, "missed"]),
                &[],
                false,
                &[],
            ),
            record("null", &[], json!([]), &["gust"], false, &[]),
        ];
        let rates = Rates::from_records(&records);
        let row = |name: &str| rates.effects.iter().find(|row| row.effect == name).unwrap();
        let counts = |pairs: &[(&str, usize)]| {
            pairs.iter().map(|(name, n)| ((*name).to_owned(), *n)).collect::<BTreeMap<_, _>>()
        };
        let wind = row("wind");
        assert_eq!((wind.cases, wind.by_name, wind.right.ok), (3, 1, 1));
        assert_eq!(
            (&wind.in_group, &wind.instead),
            (&counts(&[("imu_tilt", 1)]), &counts(&[("gust", 1), ("flap", 1)]))
        );
        assert_eq!(row("flap").instead, counts(&[("-", 1)]));
        assert_eq!(row("nothing").besides, counts(&[("gust", 1)]));
        assert_eq!(
            rates.groups.iter().map(|g| (g.group, g.criteria[0].ok, g.criteria[0].of)).collect::<Vec<_>>(),
            [("null", 0, 1), ("single", 1, 2), ("compound", 0, 1), ("all", 1, 4)]
        );
        assert!(
            (rates.values.z_deviation.unwrap() - 2_f64.sqrt()).abs() < 1e-12
                && rates.values.z_mean == Some(0.0)
        );
        assert_eq!((rates.median_s, rates.worst_s), (Some(2.0), Some(2.0)));
        assert_eq!(
            rates.strata.iter().map(|s| (s.kind, s.all.of)).collect::<Vec<_>>(),
            [("tier", 4), ("excitation", 4), ("noise", 4)]
        );
    }

    #[test]
    fn medians_lie_between() {
        assert_eq!(
            [median(&[]), median(&[3.0]), median(&[1.0, 3.0, 8.0]), median(&[1.0, 3.0, 4.0, 8.0])],
            [None, Some(3.0), Some(3.0), Some(3.5)]
        );
    }

    proptest! {
        #[test]
        fn intervals_hold_their_rate(marks in proptest::collection::vec(any::<bool>(), 1..200)) {
            let rate = Rate::from_marks(marks.iter().copied());
            let share = rate.ok as f64 / rate.of as f64;
            prop_assert!(0.0 <= rate.low && rate.low <= share && share <= rate.high && rate.high <= 1.0);
        }
    }
}
