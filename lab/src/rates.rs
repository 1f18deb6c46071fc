//! Rates over many cases: by group, effect, tier, excitation and noise; what is taken for what; honesty of
//! errors.

use std::collections::BTreeMap;

use crazyflie_statistics::{mean, median};
use serde::{Deserialize, Serialize};

use crate::record::{Answer, CaseRecord, ValueError};

/// Quantile of the normal distribution that leaves 2.5 % on either side.
const Z_95: f64 = 1.959_964;

/// Names with how often each occurs.
pub type Counts = BTreeMap<String, usize>;

/// Rate of a condition.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rate {
    pub ok: usize,
    pub of: usize,
}

impl Rate {
    /// Share of the marks that are set.
    pub fn from_marks(marks: impl IntoIterator<Item = bool>) -> Self {
        marks.into_iter().fold(Rate { ok: 0, of: 0 }, |rate, mark| Rate {
            ok: rate.ok + usize::from(mark),
            of: rate.of + 1,
        })
    }

    /// Returns Wilson's 95 % interval (Wilson 1927): it stays within 0 and 1 and is valid for few cases too.
    pub fn interval(self) -> [f64; 2] {
        let (n, z2) = (self.of as f64, Z_95 * Z_95);
        if self.of == 0 {
            return [0.0, 1.0];
        }
        let share = self.ok as f64 / n;
        let middle = (share + z2 / (2.0 * n)) / (1.0 + z2 / n);
        let half = Z_95 / (1.0 + z2 / n) * (share * (1.0 - share) / n + z2 / (4.0 * n * n)).sqrt();
        // at none and at all the bound is exact, not rounded
        let low = if self.ok == 0 { 0.0 } else { middle - half };
        [low, if self.ok == self.of { 1.0 } else { middle + half }]
    }
}

/// Errors of the parameters of effects that were named by their own name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ValueStatistics {
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
        let z_mean = mean(&z);
        let squares = z_mean.map(|mean| z.iter().map(|z| (z - mean).powi(2)).sum::<f64>());
        ValueStatistics {
            near: Rate::from_marks(values.iter().map(|value| value.is_near())),
            within: Rate::from_marks(values.iter().map(|value| value.is_within())),
            z_mean,
            z_deviation: squares.filter(|_| z.len() > 1).map(|sum| (sum / (z.len() - 1) as f64).sqrt()),
        }
    }
}

/// Rates of a group of cases, or of "all".
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct GroupRow {
    pub group: String,
    /// In the order of [`crate::record::Criteria`].
    pub criteria: [Rate; 5],
    pub verdicts: Counts,
}

/// A row of the confusion matrix: a hidden effect, or "nothing", and what was named.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct EffectRow {
    pub effect: String,
    /// Rates over the cases that hide it, in the order of [`crate::record::Criteria`].
    pub criteria: [Rate; 5],
    /// Named by its own name, or under a rival's whose group of at most three contains it.
    pub by_name: usize,
    pub in_group: Counts,
    /// Named in cases that miss the effect; "no name" for no wrong name.
    pub instead: Counts,
    /// Named, and not there, beside the effect.
    pub besides: Counts,
    pub values: ValueStatistics,
}

/// Everything that is counted.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Rates {
    pub cases: usize,
    /// The last row is of all cases.
    pub groups: Vec<GroupRow>,
    pub effects: Vec<EffectRow>,
    /// Right answers by tier, by excitation and by noise.
    pub tiers: BTreeMap<String, Rate>,
    pub excitations: BTreeMap<String, Rate>,
    pub noises: BTreeMap<String, Rate>,
    pub values: ValueStatistics,
    /// Time of a case, at the median and at worst.
    pub median_s: Option<f64>,
    pub worst_s: Option<f64>,
}

impl Rates {
    /// Counts the answers of a run.
    pub fn from_records(records: &[CaseRecord]) -> Self {
        let mut seconds: Vec<f64> = records.iter().filter_map(|record| record.seconds).collect();
        seconds.sort_by(f64::total_cmp);
        let all = ("all".to_owned(), records.iter().collect());
        let groups = by(records, |record| record.score.group);
        let groups = groups.into_iter().map(|(group, records)| (group.to_string(), records)).chain([all]);
        let right_by = |circumstance: fn(&CaseRecord) -> String| {
            by(records, circumstance)
                .into_iter()
                .map(|(value, records)| (value, criteria(&records)[0]))
                .collect()
        };
        Rates {
            cases: records.len(),
            groups: groups.map(|(group, records)| GroupRow::new(group, &records)).collect(),
            effects: effect_rows(records),
            tiers: right_by(|record| record.score.tier.clone()),
            excitations: right_by(|record| record.score.excitation.clone()),
            noises: right_by(|record| record.score.noise.clone()),
            values: ValueStatistics::from_values(records.iter().flat_map(|record| &record.score.values)),
            median_s: median(&seconds),
            worst_s: seconds.last().copied(),
        }
    }
}

/// The cases of each value of a circumstance.
fn by<T: Ord>(records: &[CaseRecord], circumstance: fn(&CaseRecord) -> T) -> BTreeMap<T, Vec<&CaseRecord>> {
    let mut by_value: BTreeMap<T, Vec<&CaseRecord>> = BTreeMap::new();
    for record in records {
        by_value.entry(circumstance(record)).or_default().push(record);
    }
    by_value
}

/// Computes the rate of each criterion, over the cases to which it applies.
fn criteria(records: &[&CaseRecord]) -> [Rate; 5] {
    let marks = |record: &CaseRecord| {
        let c = record.score.criteria;
        [Some(c.named), c.named_where_shown, c.near, c.within, c.held_out]
    };
    std::array::from_fn(|at| Rate::from_marks(records.iter().filter_map(|record| marks(record)[at])))
}

impl GroupRow {
    fn new(group: String, records: &[&CaseRecord]) -> Self {
        let verdicts = count(records.iter().map(|record| record.verdict.clone()));
        GroupRow { group, criteria: criteria(records), verdicts }
    }
}

fn count(names: impl IntoIterator<Item = String>) -> Counts {
    let mut counts = Counts::new();
    for name in names {
        *counts.entry(name).or_default() += 1;
    }
    counts
}

fn effect_rows(records: &[CaseRecord]) -> Vec<EffectRow> {
    let mut by_effect: BTreeMap<&str, Vec<(&CaseRecord, Option<&Answer>)>> = BTreeMap::new();
    for record in records {
        for (hidden, answer) in record.score.truth.iter().zip(&record.score.answers) {
            by_effect.entry(&hidden.name).or_default().push((record, Some(answer)));
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
                Some(Answer::Missed) if record.score.extra.is_empty() => instead.push("no name".to_owned()),
                Some(Answer::Missed) => instead.extend(extra),
                Some(Answer::InGroup(rival)) => {
                    in_group.push(rival.clone());
                    besides.extend(extra);
                }
                Some(Answer::ByName) | None => {
                    by_name += usize::from(answer.is_some());
                    besides.extend(extra);
                }
            }
        }
        let values =
            cases.iter().flat_map(|(record, _)| &record.score.values).filter(|value| value.effect == effect);
        EffectRow {
            effect: effect.to_owned(),
            criteria: criteria(&cases.iter().map(|(record, _)| *record).collect::<Vec<_>>()),
            by_name,
            in_group: count(in_group),
            instead: count(instead),
            besides: count(besides),
            values: ValueStatistics::from_values(values),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::record::tests::record;

    #[test]
    fn intervals_are_those_of_the_literature() {
        // Newcombe 1998, table I: 81 of 263 and 0 of 20
        let [low, high] = Rate { ok: 81, of: 263 }.interval();
        assert!((low - 0.2553).abs() < 5e-5 && (high - 0.3662).abs() < 5e-5, "{low} {high}");
        let [low, high] = Rate { ok: 0, of: 20 }.interval();
        assert!(low == 0.0 && (high - 0.1611).abs() < 5e-5, "{low} {high}");
    }

    #[test]
    fn what_is_taken_for_what_is_counted() {
        let mut records = [
            record("single", &["wind"], true),
            record("single", &["wind"], false),
            record("compound", &["wind", "flap"], false),
            record("null", &[], false),
        ];
        let value = |z| ValueError {
            effect: "wind".into(),
            parameter: "x_mps2".into(),
            truth: 1.0,
            estimate: Some(1.1),
            share: Some(0.1),
            z: Some(z),
        };
        records[0].score.values = vec![value(1.0), value(-1.0)];
        records[1].score.extra = vec!["gust".into(), "flap".into()];
        records[2].score.answers[0] = Answer::InGroup("imu_tilt".into());
        records[3].score.extra = vec!["gust".into()];
        let rates = Rates::from_records(&records);
        let row = |name: &str| rates.effects.iter().find(|row| row.effect == name).unwrap();
        let counts = |names: &[&str]| count(names.iter().map(|&name| name.to_owned()));
        let wind = row("wind");
        assert_eq!((wind.criteria[0], wind.by_name), (Rate { ok: 1, of: 3 }, 1));
        assert_eq!((&wind.in_group, &wind.instead), (&counts(&["imu_tilt"]), &counts(&["gust", "flap"])));
        assert_eq!(row("flap").instead, counts(&["no name"]));
        assert_eq!(row("nothing").besides, counts(&["gust"]));
        let right = |row: &GroupRow| (row.group.clone(), row.criteria[0].ok, row.criteria[0].of);
        assert_eq!(
            rates.groups.iter().map(right).collect::<Vec<_>>(),
            [("null", 0, 1), ("single", 1, 2), ("compound", 0, 1), ("all", 1, 4)].map(|(name, ok, of)| (
                name.to_owned(),
                ok,
                of
            ))
        );
        assert!(
            (rates.values.z_deviation.unwrap() - 2_f64.sqrt()).abs() < 1e-12
                && rates.values.z_mean == Some(0.0)
        );
        assert_eq!((rates.median_s, rates.worst_s), (Some(2.0), Some(2.0)));
        let circumstances = [&rates.tiers["linear"], &rates.excitations["mix"], &rates.noises["mid"]];
        assert_eq!(circumstances, [&Rate { ok: 1, of: 4 }; 3]);
    }

    proptest! {
        #[test]
        fn intervals_hold_their_rate(marks in proptest::collection::vec(any::<bool>(), 1..200)) {
            let rate = Rate::from_marks(marks.iter().copied());
            let (share, [low, high]) = (rate.ok as f64 / rate.of as f64, rate.interval());
            prop_assert!(0.0 <= low && low <= share && share <= high && high <= 1.0);
        }
    }
}
